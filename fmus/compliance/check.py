"""Judge FMUs and print the findings: `python -m fmus.compliance FMU...`."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from fmus.compliance import report
from fmus.compliance.behaviour import DEFAULT_TIMEOUT_S, host_errors
from fmus.compliance.examine import examine
from fmus.compliance.library_reader import check_lief, close_reader
from fmus.compliance.registry import all_rules
from fmus.errors import HostError

NO_VERDICT = 3  # exit status
FORMATS = tuple(report.FORMATS)


def check(
    fmus: Sequence[Path],
    json_file: str | None = None,
    timeout: float = DEFAULT_TIMEOUT_S,
    every: bool = False,
    format_name: str = "text",
    out: Path | None = None,
) -> int:
    """Judges FMUs and prints the findings; returns the number of errors.

    every: print each rule, also those that hold; format_name: one of `FORMATS`; out: a file for the findings
    in that format, and then they are printed as text too. Raises OSError for a file that is not there,
    HostError if this machine does not allow a verdict, after the findings where it cannot load a library.
    """
    try:
        findings = {path: examine(path, timeout) for path in fmus}
    finally:
        close_reader()
    document = (
        report.text(findings, every) if format_name == "text" else report.FORMATS[format_name](findings)
    )
    with host_errors():
        if out is not None:
            out.write_text(document, encoding="utf-8")
        if json_file not in (None, "-"):
            Path(str(json_file)).write_text(report.json_text(findings), encoding="utf-8")
    if json_file == "-":
        document = report.json_text(findings)
    elif out is not None:
        document = report.text(findings, every)
    print(document, end="")
    errors = report.count(findings, "error")
    if not errors and (reasons := report.unloaded(findings)):
        raise HostError("; ".join(reasons))
    return errors


def explain(name: str) -> str:
    """Returns what a rule claims and checks. Raises ValueError for a name that no rule has."""
    return report.explain(name, all_rules())


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns 0 without an error, 1 with one, 2 for bad usage, 3 if this machine allows no verdict."""
    parser = argparse.ArgumentParser(prog="python -m fmus.compliance", description="Judge FMUs by FMI 2.0.5.")
    parser.add_argument("fmus", nargs="*", type=Path, metavar="FMU")
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON, to - for standard output")
    parser.add_argument("--format", choices=FORMATS, default="text", help="of what is printed, or of --out")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the findings to a file too")
    parser.add_argument("--timeout", type=float, default=DEFAULT_TIMEOUT_S, help="seconds for one behaviour")
    parser.add_argument("--all", action="store_true", help="show every rule, not only those broken")
    parser.add_argument(
        "--explain", metavar="RULE", help="what a rule claims, and the sentences that it checks"
    )
    options = parser.parse_args(arguments)
    if options.explain is None and not options.fmus:
        parser.error("expected FMUs, or --explain RULE")
    try:
        if options.explain is not None:
            print(explain(options.explain), end="")
            return 0
        check_lief()  # whose absence is told first
        return (
            1
            if check(options.fmus, options.json, options.timeout, options.all, options.format, options.out)
            else 0
        )
    except (OSError, HostError, ValueError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return NO_VERDICT if isinstance(error, HostError) else 1
