"""Judge FMUs and print the findings: `python -m fmus.compliance FMU...`."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from fmus.compliance import report
from fmus.compliance.behaviour import DEFAULT_TIMEOUT_S, host_errors
from fmus.compliance.examine import examine
from fmus.compliance.rule import Result
from fmus.errors import HostError

NO_VERDICT = 3  # exit status


def check(
    fmus: Sequence[Path],
    json_file: str | None = None,
    timeout: float = DEFAULT_TIMEOUT_S,
    every: bool = False,
) -> int:
    """Judge FMUs and print the findings; returns the number of errors.

    every: print each rule, also those that hold. Raises OSError for a file that is not there, HostError if
    this machine does not allow a verdict.
    """
    findings = {path: examine(path, timeout) for path in fmus}
    if json_file != "-":
        for path, results in findings.items():
            _print_findings(path, results, every)
    if json_file:
        with host_errors():
            report.write_json(findings, json_file)
    return report.count(findings, "error")


def _print_findings(path: Path, results: Sequence[Result], every: bool) -> None:
    print(f"{path}: {report.summary(results)}")
    for line in report.lines(results, every):
        print(f"  {line}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status: 0 without an error, 1 with one, 2 for bad usage, 3 if this machine allows no verdict."""
    parser = argparse.ArgumentParser(prog="python -m fmus.compliance", description="Judge FMUs by FMI 2.0.5.")
    parser.add_argument("fmus", nargs="+", type=Path, metavar="FMU")
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON, to - for standard output")
    parser.add_argument("--timeout", type=float, default=DEFAULT_TIMEOUT_S, help="seconds for one behaviour")
    parser.add_argument("--all", action="store_true", help="show every rule, not only those broken")
    options = parser.parse_args(arguments)
    try:
        return 1 if check(options.fmus, options.json, options.timeout, options.all) else 0
    except (OSError, HostError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return NO_VERDICT if isinstance(error, HostError) else 1
