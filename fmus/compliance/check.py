"""The command line of the check: `l1-depth check` and `python -m fmus.compliance`.

The head of this file imports what declares the options; the check itself is imported when it runs.
"""

import gc
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fmus.compliance.rule import Level, Result, repeated
from fmus.compliance.texts import ALLOCATIONS

if TYPE_CHECKING:
    from fmus.compliance.report import Checked

PANEL = "FMUs"  # of the help of l1-depth
NO_VERDICT, NOT_JUDGED = 3, 4  # exit status


def check(
    fmus: Annotated[
        list[Path] | None, typer.Argument(metavar="FMU", help="FMUs of any origin.", show_default=False)
    ] = None,
    format_name: Annotated[
        Literal["text", "json", "sarif", "junit", "github"],
        typer.Option("--format", help="Format of what is printed, or of --out; github: annotations."),
    ] = "text",
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write that format to a file, and print text.")
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Show every rule that is judged and every finding, also accepted.")
    ] = False,
    only: Annotated[str, typer.Option(metavar="RULE,RULE", help="Judge only these rules.")] = "",
    waivers: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Accept the findings of this file (TOML).")
    ] = None,
    baseline: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Accept the findings that were written to this file.")
    ] = None,
    write_baseline: Annotated[
        bool, typer.Option("--write-baseline", help="Write the present findings to the --baseline.")
    ] = False,
    fail_on: Annotated[Level, typer.Option(help="Fail for findings of this level and above.")] = Level.ERROR,
    strict: Annotated[bool, typer.Option("--strict", help="Fail if a rule is not judged.")] = False,
    reproduce: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Write programs of C and FMPy that make the calls below findings."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random runs of the FMU.")] = 1,
    timeout: Annotated[float, typer.Option(min=0.1, help="Longest time of a rule [s].")] = 30.0,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
    rule: Annotated[
        str,
        typer.Option("--explain", metavar="RULE", help="Show what a rule claims and its sentences of FMI."),
    ] = "",
) -> None:
    """Check FMUs against the rules of FMI 2.0.5 and FMI 3.0.2.

    Exit status: 0; 1 for errors; 2 for wrong use or a missing file; 3 if this machine allows no verdict;
    4 with --strict, if a rule is not judged.

    For example, l1-depth check plant.fmu --format junit --out check.xml prints text and writes a file for CI.
    """
    gc.set_threshold(ALLOCATIONS)
    from fmus.compliance import findings, report
    from fmus.compliance.behaviour import host_errors
    from fmus.compliance.rule import all_rules
    from fmus.errors import HostError, OrchestrationError
    from fmus.files import write_text_atomically

    names = [known.name for known in all_rules()]
    try:
        if rule:
            print(report.explain(rule, all_rules()), end="")
            return
        chosen = _chosen(only, names)
        paths = list(dict.fromkeys(fmus or []))
        outputs = {"--out": out, "--baseline": baseline if write_baseline else None}
        _refuse_wrong_use(paths, baseline, write_baseline)
        _refuse_outputs(outputs, [*paths, waivers, None if write_baseline else baseline])
        permitted = findings.read_waivers(waivers, names) if waivers else []
        known = findings.read_baseline(baseline) if baseline and not write_baseline else {}
        results = _judged(paths, chosen or names, timeout, quiet, seed)
        found, today = findings.findings_of(results), date.today()
        left = findings.without_known(findings.waived(found, permitted, today), known)
        checked = report.Checked(results, left, fail_on, every)
        of_chosen = [waiver for waiver in permitted if not chosen or waiver.rule in chosen]
        _tell(*findings.useless(of_chosen, found, today))
        if not chosen and (gone := findings.no_longer_found(known, found, paths)):
            _tell(f"{baseline}: {gone} findings are no longer found: --write-baseline leaves them out")
        with host_errors():
            _print(checked, format_name, out)
            if any(finding.shown.calls for finding in left):
                _tell(f"the seed of the random runs was {seed}")
            if reproduce:
                _write_programs(checked, reproduce)
            if baseline and write_baseline:
                write_text_atomically(baseline, findings.baseline_text(left))
                _tell(f"{baseline}: written, with {len(checked.open)} findings")
        status = 0 if write_baseline else _status(checked, strict)
    except (ValueError, OSError, OrchestrationError, HostError) as error:
        _tell(str(error))
        status = NO_VERDICT if isinstance(error, HostError) else 2
    raise typer.Exit(status)


def _tell(*lines: str) -> None:
    for line in lines:
        print(f"l1-depth: {line}", file=sys.stderr)


