"""The command line of the check: `l1-depth check` and `python -m fmus.compliance`.

Its head imports what declares the options; the check itself is imported when it runs.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from fmus.compliance.rule import Level


def check(
    fmus: Annotated[
        list[Path] | None, typer.Argument(metavar="FMU...", help="FMUs of any origin.", show_default=False)
    ] = None,
    json_file: Annotated[
        str, typer.Option("--json", metavar="FILE", help="Write the results as JSON; - prints them.")
    ] = "",
    format_name: Annotated[
        Literal["text", "json", "sarif", "junit", "github"],
        typer.Option("--format", help="Format of what is printed, or of --out; github: annotations."),
    ] = "text",
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="Write that format to a file, and print text."),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Show every rule and finding, not only broken rules, folded.")
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="RULE", help="Judge this rule alone; repeat it for others."),
    ] = None,
    all_rules: Annotated[
        bool, typer.Option("--all-rules", help="Judge the rules too that most FMUs break at no cost.")
    ] = False,
    waivers: Annotated[
        Path | None,
        typer.Option("--waivers", metavar="FILE", help="Findings that you accept, with reasons (TOML)."),
    ] = None,
    baseline: Annotated[
        Path | None,
        typer.Option("--baseline", metavar="FILE", help="Fail for findings alone that are not in it."),
    ] = None,
    write_baseline: Annotated[
        bool, typer.Option("--write-baseline", help="Write the present findings to the --baseline.")
    ] = False,
    fail_on: Annotated[
        Level, typer.Option("--fail-on", help="Fail for findings of this level and above.")
    ] = Level.ERROR,
    strict: Annotated[bool, typer.Option("--strict", help="Fail if a rule is not judged.")] = False,
    timeout: Annotated[float, typer.Option("--timeout", help="Seconds that one rule may take.")] = 30.0,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
    rule: Annotated[
        str,
        typer.Option("--explain", metavar="RULE", help="Show what a rule claims and its sentences of FMI."),
    ] = "",
) -> None:
    """Check FMUs against the rules of FMI 2.0.5.

    Exit status: 0, 1 for errors, 2 for wrong use or a missing file, 3 if this machine allows no verdict, 4 if
    --strict and a rule is not judged.
    """
    from fmus.compliance.check import NO_VERDICT, Options, explain
    from fmus.compliance.check import check as status_of
    from fmus.compliance.library_reader import check_lief
    from fmus.errors import HostError, OrchestrationError
    from fmus.fmi.description import describe

    try:
        if rule:
            print(explain(rule), end="")
            return
        check_lief()
        if not fmus:
            raise ValueError("expected FMUs, or --explain RULE")
        if write_baseline and baseline is None:
            raise ValueError("--write-baseline: expected --baseline FILE too")
        if baseline is not None and not write_baseline and not baseline.is_file():
            raise ValueError(f"--baseline {baseline}: no such file: write it once with --write-baseline")
        if not timeout > 0.0:
            raise ValueError(f"--timeout {timeout:g}: expected seconds above 0")
        for path in fmus:
            if not path.is_file():
                describe(path)  # the error names the nearest FMU
        names = [name.strip() for text in only or () for name in text.split(",")]
        options = Options(
            json_file, format_name, out, every, timeout, names, all_rules, waivers, baseline, write_baseline,
            fail_on, strict, quiet,
        )  # fmt: skip
        status = status_of(fmus, options)
    except (ValueError, OSError, OrchestrationError, HostError) as error:
        print(f"l1-depth: {error}", file=sys.stderr)
        status = NO_VERDICT if isinstance(error, HostError) else 2
    raise typer.Exit(status)


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit status of `python -m fmus.compliance` with these arguments."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(check)
    try:
        app(arguments, prog_name="python -m fmus.compliance")
    except SystemExit as end:
        return int(end.code or 0)
    return 0
