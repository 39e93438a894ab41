"""Page reference/protocol.md: metrics and cases of a score, keys of score.json."""

import json
import tomllib
from typing import Any

from orchestration.cli.explain import SCHEMA, markdown_table

FOLDER = SCHEMA.parents[1] / "studies" / "score"

_HEAD = """\
# Protocol of the score

Metrics and cases of `orchestration/studies/score/protocol.toml`, version {version}, and the keys of
`score.json`.
[Score](score.md) explains them.
"""


def page() -> str:
    """The whole page."""
    protocol = tomllib.loads((FOLDER / "protocol.toml").read_text(encoding="utf-8"))
    schema = json.loads((FOLDER / "score.schema.json").read_text(encoding="utf-8"))
    metrics = [(f"`{name}`", m["title"], m["unit"], m["meaning"]) for name, m in protocol["metrics"].items()]
    marks = ("tuned_on", "repeats_nominal")
    cases = [
        (f"`{name}`", case["title"], ", ".join(f"`{mark}`" for mark in marks if case.get(mark)))
        for name, case in protocol["cases"].items()
    ]
    parts = [
        _HEAD.format(**protocol),
        f"## Metrics\n\n{markdown_table(('metric', 'title', 'unit', 'meaning'), metrics)}",
        f"## Cases\n\n{markdown_table(('case', 'title', 'marks'), cases)}",
        f"## score.json\n\n{_keys(schema)}",
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _keys(schema: dict[str, Any]) -> str:
    """The keys of the document, and of each of its tables."""
    rows = [("", f"`{name}`", node.get("description", "")) for name, node in schema["properties"].items()]
    for title, definition in schema["$defs"].items():
        rows += [
            (title, f"`{name}`", " ".join(node.get("description", "").split()))
            for name, node in definition.get("properties", {}).items()
        ]
    return markdown_table(("table", "key", "meaning"), rows)
