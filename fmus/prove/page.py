"""The result of a proof as a page inside the FMU of the block: documentation/proof.html."""

import zipfile
from collections.abc import Sequence
from html import escape
from pathlib import Path

from fmus.errors import range_text
from fmus.files import write_archive
from fmus.prove.eva import Proof

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{name}: proof</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ font: 1rem/1.5 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }}
table {{ border-collapse: collapse; font-size: .875rem; }}
td {{ vertical-align: top; padding: .2rem .7rem .2rem 0; border-bottom: 1px solid #8884; }}
td {{ overflow-wrap: anywhere; }}
tr {{ break-inside: avoid; }}
</style>
</head>
<body>
<h1>Proof of {name}</h1>
<p>The table shows what two tools prove of the C code of one internal step and the outputs. States and inputs
are in the ranges below; other numbers have their start values. Compiler and FMI functions are not proved.
This command repeats the proof:
<code>l1-depth prove {command}</code></p>
<table>
{rows}
</table>
</body>
</html>
"""


def add_page(fmu: Path, result: Proof, bounds: str, command: str) -> None:
    """Writes the page into an FMU; bounds: what ESBMC says; command: the arguments that repeat the proof."""
    rows = [("Frama-C's Eva", result.verdict), ("ESBMC", bounds)]
    rows += [(alarm.kind, f"{alarm.expression} {alarm.line}") for alarm in result.alarms]
    for box in (*result.inputs, *result.states, *result.parameters):
        stays = ", stays in it in every step" if box.name in result.lasting else ""
        rows.append((box.name, f"assumed {range_text(box.low, box.high)}, {box.reason}{stays}"))
    page = _PAGE.format(name=result.name, command=escape(command), rows="\n".join(map(_row, rows)))
    with zipfile.ZipFile(fmu) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    write_archive(fmu, members | {"documentation/proof.html": page.encode("utf-8")})


def _row(cells: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"
