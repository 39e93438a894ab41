"""Derivatives of outputs and of inputs in time; finite differences beside which rules judge derivatives and
dependencies: between runs that differ in one value alone, and between values of one run.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row, Start, differential, starts
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.script import Action, CallError
from fmus.compliance.variable import Variable
from fmus.fmi.binding import WARNING

Values = dict[str, Any]
NOISE = 1e-9  # relative to a value: an iteration may stop elsewhere
_ROUNDING = 1e-12  # relative to a value: some thousand roundings of it
_CLOSE, _SHARE = 1e-6, 0.1  # of a change: two values that are as close give changes that are as equal
_ROUGH = 0.1  # relative: of slopes over a step, which is no limit
_FAR = 10.0  # times: a derivative of one communication point, and not of the next
_INTERPOLATES = values.unless_claimed(values.INTERPOLATES)
_STEPS = 8
_SHORT = 0.30901699  # of a step: no simple fraction, so that nothing that repeats with it stands still
_BEYOND = 1.5  # times the effect of the value that an input reaches: no step moves outputs more
_FELT = 0.1  # of the effect of the input, at least: of a response by n integrators it is 1 / (n + 1)


# finite differences


def values_of(probe: Probe, runs: Iterable[Iterable[Action]]) -> list[list[Values]]:
    """Returns the values of each reading of each run, played once for all rules; none of a run that fails."""
    scripts = [probe.script(*actions) for actions in runs]
    probe.play_once(scripts)
    return [[reading.values for reading in script.readings] if script.succeeded else [] for script in scripts]


class Column:
    """A column of the matrix d(unknown) / d(known) at a point: the values of unknowns in runs that differ in
    the value of the known alone.

    xs, rows: values of the known and of the unknowns, of the runs that succeed
    """

    def __init__(self, xs: Sequence[Any], rows: Sequence[Values]) -> None:
        self.xs = [x for x, row in zip(xs, rows, strict=True) if row]
        self.rows = [row for row in rows if row]
        self.is_whole = len(self.rows) == len(xs)

    def quotients(self, name: str) -> list[float]:
        """Returns the difference quotients of an unknown, each between another run and the first."""
        others = zip(self.xs[1:], self.rows[1:], strict=True)
        return [(row[name] - self.rows[0][name]) / (x - self.xs[0]) for x, row in others]

    def rounding(self, unknown: Variable) -> float:
        """Returns how far rounding of the unknown may change its quotients: terms of the size of its nominal
        value may cancel.
        """
        size = max(unknown.nominal, *(abs(row[unknown.name]) for row in self.rows))
        return _ROUNDING * size / abs(self.xs[1] - self.xs[0])

    def changed(self, tolerance: float = NOISE) -> set[str]:
        """Returns the names of the unknowns that differ between the first run and another."""
        first, *others = self.rows
        return {n for row in others for n, x in first.items() if not values.same(x, row[n], tolerance)}


def columns(
    probe: Probe, before: Sequence[Action], knowns: Sequence[tuple[Variable, Sequence[Any]]],
    after: Sequence[Action], point: Sequence[do.Pair] = (), in_turn: bool = False,
) -> Iterator[Column]:  # fmt: skip
    """Yields the column of each known, for some of its values.

    point: values of other knowns; before, after: actions before values are set, and up to where unknowns are
      read; in_turn: whether one run has all values of all knowns, one after another
    """
    others = {v.index: (v, x) for v, x in point}
    points = [
        (do.set_point((others | {known.index: (known, x)}).values()), *after)
        for known, xs in knowns
        for x in xs
    ]
    runs = [itertools.chain(*points)] if in_turn else points
    readings = values_of(probe, [(*before, *run) for run in runs])
    found = (readings[0] or [{}] * len(points)) if in_turn else [run[-1] if run else {} for run in readings]
    rows = iter(found)
    return (Column(xs, list(itertools.islice(rows, len(xs)))) for _, xs in knowns)


def followers(
    probe: Probe, before: Sequence[Action], known: Variable, value: Any, after: Sequence[Action]
) -> set[str]:
    """Returns the names of the unknowns that change with the value of a known, by more than an iterative
    solver leaves: two nearly equal values give a smaller change. Arguments as in `columns`.
    """
    start = known.start_value
    (column,) = columns(probe, before, [(known, (start, value))], after)
    names = column.changed() if column.is_whole else set[str]()
    if not names or not isinstance(start, float):
        return names
    values_near = start, value, value + _CLOSE * (value - start)
    (near,) = columns(probe, before, [(known, values_near)], after)
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
        self, xs: Sequence[float], derivatives: Sequence[float], step_size: float, order: int = 1
    ) -> None:
        self._rough = _ROUGH * 10.0 ** (order - 1)
        self._derivatives = derivatives
        self._sides = list(itertools.pairwise((b - a) / step_size for a, b in itertools.pairwise(xs)))
        self._rounding = NOISE * max(map(abs, xs)) / step_size

    def wrong(self) -> str:
        """Returns a message if over half of the derivatives are wrong, and not 0."""
        pairs = zip(self._derivatives[1:-1], self._sides, strict=True)
        wrong = [(x, *sides) for x, sides in pairs if x and self._is_wrong(x, *sides)]
        # a jump or an event makes few derivatives differ
        if len(wrong) <= (len(self._sides) + 1) // 2:
            return ""
        shown = values.texts(*wrong[0])
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


# derivatives of outputs


def _orders(fmu: FmuFile) -> str:
    return "" if fmu.output_derivative_order > 0 else "maxOutputDerivativeOrder is 0"


def _output_slopes(probe: Probe, order: int, start: Start, part: float = 1.0) -> dict[str, Slopes]:
    """Returns output derivatives of one order beside the slopes of the next lower order, after steps of a
    part of the step size from a start of runs; nothing where short steps fail. Raises CallError where steps
    of the usual size fail.
    """
    size, outputs = part * probe.step_size, values.continuous_reals(probe, "output")
    read = do.read_slopes(outputs, order=order - 1), do.read_slopes(outputs, order=order)

    def step(i: int) -> Action:
        return lambda script: script.call("do_step", script.time + i * size, size)

    steps = itertools.chain(*((step(i), *read) for i in range(_STEPS if outputs else 0)))
    script = do.played(probe, [do.begin, *start.lead, *steps], logging=True)
    if (failure := script.failure) and part == 1.0:
        raise CallError(failure.problem)
    rows = [] if failure else [reading.values for reading in script.readings]
    series = ((v.name, *([row[v.name] for row in rows[k::2]] for k in range(2))) for v in outputs)
    return {
        name: Slopes(xs, slopes, size, order)
        for name, xs, slopes in series
        if xs and all(map(math.isfinite, xs))
    }


@behaviour_rule("4.2.1", condition=_orders)
def output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """A derivative of an output is the slope of the next lower order, or 0 if the FMU has a lower order. It
    is near the difference quotients before and after it, less near for a higher order, early and late in a
    run. The derivative of a discrete output is 0.
    """
    discrete = [v for v in probe.outputs if v.kind == "Real" and v.variability != "continuous"]
    for reading in do.played(probe, [do.begin, do.step(2), do.read_slopes(discrete)]).readings:
        for name, x in reading.values.items() if reading.ok else ():
            if x != 0.0:
                yield f"{name}: its derivative is {x:g}: expected 0, as it is not continuous"
    orders = range(1, probe.fmu.output_derivative_order + 1)
    for start, order in itertools.product(starts(probe) if orders else (), orders):
        short = _output_slopes(probe, order, start, _SHORT) if probe.fmu.claims(values.ANY_STEP) else {}
        for name, slopes in _output_slopes(probe, order, start).items():
            of, wrong = f"{name}, order {order}" if order > 1 else name, slopes.wrong()
            of += start.words
            if wrong and (not short or (name in short and short[name].wrong())):
                yield f"{of}: {wrong}"
            # an event in a usual step may hide the error
            both = slopes, short.get(name, slopes)
            if order == 1 and not wrong and any(series.are_late() for series in both):
                yield f"{of}: its derivative is the slope at the step's begin: expected the slope at its end"


# derivatives of inputs


@differential("4.2.1", condition=_INTERPOLATES)
def input_derivatives(probe: Probe) -> Iterator[Row]:
    """The first derivative of every continuous Real input can be set before a step; zero, also after
    another value, changes nothing; one of initialization mode acts in the first step, unless the FMU warns.
    """
    varied = do.begin, do.set_derivatives(1.0), do.set_derivatives(0.0), do.run(2)
    yield Row("where derivatives of inputs were set to 0", varied, failing="", tolerance=values.RESTARTED)
    early = do.initialise, do.set_derivatives(), do.exit_initialization_mode, do.run(1)
    usual, again = (do.begin, do.set_derivatives(), do.run(1)), "{}, as if they had been set after it"
    when = "where derivatives of inputs were set in initialization mode"
    if WARNING not in {reply.status for reply in do.played(probe, early).replies}:
        yield Row(when, early, usual, tolerance=values.RESTARTED, again=again)


@behaviour_rule("4.2.1", condition=_INTERPOLATES)
def input_derivatives_have_an_effect(probe: Probe) -> Iterator[str]:
    """The derivative of an input moves outputs that follow the input, in the same direction, and at most as
    far as the value that it reaches.
    """
    inputs = _inputs_by_effect(probe)
    for v in inputs["too far"]:
        more = "more than the value that it reaches in a step"
        yield f"the derivative of {v.name} moves outputs {more}: expected less"
    if inputs["backwards"]:
        yield f"the derivative of {inputs['backwards'][0].name} moves outputs against the input in a step"
    for v in inputs["none"]:
        effect = "no effect in a step, or at most a tenth of the effect of its value"
        yield f"the derivative of {v.name} has {effect}, though canInterpolateInputs is true"


def _step(probe: Probe, v: Variable, x: float, slope: float = 0.0) -> Sequence[Action]:
    """Returns actions that make a step with a value of an input, and a derivative unless that is 0."""
    derivative = do.call("fmi2SetRealInputDerivatives", values.references_of([v]), 1, [1], [slope])
    begin = do.begin, do.step(), do.set_values([(v, x)])
    return *begin, *([derivative] if slope else []), do.step(), do.read(probe.outputs)


def _inputs_by_effect(probe: Probe) -> dict[str, list[Variable]]:
    """Returns continuous inputs by what their derivatives do to outputs that follow them."""
    inputs: dict[str, list[Variable]] = {"right": [], "none": [], "backwards": [], "too far": []}
    for v, value in values.other_values(values.continuous_reals(probe, "input")):
        start = v.start_value
        slope = (value - start) / probe.step_size
        # held, with another value, half way to that, and moving to it by its derivative
        ways = (start,), (value,), ((start + value) / 2,), (start, slope)
        runs = values_of(probe, [_step(probe, v, *way) for way in ways])
        held, raised, halfway, moving = (rows[0] for rows in runs) if all(runs) else ({},) * 4
        names = [
            name
            # a solver that begins anew moves outputs as much for any value
            for name, x in held.items()
            if isinstance(x, float) and abs(raised[name] - halfway[name]) > _FELT * abs(raised[name] - x)
        ]
        pairs = [(raised[name] - held[name], moving[name] - held[name]) for name in names]
        if pairs:
            effect, moved = max(pairs, key=lambda pair: abs(pair[0]))
            is_backwards = effect * moved < 0.0 and abs(moved) > _FELT * abs(effect)
            is_none = all(abs(moved) <= _FELT * abs(effect) for effect, moved in pairs)
            is_far = all(abs(moved) > _BEYOND * abs(effect) for effect, moved in pairs)
            kinds = {"none": is_none, "backwards": is_backwards, "too far": is_far, "right": True}
            inputs[next(kind for kind, is_so in kinds.items() if is_so)].append(v)
    return inputs
