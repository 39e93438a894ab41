"""Options, completion, tables, progress and failure, for all commands."""

import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from fmus.errors import nearest
from fmus.registry import Flavour
from orchestration.cli.interrupts import INTERRUPTED
from orchestration.errors import OrchestrationError
from orchestration.results.formats import FigureFormat

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID
    from rich.table import Table

PIPED_WIDTH = 130
NO_FIGURES = "none"


def shipped_scenarios() -> list[str]:
    """Returns the names of the scenarios that ship with the package."""
    from orchestration import scenarios

    return sorted(path.stem for folder in scenarios.__path__ for path in Path(folder).glob("*.toml"))


FlavourOption = Annotated[
    Flavour, typer.Option(help="Use compiled code or Python in the FMUs of this project.")
]
OutFolder = Annotated[Path, typer.Option("--out", metavar="DIR", help="Write to this folder.")]
ScenarioArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="Name of a shipped scenario, or a .toml file.",
        autocompletion=shipped_scenarios,
    ),
]


FigureFormatsOption = Annotated[
    str,
    typer.Option(
        "--formats", metavar="NAME,NAME", help=f"Write figures as {', '.join(FigureFormat)}; or none."
    ),
]


def figure_formats(names: str) -> list[FigureFormat]:
    """Returns the formats of figures, from their names separated by commas; "none" is no figure."""
    if names.strip() == NO_FIGURES:
        return []
    known = [str(ending) for ending in FigureFormat]
    chosen = [name.strip() for name in names.split(",")]
    for name in chosen:
        if name not in known:
            raise OrchestrationError(f"--formats: no format {name!r}; {nearest(name, known)}")
    return [FigureFormat(name) for name in chosen]


def check_writable(folder: Path) -> None:
    """Refuses a folder in which nothing can be written, before long runs begin; leaves nothing behind."""
    try:
        existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        tempfile.TemporaryFile(dir=existing).close()
    except OSError as error:
        raise OrchestrationError(
            f"--out {folder}: {error.strerror}: expected a folder that can be written"
        ) from error


def refuse_without_effect(option: str, others: Mapping[str, object]) -> None:
    """Raises OrchestrationError if one of the other options is given: it has no effect beside this one."""
    for name, value in others.items():
        if value:
            raise OrchestrationError(f"{name}: no effect with {option}: expected one of them")


def fail(message: str, status: int = 1) -> NoReturn:
    """Ends the command with one line on standard error."""
    print(f"l1-depth: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(status)


def print_table(table: "Table", piped_width: int = PIPED_WIDTH) -> None:
    """Prints a table as wide as the terminal, or as `piped_width` without a terminal."""
    console(piped_width).print(table)


def console(piped_width: int = PIPED_WIDTH) -> "Console":
    """Returns the terminal, or a page of that width without a terminal."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else piped_width)


LINE_EVERY_S = 30.0
_FEW = 20  # parts, each of which gets a line


class ProgressBar:
    """A bar of how much of a command is done, shown on a terminal after `delay` seconds.

    Without a terminal, as in a log, standard error gets a line from time to time (`LINE_EVERY_S`), and one
    for each part with a note where there are few.
    """

    def __init__(self, description: str, total: int, delay: float, stack: ExitStack) -> None:
        self._description, self._total, self._stack = description, total, stack
        self._shown_from = time.monotonic() + delay
        self._next_line = time.monotonic() + LINE_EVERY_S
        self._bar: tuple[Progress, TaskID] | None = None
        self.done = 0
        self._show(0, total)

    def advance(self, count: int = 1, note: str = "") -> None:
        """Counts `count` more parts as done; shows `note` beside the description."""
        self._show(self.done + count, self._total, note)

    def update(self, done: int, total: int) -> None:
        """Sets how many parts of `total` are done."""
        self._show(done, total)

    def _show(self, done: int, total: int, note: str = "") -> None:
        self.done = done
        if self._bar is None and not sys.stderr.isatty():
            self._write_line(done, total, note)
        elif self._bar is None and time.monotonic() >= self._shown_from:
            self._bar = self._opened()
        if self._bar:
            bar, task = self._bar
            description = f"{self._description} {note}".rstrip()
            bar.update(task, completed=done, total=total, description=description)

    def _write_line(self, done: int, total: int, note: str) -> None:
        if time.monotonic() >= self._next_line or (note and 0 < total <= _FEW):
            self._next_line = time.monotonic() + LINE_EVERY_S
            count = f"{done} of {total}" if total else f"{done}"
            print(f"{self._description} {note}".rstrip() + f": {count}", file=sys.stderr, flush=True)

    def _opened(self) -> "tuple[Progress, TaskID]":
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            redirect_stdout=sys.stdout.isatty(),  # what goes into a pipe must not end on the terminal
            transient=True,
        )
        return self._stack.enter_context(bar), bar.add_task(self._description, total=self._total or None)


@contextmanager
def progress(description: str, total: int, delay: float = 0.0, kept: str = "") -> Iterator[ProgressBar]:
    """Shows a progress bar on standard error, if that is a terminal, until the context ends.

    total: of the parts, 0 if nobody knows it
    delay: seconds after which it is shown; what draws it takes as long to import as a short run takes
    kept: noun for the parts that an interruption keeps, where the same command continues
    """
    with ExitStack() as stack:
        bar = ProgressBar(description, total, delay, stack)
        try:
            yield bar
        except KeyboardInterrupt:
            if not kept:
                raise
            done = f"{bar.done} of {total} {kept} are done and kept"
            fail(f"interrupted: {done}; the same command continues", INTERRUPTED)
