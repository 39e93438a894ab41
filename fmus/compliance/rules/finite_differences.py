"""Finite differences beside which rules judge derivatives and dependencies: between runs that differ in one
value alone, and between values of one run.
"""

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance.actions import Pair
from fmus.compliance.probe import Probe
from fmus.compliance.script import Action
from fmus.compliance.values import same, start_value, texts
from fmus.compliance.variable import Variable

Values = dict[str, Any]
ANY_STEP = "canHandleVariableCommunicationStepSize"
NOISE = 1e-9  # relative to a value: an iteration may stop elsewhere
_ROUNDING = 1e-12  # relative to a value: some thousand roundings of it
_CLOSE, _SHARE = 1e-6, 0.1  # of a change: two values that are as close give changes that are as equal
_ROUGH = 0.1  # relative: of slopes over a step, which is no limit
_FAR = 10.0  # times: a derivative of one communication point, and not of the next


def values_of(probe: Probe, runs: Iterable[Iterable[Action]]) -> list[list[Values]]:
    """Returns the values of each reading of each run, played once for all rules; none of a run that fails."""
    scripts = [probe.script(*actions) for actions in runs]
    probe.play_once(scripts)
    return [[reading.values for reading in script.readings] if script.succeeded else [] for script in scripts]


class Column:
    """A column of the matrix d(unknown) / d(known) at a point: the values of unknowns in runs that differ in
    the value of the known alone.

    point: values of other knowns; before, after: actions before values are set, and up to where unknowns are
      read; xs, rows: values of the known and of the unknowns, of the runs that succeed
    """

    def __init__(
        self, probe: Probe, before: Sequence[Action], known: Variable, values: Sequence[Any],
        after: Sequence[Action], point: Sequence[Pair] = (),
    ) -> None:  # fmt: skip
        others = {v.index: (v, x) for v, x in point}
        points = [(others | {known.index: (known, x)}).values() for x in values]
        readings = values_of(probe, [(*before, do.set_values(pairs), *after) for pairs in points])
        self.xs = [x for x, run in zip(values, readings, strict=True) if run]
        self.rows = [run[-1] for run in readings if run]
        self.is_whole = len(self.rows) == len(values)

    def quotients(self, name: str) -> list[float]:
        """Returns the difference quotients of an unknown, each between another run and the first."""
        others = zip(self.xs[1:], self.rows[1:], strict=True)
        return [(row[name] - self.rows[0][name]) / (x - self.xs[0]) for x, row in others]

    def rounding(self, name: str) -> float:
        """Returns how far rounding of the unknown may change its quotients."""
        return _ROUNDING * max(abs(row[name]) for row in self.rows) / abs(self.xs[1] - self.xs[0])

    def changed(self, tolerance: float = NOISE) -> set[str]:
        """Returns the names of the unknowns that differ between the first run and another."""
        first, *others = self.rows
        return {name for row in others for name, x in first.items() if not same(x, row[name], tolerance)}


def followers(
    probe: Probe, before: Sequence[Action], known: Variable, value: Any, after: Sequence[Action]
) -> set[str]:
    """Returns the names of the unknowns that change when a known has another value, by more than an iteration
    leaves: not as much between two values that are almost one. Arguments as of `Column`.
    """
    start = start_value(known)
    column = Column(probe, before, known, (start, value), after)
    names = column.changed() if column.is_whole else set[str]()
    if not names or not isinstance(start, float):
        return names
    near = Column(probe, before, known, (start, value, value + _CLOSE * (value - start)), after)
    if not near.is_whole:
        return names
    a, b, c = near.rows
    reals = (name for name in names if isinstance(a[name], float))
    return names - {name for name in reals if abs(c[name] - b[name]) > _SHARE * abs(b[name] - a[name])}


class Slopes:
    """Derivatives at communication points beside the slopes of the values before and after them.

    order: of the derivatives; one that is higher may be rough
    """

    def __init__(
        self, values: Sequence[float], derivatives: Sequence[float], step_size: float, order: int = 1
    ) -> None:
        self._rough = _ROUGH * 10.0 ** (order - 1)
        self._values, self._derivatives, self._step_size = values, derivatives, step_size
        self._sides = list(itertools.pairwise((b - a) / step_size for a, b in itertools.pairwise(values)))
        self._rounding = NOISE * max(map(abs, values)) / step_size

    def wrong(self) -> str:
        """Returns a message if over half of the derivatives are wrong, and not 0."""
        pairs = zip(self._derivatives[1:-1], self._sides, strict=True)
        wrong = [(x, *sides) for x, sides in pairs if x and self._is_wrong(x, *sides)]
        if len(wrong) <= (len(self._sides) + 1) // 2:  # a jump or an event is not a wrong derivative
            return ""
        shown = texts(*wrong[0])
        return f"its derivative is {shown[0]}: expected about {shown[1]}..{shown[2]}, its slopes"

    def _is_wrong(self, derivative: float, before: float, after: float) -> bool:
        margin = 2 * abs(after - before) + self._rough * max(abs(before), abs(after)) + self._rounding
        return not min(before, after) - margin <= derivative <= max(before, after) + margin

    def are_late(self) -> bool:
        """Whether each derivative is the mean slope around the communication point before, and not around its
        own: nearer by far, and not for rounding.
        """
        means = [(before + after) / 2 for before, after in self._sides]
        own = [abs(x - mean) for x, mean in zip(self._derivatives[2:-1], means[1:], strict=True)]
        late = [abs(x - mean) for x, mean in zip(self._derivatives[2:-1], means, strict=False)]
        return bool(own) and min(own) > _FAR * max([self._rounding, *late])
