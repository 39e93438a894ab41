"""Rules of setting up and initialising an FMU."""

from collections.abc import Iterator

from fmus.compliance.accepted import accepted
from fmus.compliance.comparison import differing, failing_or_differing, unlike
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.script import KINDS, CallError, Script
from fmus.compliance.values import other_value, other_values, settable_in_initialization, start_value
from fmus.compliance.variable import Variable

_INITIALIZATION = "2.1.6 Initialization, Termination, and Resetting an FMU"
_VALUES = "2.1.7 Getting and Setting Variable Values"
_MOST_VARIABLES = 50
_ROUNDED = 1e-6


@behaviour_rule(_INITIALIZATION)
def set_up_can_be_repeated(probe: Probe) -> Iterator[str]:
    """fmi2SetupExperiment may be called at least once: the last call counts, for time and stop time, and what
    was set before it stays.
    """
    usual, script = probe.script().begin(), probe.script(logging=True)
    expected = usual.run(2)
    script.set_up(probe.point(7), probe.point(8)).begin()
    got = script.run(2)
    usual.play()
    script.play(keep_going=True)
    yield from failing_or_differing(script, expected, got, "after a second fmi2SetupExperiment")


@behaviour_rule(_INITIALIZATION)
def undefined_tolerance_is_ignored(probe: Probe) -> Iterator[str]:
    """If toleranceDefined is false, tolerance is not looked at, and no stop time is needed."""
    script = probe.script(logging=True)
    script.call("set_up_experiment_with", [], probe.start_time, [], -1.0)
    script.enter_initialization_mode().exit_initialization_mode().step().play(keep_going=True)
    if script.failure:
        yield f"with an undefined tolerance of -1: {script.failure.problem}"


@behaviour_rule("advice: a user may want to see windows")
def visible_instances_run(probe: Probe) -> Iterator[str]:
    """With visible = fmi2True an instance is created and takes a step."""
    script = probe.script(visible=True, logging=True).begin().step()
    try:
        script.play()
    except CallError as error:
        yield f"with visible = fmi2True: {error}"


@behaviour_rule(
    "2.2.7 Definition of Model Variables (ModelVariables)",
    needs="start-values-are-as-declared values-that-are-set-are-read",
)
def exact_values_remain_after_initialization(probe: Probe) -> Iterator[str]:
    """Directly after fmi2ExitInitializationMode a variable with initial exact has its start value, or the
    value that was set.
    """
    chosen = [
        v for v in probe.fmu.variables
        if v.initial == "exact" and v.variability != "constant" and start_value(v) is not None
    ][:_MOST_VARIABLES]  # fmt: skip
    usual = probe.script().begin()
    unchanged = usual.read(chosen)
    tried = [(v, x, probe.script().initialise()) for v in chosen if (x := other_value(v)) is not None]
    readings = []
    for v, value, script in tried:
        script.set(v, value)
        readings.append(script.exit_initialization_mode().read([v]))
    probe.play_each([usual, *(script for *_, script in tried)])
    expected = [(v, start_value(v), unchanged) for v in chosen] if unchanged.ok else []
    expected += [
        (v, x, reading) for (v, x, script), reading in zip(tried, readings, strict=True) if script.succeeded
    ]
    for v, value, exact in unlike(expected, _ROUNDED):
        yield f"{v.name} is {value} after initialisation: expected {exact}, its exact value"


@behaviour_rule(_VALUES, needs="values-that-are-set-are-read")
def values_are_set_together(probe: Probe) -> Iterator[str]:
    """Several variables that are set in one call have the values that they have if each is set in a call of
    its own.
    """
    pairs = other_values(settable_in_initialization(probe.fmu))
    by_kind = {kind: [(v, x) for v, x in pairs if v.base_kind == kind][:_MOST_VARIABLES] for kind in KINDS}
    several = {kind: chosen for kind, chosen in by_kind.items() if len(chosen) > 1}
    if not several:
        raise NotApplicableError("no two variables of one type can be set in initialization mode")
    taken = {
        kind: accepted(probe, chosen, lambda: probe.script().initialise()) for kind, chosen in several.items()
    }
    if not any(len(chosen) > 1 for chosen in taken.values()):
        raise NotJudgedError("no two variables of one type take other values")
    for kind, chosen in taken.items():
        for ordered in (chosen, chosen[::-1]) if len(chosen) > 1 else ():
            messages = list(_differently_set(probe, kind, ordered))
            yield from messages
            if messages:  # the other order has the same cause
                break


def _differently_set(probe: Probe, kind: str, chosen: list[tuple[Variable, object]]) -> Iterator[str]:
    def script_of() -> Script:
        return probe.script().initialise()

    alone, together = script_of(), script_of()
    for v, x in chosen:
        alone.set(v, x)
    contents = [x.encode().hex() if isinstance(x, str) else x for _, x in chosen]
    together.call("set", kind, [v.reference or 0 for v, _ in chosen], contents)
    variables = [v for v, _ in chosen]
    expected = alone.exit_initialization_mode().read(variables)
    got = together.exit_initialization_mode().read(variables)
    probe.play_each([alone, together])
    if failure := alone.failure or together.failure:
        raise NotJudgedError(f"a run with other values fails: {failure.problem}")
    yield from differing([expected], [got], f"where one fmi2Set{kind} sets {len(chosen)} variables")
