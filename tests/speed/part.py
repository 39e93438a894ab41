"""What every measurement is given, and what it gives: tables, and figures beside their targets."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from orchestration.errors import OrchestrationError
from tests.speed.states import State

_MANY = 10  # values, of which the half in the middle tells more than the extremes


@dataclass(frozen=True)
class Options:
    """How to measure.

    folder: for files, which are removed afterwards
    now, before: the states to compare; `before` may be missing
    quick: smallest sizes and one round, which show that all works
    """

    folder: Path
    now: State
    before: State | None = None
    quick: bool = False

    @property
    def states(self) -> list[State]:
        """The one before first."""
        return [*filter(None, [self.before]), self.now]

    def rounds(self, number: int) -> int:
        return 1 if self.quick else number

    def equality(self, are_equal: bool) -> str:
        """A cell on results of both states. Raises OrchestrationError if one state gives different ones."""
        if not are_equal and self.before and self.before.sources.samefile(self.now.sources):
            raise OrchestrationError("results of one state differ: expected equal bit for bit")
        return "equal bit for bit" if are_equal else "different"


@dataclass(frozen=True)
class Table:
    """Cells in Markdown. name: of its place in docs/performance.md."""

    name: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]

    @property
    def markdown(self) -> str:
        """The first column is of words, the others of numbers if all their cells begin with one."""
        columns = list(zip(*self.rows, strict=True))
        numbers = [all(cell.lstrip("-")[:1].isdigit() or not cell for cell in column) for column in columns]
        rule = ["---:" if i and right else "---" for i, right in enumerate(numbers)]
        return "".join(f"| {' | '.join(row)} |\n" for row in (self.headings, rule, *self.rows))


@dataclass(frozen=True)
class Goal:
    """What people wait for: a figure with its target, that before or why there is none, that of others."""

    what: str
    target: str
    now: str
    before: str = ""
    others: str = ""


@dataclass(frozen=True)
class Part:
    """What a measurement gives."""

    tables: Sequence[Table]
    goals: Sequence[Goal] = ()


def spread(values: Sequence[float], digits: int = 2, unit: str = "") -> str:
    """The median, and in brackets the least and the largest, or of many values the half in the middle."""
    least, most = limits(values)
    text = f"{median(values):.{digits}f}{unit and ' ' + unit}"
    return text if len(values) == 1 else f"{text} ({least:.{digits}f} to {most:.{digits}f})"


def limits(values: Sequence[float]) -> tuple[float, float]:
    """What `spread` has in brackets."""
    ordered = sorted(values)
    cut = len(ordered) // 4 if len(ordered) > _MANY else 0
    return ordered[cut], ordered[-1 - cut]


def ratios(after: Sequence[float], before: Sequence[float]) -> list[float]:
    """Of rounds in which both took turns."""
    return [new / old for new, old in zip(after, before, strict=True)]
