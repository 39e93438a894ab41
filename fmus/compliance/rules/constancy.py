"""Rules of values that change only when they may: constant, fixed and tunable ones, and inputs."""

import struct
from collections.abc import Iterator, Sequence

from fmus.compliance.accepted import accepted
from fmus.compliance.comparison import same, texts, unlike
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, behaviour_rule
from fmus.compliance.script import Reading, Script
from fmus.compliance.values import other_values, settable_while_stepping, start_value
from fmus.compliance.variable import Variable

_VARIABLES = "2.2.7 Definition of Model Variables (ModelVariables)"
_ROUNDED, _LARGEST_SINGLE = 1e-6, 3e38
_NOISE = 1e-9  # relative: a value that is computed again is rounded, an iteration may stop elsewhere
_MOST_VARIABLES = 50
_STEPS = (1, 1, 4, 10)  # between the readings of a run


def _in_single_precision(value: float) -> float:
    return struct.unpack("f", struct.pack("f", value))[0] if abs(value) < _LARGEST_SINGLE else value


def _constants(probe: Probe) -> list[Variable]:
    return [v for v in probe.fmu.variables if v.variability == "constant" and start_value(v) is not None]


@behaviour_rule(_VARIABLES, needs="communication-points-may-be-rounded")
def constants_have_their_value(probe: Probe) -> Iterator[str]:
    """Constants have their start value after steps."""
    constants = _constants(probe)
    script = probe.script().begin()
    readings = [script.step(count).read(constants) for count in _STEPS]
    script.play()
    expected = [(v, start_value(v), reading) for reading in readings for v in constants]
    for v, value, start in unlike(expected, _ROUNDED):
        yield f"{v.name} is {value}, a constant: expected {start}"


@behaviour_rule(
    "advice: Reals are double, and 2.2.7 tells no precision of constants",
    needs="constants-have-their-value",
)
def constants_have_double_precision(probe: Probe) -> Iterator[str]:
    """Constants are not held in single precision."""
    constants = _constants(probe)
    script = probe.script().begin()
    reading = script.step().read(constants)  # the first step alone: an FMU may discard a later one
    script.play()
    for v in constants:
        start, value = start_value(v), reading.values[v.name]
        if isinstance(start, float) and value != start and value == _in_single_precision(start):
            shown = texts(value, start)
            yield f"{v.name} is {shown[0]}, a constant in single precision: expected {shown[1]}"


@behaviour_rule(_VARIABLES, needs="communication-points-may-be-rounded")
def fixed_values_stay(probe: Probe) -> Iterator[str]:
    """Fixed and tunable variables, and inputs, change by steps only if the importer sets them."""
    chosen = [
        v for v in probe.fmu.variables if v.variability in ("fixed", "tunable") or v.causality == "input"
    ]
    script = probe.script().begin()
    readings = [script.read(chosen), *(script.step(count).read(chosen) for count in _STEPS)]
    script.play()
    yield from _moved(readings, "after steps")


def _moved(readings: Sequence[Reading], when: str) -> Iterator[str]:
    """Yields the first change of each variable."""
    named = set()
    for reading in readings[1:]:
        for name, value in reading.values.items():
            first = readings[0].values[name]
            if not same(value, first, _NOISE) and name not in named:
                named.add(name)
                new, old = texts(value, first)
                yield f"{name} is {new} {when}: expected {old} as before"


@behaviour_rule(_VARIABLES, needs="fixed-values-stay allowed-calls-succeed")
def fixed_values_follow_nothing(probe: Probe) -> Iterator[str]:
    """Fixed values do not follow inputs and tunable parameters that are set at communication points,
    tunable ones do not follow inputs.
    """
    settable = settable_while_stepping(probe.fmu)
    fixed = [v for v in probe.fmu.variables if v.variability == "fixed"]
    tunable = [v for v in probe.fmu.variables if v.variability == "tunable"]
    inputs = [v for v in settable if v.causality == "input"]
    for changed, chosen, what in (
        (inputs, [*fixed, *tunable], "inputs"),
        ([v for v in settable if v.causality == "parameter"], fixed, "tunable parameters"),
    ):
        pairs = other_values(changed[:_MOST_VARIABLES])
        if pairs and chosen:
            readings = _around_a_change(probe, pairs, chosen)
            yield from _moved(readings, f"after other {what}")


def _around_a_change(
    probe: Probe, pairs: list[tuple[Variable, object]], chosen: list[Variable]
) -> list[Reading]:
    """Returns readings before and after values that the FMU accepts alone are set; nothing without any."""
    script = probe.script().begin().step()
    before = script.read(chosen)
    script.step()
    for v, x in accepted(probe, pairs, lambda: probe.script().begin().step()):
        script.set(v, x)
    after = script.step(2).read(chosen)
    script.play(keep_going=True)
    return [before, after] if script.succeeded else []


@behaviour_rule(_VARIABLES, needs="inputs-that-are-set-are-read values-that-are-set-are-read")
def tunable_values_are_computed_anew(probe: Probe) -> Iterator[str]:
    """A tunable parameter that is set at a communication point gives calculated tunable values as if it
    had been set before.
    """
    computed = [v for v in probe.fmu.variables if v.variability == "tunable" and v.causality != "parameter"]
    settable = [v for v in settable_while_stepping(probe.fmu) if v.causality == "parameter"]
    pairs = other_values(settable[:_MOST_VARIABLES])
    if not computed or not pairs:
        raise NotApplicableError("there is no tunable parameter, or no tunable value that is calculated")
    tried: list[tuple[Variable, Script, Script, Reading, Reading]] = []
    for v, x in pairs:
        early, late = probe.script().initialise(), probe.script().begin().step()
        early.set(v, x)
        late.set(v, x)
        expected = early.exit_initialization_mode().read(computed)
        tried.append((v, early, late, expected, late.step().read(computed)))
    probe.play_each([script for _, early, late, *_ in tried for script in (early, late)])
    for v, early, late, expected, got in tried:
        if not early.succeeded or not late.succeeded:
            continue
        for name, value in expected.values.items():
            if not same(got.values[name], value, _NOISE):
                new, old = texts(got.values[name], value)
                yield (
                    f"{name} is {new} after {v.name} was set at a communication point: expected {old}, as "
                    "if it had been set in initialization mode"
                )
                return