def _chosen(only: str, names: Sequence[str]) -> list[str]:
    from fmus.errors import nearest

    chosen = [name.strip() for name in only.split(",") if name.strip()]
    if only and not chosen:
        raise ValueError(f"--only {only}: expected names of rules")
    for name in chosen:
        if name not in names:
            raise ValueError(f"--only: no rule {name!r}: {nearest(name, names)}")
    return chosen


def _refuse_wrong_use(fmus: Sequence[Path], baseline: Path | None, write_baseline: bool) -> None:
    from fmus.fmi.description import describe

    if not fmus:
        raise ValueError("expected FMUs, or --explain RULE")
    if write_baseline and baseline is None:
        raise ValueError("--write-baseline: expected --baseline FILE too")
    if baseline and not write_baseline and not baseline.is_file():
        raise ValueError(f"--baseline {baseline}: no such file: write it once with --write-baseline")
    if baseline and (names := repeated(path.name for path in fmus)):
        raise ValueError(f"--baseline: FMUs of one name, {', '.join(names)}: expected different names")
    for path in fmus:
        if not path.is_file():
            # its error names the nearest FMU
            describe(path)


def _refuse_outputs(outputs: Mapping[str, Path | None], inputs: Sequence[Path | None]) -> None:
    """Raises ValueError for a file that cannot be written, or that is read or written otherwise."""
    used = [path.resolve() for path in inputs if path]
    for option, path in outputs.items():
        if path and path.is_dir():
            raise ValueError(f"{option} {path}: it is a folder: expected a file")
        if path and path.resolve() in used:
            raise ValueError(f"{option} {path}: it is another input or output: expected a separate file")
        used += [path.resolve()] if path else []


def _judged(
    fmus: Sequence[Path], names: Collection[str], timeout: float, quiet: bool, seed: int
) -> dict[Path, list[Result]]:
    """Returns the results of each FMU, of the rules of these names."""
    from fmus.compliance.examine import examine

    results = dict[Path, list[Result]]()
    with _progress(quiet, len(fmus)) as show:
        for number, path in enumerate(fmus, 1):
            show(f"check {number} of {len(fmus)}: {path.name}")
            results[path] = examine(path, timeout, names, seed)
    return results


@contextmanager
def _progress(quiet: bool, count: int) -> Iterator[Callable[[str], None]]:
    """Gives a function that shows a text on standard error: in one place of a terminal, else as a line.

    count: of FMUs; one alone takes seconds and gets no line
    """
    if quiet or not sys.stderr.isatty():
        is_silent = quiet or count == 1
        yield lambda text: None if is_silent else print(text, file=sys.stderr, flush=True)
        return
    from rich.console import Console
    from rich.markup import escape

    with Console(stderr=True).status("") as status:
        yield lambda text: status.update(escape(text))


def _print(checked: "Checked", format_name: str, out: Path | None) -> None:
    """Prints the report, or the text beside a file of it; what cannot be encoded is escaped."""
    from fmus.compliance import report
    from fmus.files import write_bytes_atomically

    document = report.FORMATS[format_name](checked)
    shown = document if out is None else report.text(checked)
    encoding = sys.stdout.encoding or "utf-8"
    print(shown.encode(encoding, "backslashreplace").decode(encoding), end="")
    if out is not None:
        write_bytes_atomically(out, document.encode("utf-8", "backslashreplace"))


def _write_programs(checked: "Checked", folder: Path) -> None:
    """Writes a program of each language for each finding whose calls are known."""
    from fmus.files import write_text_atomically

    folder.mkdir(parents=True, exist_ok=True)
    for finding in checked.findings:
        for suffix, program in finding.shown.programs.items():
            path = folder / f"{finding.fmu.stem}-{finding.rule.name}.{suffix}"
            write_text_atomically(path, program)
            _tell(f"{path}: written")


def _status(checked: "Checked", strict: bool) -> int:
    from fmus.compliance.report import failure, unloaded
    from fmus.errors import HostError

    if found := failure(checked):
        _tell(f"{found}: expected none")
        return 1
    if reasons := unloaded(checked.results):
        raise HostError("; ".join(reasons))
    count = sum(bool(result.not_judged) for results in checked.results.values() for result in results)
    if strict and count:
        _tell(f"--strict: {count} rules are not judged: expected none")
        return NOT_JUDGED
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit status of `python -m fmus.compliance` with these arguments."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(check)
    try:
        app(arguments, prog_name="python -m fmus.compliance")
    except SystemExit as end:
        return int(end.code or 0)
    return 0
