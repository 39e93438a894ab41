"""Judge FMUs, print the findings and return an exit status."""

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from fmus.compliance import findings, report
from fmus.compliance.behaviour import DEFAULT_TIMEOUT_S, host_errors
from fmus.compliance.examine import examine
from fmus.compliance.library_reader import close_reader
from fmus.compliance.registry import all_rules
from fmus.compliance.rule import Level
from fmus.compliance.sentences import off_by_default
from fmus.errors import HostError, nearest

NO_VERDICT, NOT_JUDGED = 3, 4  # exit status
_SHOWN_AFTER_S = 2.0


@dataclass(frozen=True)
class Options:
    """Choices of a check; the names are those of the command line.

    format: one of `report.FORMATS`; out: a file for the findings in that format, then text is printed too;
    all: show each rule, also those that hold, and each finding; timeout: seconds for one behaviour
    """

    json: str = ""
    format: str = "text"
    out: Path | None = None
    all: bool = False
    timeout: float = DEFAULT_TIMEOUT_S
    only: Sequence[str] = ()
    all_rules: bool = False
    waivers: Path | None = None
    baseline: Path | None = None
    write_baseline: bool = False
    fail_on: Level = Level.ERROR
    strict: bool = False
    quiet: bool = False


def check(fmus: Sequence[Path], options: Options) -> int:
    """Judges FMUs and prints the findings; returns the exit status.

    0 if no finding of `fail_on` or above is left, else 1; 4 if a rule is not judged, with `strict`. Raises
    ValueError for wrong options or files, OSError for a file that is not there, HostError if this machine
    does not allow a verdict, such as for a library that it cannot load.
    """
    names = [rule.name for rule in all_rules()]
    for name in options.only:
        if name not in names:
            raise ValueError(f"--only: no rule {name!r}: {nearest(name, names)}")
    waivers = findings.read_waivers(options.waivers, names) if options.waivers else []
    is_compared = options.baseline and not options.write_baseline
    known = findings.read_baseline(options.baseline) if options.baseline and is_compared else {}

    off = frozenset() if options.all_rules or options.only else off_by_default()
    results = {}
    try:
        with _progress(len(fmus), options.quiet) as begin:
            for path in fmus:
                begin(path.name)
                results[path] = findings.chosen(examine(path, options.timeout), options.only, off)
    finally:
        close_reader()
    today, found = date.today(), findings.findings_of(results)
    of_rules = [w for w in waivers if not options.only or w.rule in options.only]
    _tell(findings.useless(of_rules, found, today))
    left = findings.without_known(findings.waived(found, waivers, today), known)
    checked = report.Checked(results, left, options.fail_on, sorted(off), options.all)
    with host_errors():
        if options.baseline and options.write_baseline:
            options.baseline.write_text(findings.baseline_text(left), encoding="utf-8")
            _tell([f"{options.baseline}: written, with {len(checked.open)} findings"])
        _print(checked, options)
    return 0 if options.write_baseline else _status(checked, options)


def _tell(lines: Sequence[str]) -> None:
    for line in lines:
        print(f"l1-depth: {line}", file=sys.stderr)


def _print(checked: report.Checked, options: Options) -> None:
    document = report.FORMATS[options.format](checked)
    if options.out is not None:
        options.out.write_text(document, encoding="utf-8")
        document = report.text(checked)
    if options.json == "-":
        document = report.json_text(checked)
    elif options.json:
        Path(options.json).write_text(report.json_text(checked), encoding="utf-8")
    print(document, end="")


def _status(checked: report.Checked, options: Options) -> int:
    if count := len(checked.failing):
        what = "error" if options.fail_on is Level.ERROR else "finding"
        _tell([f"{count} {what}{'s' * (count > 1)} found: expected none"])
        return 1
    if reasons := report.unloaded(checked.results):
        raise HostError("; ".join(reasons))
    if options.strict and (count := sum(bool(r.not_judged) for of in checked.results.values() for r in of)):
        _tell([f"--strict: {count} rules are not judged: expected none"])
        return NOT_JUDGED
    return 0


@contextmanager
def _progress(total: int, quiet: bool) -> Iterator[Callable[[str], None]]:
    """Shows on standard error which FMU is checked and since when, if that is a terminal and takes long.

    Gives a function that is called with the name of each FMU before it is checked.
    """
    if quiet or not sys.stderr.isatty():
        yield lambda name: None
        return
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    name_of_fmu = TextColumn("check {task.description}", markup=False)
    columns = SpinnerColumn(), name_of_fmu, MofNCompleteColumn(), TimeElapsedColumn()
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task("", total=total, completed=-1)
    timer = threading.Timer(_SHOWN_AFTER_S, bar.start)
    timer.start()
    try:
        yield lambda name: bar.update(task, advance=1, description=name)
    finally:
        timer.cancel()
        timer.join()  # it may be at work
        bar.stop()


def explain(name: str) -> str:
    """Returns what a rule claims and checks. Raises ValueError for a name that no rule has."""
    return report.explain(name, all_rules())
