"""Actions that scripts consist of: calls on an instance, and readings to be compared."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Concatenate, ParamSpec

from fmus.compliance import values
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError
from fmus.compliance.script import Action, Reading, Script
from fmus.compliance.variable import Variable
from fmus.fmi.binding import ERROR

MOST_VARIABLES = 50  # that are changed in a rule
_MOST_LEAPT, LEAPS, _ROUGHNESS = 100, 8, 300.0  # steps, and times their tolerances
_FEWEST_STEPS, _MEASURED_STEPS, _MOST_STEPS = 10, 40, 5_000  # of a run over the default experiment
_LONGEST_RUN_S = 0.2  # of CPU time
_ALWAYS_STEPS, _ALWAYS_S = 100, 1.0  # so many are taken where they need less CPU time than this
P = ParamSpec("P")
Pair = tuple[Variable, Any]


def _action(method: Callable[Concatenate[Script, P], object]) -> Callable[P, Action]:
    """Returns a function of arguments that returns the action of calling a method with them."""
    return lambda *args, **kwargs: lambda script: method(script, *args, **kwargs)


call = _action(Script.call)
glance, glance_vectors = _action(Script.read), _action(Script.read_vectors)
enter_initialization_mode = call("fmi2EnterInitializationMode")
enter_event_mode = call("fmi2EnterEventMode")
enter_continuous_time_mode = call("fmi2EnterContinuousTimeMode")
terminate, reset = call("fmi2Terminate"), call("fmi2Reset")


def exit_initialization_mode(script: Script) -> None:
    """Goes to where steps are allowed."""
    script.call("exit_initialization_mode")
    script.state = "event mode" if script.probe.fmu.is_model_exchange else "step complete"
    script.next_step = 0


def initialise(script: Script) -> None:
    """Sets the experiment up and enters initialization mode."""
    script.call("set_up_experiment", script.probe.start_time)
    enter_initialization_mode(script)


def begin(script: Script) -> None:
    """Initialises, up to where steps are allowed."""
    script.write([initialise, exit_initialization_mode])


def start(script: Script) -> None:
    """Initialises, and goes on to where the runs of a row begin."""
    script.has_started = True
    script.write([begin, *script.lead])


def forbidden(script: Script) -> None:
    script.is_forbidden = True


def pause(script: Script) -> None:
    """Ends a part: scripts that are played together take turns."""
    script.parts.append(len(script.calls))


def _steps_of_leap(probe: Probe, is_whole: bool = False) -> int:
    """Returns the number of usual steps in a third of the default experiment, limited for a leap."""
    most = _MOST_LEAPT // 2 if probe.fmu.is_model_exchange else _MOST_LEAPT
    third = steps_of_experiment(probe) // 3
    # a rough step for model exchange takes about as long as a usual one
    if is_whole and probe.fmu.is_model_exchange:
        return int(min((probe.stop_time - probe.start_time) / probe.step_size / 3 + 1e-6, LEAPS * third))
    return third if is_whole else min(third, most)


def _leap_to(script: Script, end: float) -> None:
    """Goes to a communication point: by usual steps, or by a rough one for model exchange."""
    if not script.probe.fmu.is_model_exchange:
        script.write([go_on(end - script.next_step)])
        return
    t, script.next_step = script.time, end
    script.call("do_step", t, script.time - t, False, _ROUGHNESS)


@_action
def leap(script: Script, thirds: int, is_whole: bool = False) -> None:
    """Adds a part of the default experiment: usual steps, or few of other sizes for model exchange.

    is_whole: whether to take the part of all steps, however many they are
    """
    count, first = _steps_of_leap(script.probe, is_whole) * thirds, script.next_step
    parts = LEAPS if script.probe.fmu.is_model_exchange else 1
    for i in range(parts):
        _leap_to(script, first + count * (i + 1) // parts)


@_action
def excite(
    script: Script, sets: Sequence[Sequence[Pair]], after: Callable[[Sequence[Pair]], Action] | None = None
) -> None:
    """Sets values, and adds an eighth of the default experiment, as leaps have it, for each of some sets.

    after: returns what follows the eighth of a set
    """
    for i, pairs in enumerate(sets):
        script.write([set_values(pairs)])
        _leap_to(script, 3 * _steps_of_leap(script.probe) * (i + 1) // LEAPS)
        script.write([after(pairs)] if after else [])


@_action
def step(script: Script, count: int = 1, no_going_back: bool = False) -> None:
    """Adds steps of the default experiment's size, from where the script is."""
    for _ in range(count):
        script.call("do_step", script.time, script.probe.step_size, no_going_back)
        script.next_step += 1


def together(*actions: Action) -> Action:
    """Makes some actions one."""
    return lambda script: script.write(actions)


def count_from(number: float) -> Action:
    """Makes a communication point the present one, which the experiment was set up to start at."""
    return lambda script: setattr(script, "next_step", number)


@_action
def advance(script: Script, size: float = 1.0) -> None:
    """Adds a step, in step sizes of the default experiment, from where the script is."""
    script.call("do_step", script.time, size * script.probe.step_size)
    script.next_step += size


@_action
def go_on(script: Script, count: float, observed: Sequence[tuple[str, list[int]]] = ()) -> None:
    """Adds steps of the default experiment's size in one call; the first failed step is the last one.

    observed: see `CalledInstance.do_steps`
    """
    probe = script.probe
    script.call("do_steps", probe.start_time, probe.step_size, script.next_step, count, observed)
    script.next_step += count


@_action
def save(script: Script, slot: int = 0) -> None:
    script.call("save_state", slot)
    script.saved[slot] = script.next_step, script.state


@_action
def restore(script: Script, slot: int = 0) -> None:
    """Sets a saved state back; the next step is the step that followed the save."""
    script.call("set_state", slot)
    script.next_step, script.state = script.saved[slot]


@_action
def copy(script: Script, slot: int, other: int) -> None:
    """Copies a saved state by its bytes."""
    script.call("copy_state", slot, other)
    script.saved[other] = script.saved[slot]


@_action
def read_bytes(script: Script, source: Script) -> None:
    """Makes a saved state of the bytes that another, played script has serialised."""
    script.call("state_of_bytes", 0, source.content)
    script.saved[0] = source.saved[0]


@_action
def set_up(script: Script, stop: float | None, tolerance: float | None = None, start: int = 0) -> None:
    """Sets the experiment up, from communication point number `start` to number `stop`, if one is defined."""
    end = None if stop is None else script.probe.point(stop)
    script.call("set_up_experiment", script.probe.point(start), end, tolerance)


def begin_until(stop: float, tolerance: float | None = None, start: int = 0) -> tuple[Action, ...]:
    """Initialises, with arguments as in `set_up`."""
    return set_up(stop, tolerance, start), enter_initialization_mode, exit_initialization_mode


def in_state(name: str) -> Action:
    """Notes the state that the preceding calls lead to."""
    return lambda script: setattr(script, "state", name)


def set_time(script: Script) -> None:
    """Sets the time to the present time."""
    script.call("set_time", script.time)


def free_state(slot: int = 0) -> Action:
    return call("free_state", slot)


def read(variables: Iterable[Variable], when: str = "", where: str = "") -> Action:
    """Reads variables to be compared, all of one type by one call."""
    return lambda script: script.observed.append((when, where, script.read(variables)))


def read_all(when: str = "", where: str = "") -> Action:
    return lambda script: script.observed.append((when, where, script.read_everything()))


def read_readable(script: Script) -> None:
    """Reads the variables that initialization mode allows to be read."""
    script.write([read(script.probe.fmu.readable_in_initialization)])


def glance_all(script: Script) -> None:
    """Reads all variables without comparing them."""
    script.read(script.probe.fmu.variables)


def read_vectors(functions: Iterable[str], when: str = "") -> Action:
    """Reads vectors of model exchange."""
    return lambda script: script.observed.append((when, "", script.read_vectors(functions)))


def run(steps: int, when: str = "") -> Action:
    """Makes steps, and reads the outputs after each."""
    return lambda script: [
        script.write([step(), read(script.probe.outputs, when, f", step {i + 1}")]) for i in range(steps)
    ]


def run_all(steps: int, when: str = "") -> Action:
    """Makes steps, and reads all variables after each."""
    return lambda script: [script.write([step(), read_all(when, f", step {i + 1}")]) for i in range(steps)]


@_action
def read_slopes(script: Script, outputs: Sequence[Variable], when: str = "", order: int = 1) -> None:
    """Reads derivatives of one order of outputs, if there are any, in one call; values are of order 0."""
    if not order:
        script.write([read(outputs, when)])
    elif outputs:
        reply = script.call("output_derivatives", values.references_of(outputs), order)
        script.observed.append((when, "", Reading({"Real": list(outputs)}, {"Real": reply})))


@_action
def read_as(script: Script, pairs: Sequence[Pair], when: str = "") -> None:
    """Reads variables that should have the values given."""
    script.expected.append({v.name: x for v, x in pairs})
    script.write([read([v for v, _ in pairs], when)])


@_action
def expect(script: Script, *actions: Action) -> None:
    """Makes the readings of some actions the expected values of later readings."""
    first = len(script.observed)
    script.write(actions)
    script.expected += script.readings[first:]
    del script.observed[first:]


def set_debug_logging(is_on: bool, *categories: str) -> Action:
    """Turns logging of some categories, or of all, on or off."""
    names = [name.encode().hex() for name in categories]
    return call("fmi2SetDebugLogging", int(is_on), len(names), names)


def ignore(*actions: Action) -> Action:
    """Makes calls whose failure is ignored."""
    return lambda script: script.ignored.extend(script.write(actions))


def set_values(pairs: Iterable[Pair]) -> Action:
    """Sets each variable in a separate call."""
    return lambda script: [script.set(v, x) for v, x in pairs]


@_action
def set_point(script: Script, pairs: Iterable[Pair]) -> None:
    """Sets each variable in a separate call. In continuous-time mode one call sets the states, if all are
    given.
    """
    states = list(script.probe.fmu.state_derivatives.values())
    given = {v.index: (v, x) for v, x in pairs}
    of_states = list[Any]()
    if script.state == "continuous-time mode" and given.keys() >= {*states}:
        of_states = [given.pop(index)[1] for index in states]
    script.write([set_values(given.values())])
    if of_states:
        script.call("fmi2SetContinuousStates", of_states, len(of_states))


def set_others(variables: Sequence[Variable]) -> Action:
    """Sets some variables to other values, which the FMU may refuse."""
    return ignore(set_values(values.other_values(variables[:MOST_VARIABLES])))


def set_at_once(pairs: Sequence[Pair]) -> list[Action]:
    """Returns actions that set variables, all of one type in one call."""
    kinds: dict[str, list[Pair]] = {}
    for v, x in pairs:
        kinds.setdefault(v.base_kind, []).append((v, x.encode().hex() if isinstance(x, str) else x))
    return [
        call(f"fmi2Set{kind}", values.references_of(v for v, _ in some), len(some), [x for _, x in some])
        for kind, some in kinds.items()
    ]


@_action
def set_derivatives(script: Script, value: float = 1.0) -> None:
    """Sets first derivatives, of all continuous Real inputs, if the FMU interpolates."""
    references = values.references_of(values.continuous_reals(script.probe, "input"))
    if references and script.probe.fmu.claims(values.INTERPOLATES):
        count = len(references)
        script.call("fmi2SetRealInputDerivatives", references, count, [1] * count, [value] * count)


def error(action: Action, finding: str = "", *statuses: int) -> Action:
    """Makes a call that returns error. If it does not, nothing is judged, or `finding` is reported.

    finding: a template with the reply; statuses: expected ones in place of error
    """
    expected = statuses or (ERROR,)
    return lambda script: script.errors.extend((reply, finding, expected) for reply in script.write([action]))


def refused_reference(probe: Probe) -> int:
    """Returns an unknown value reference, after the FMU was asked once for its value, whatever it answered.

    Raises NotJudgedError if that ended the process: `wrong-references-are-refused` reports it.
    """
    reference = values.unknown_reference(probe.fmu)
    asked = probe.script(begin, forbidden, call("get", "Real", [reference]))
    probe.once("read of a value reference that no variable has", lambda: asked.play(keep_going=True))
    return reference


def fail(script: Script) -> None:
    """Makes a call that returns error."""
    script.write([error(call("get", "Real", [refused_reference(script.probe)]))])


def played(probe: Probe, actions: Iterable[Action], **options: Any) -> Script:
    """Returns a script of actions, played once for all rules; a failed call does not stop it."""
    script = probe.script(*actions, **options)
    probe.play_once([script])
    return script


def over_the_experiment(probe: Probe) -> Script:
    """Returns a run with the stop time of the default experiment, if it has one, all variables read a few
    times and numbers among the outputs after each step.
    """
    stop = probe.stop_time if math.isfinite(probe.stop_time) else None
    groups = itertools.groupby(comparable_outputs(probe), lambda v: v.base_kind)
    observed = [(kind, values.references_of(variables)) for kind, variables in groups]
    ends = [steps_of_experiment(probe) * i // 8 for i in range(9)]
    steps = (
        (go_on(end - before, observed), read_all("in the default experiment", f", at {probe.point(end):g} s"))
        for before, end in itertools.pairwise(ends)
    )
    begin = call("set_up_experiment", probe.start_time, stop), enter_initialization_mode
    actions = *begin, exit_initialization_mode, *itertools.chain(*steps)
    return played(probe, actions, logging=True, watched=True)


def steps_of_experiment(probe: Probe) -> int:
    """Returns the number of usual steps up to the stop time of the default experiment, or of those that take
    a fifth of a second of CPU time, a twentieth for model exchange; a hundred that take less than a second.

    It is measured once for all rules. Raises NotApplicableError where steps are few.
    """

    def measured() -> int:
        span = min(probe.stop_time - probe.start_time, _MOST_STEPS * probe.step_size)
        steps = int(span / probe.step_size + 1e-6)
        first = min(steps, _MEASURED_STEPS)
        if first < _FEWEST_STEPS:
            raise NotApplicableError("the default experiment has too few steps")
        script = probe.script(call("cpu_time"), begin, go_on(first), call("cpu_time"))
        probe.play_each([script])
        # for model exchange, the run of events reaches the stop time
        part = 4 if probe.fmu.is_model_exchange else 1
        budget = min(_LONGEST_RUN_S / part, probe.process.limit / 10)
        count = int(budget * first / script.cpu_time)
        if _ALWAYS_STEPS * script.cpu_time < _ALWAYS_S * first:
            # so what is found in a short experiment depends less on the processor
            count = max(count, _ALWAYS_STEPS)
        return min(steps, _MOST_STEPS // part, max(first, count))

    return probe.once("run of many steps", measured)


def comparable_outputs(probe: Probe) -> list[Variable]:
    """Returns the outputs that have a least and a largest value, ordered by type."""
    return [v for kind in ("Real", "Integer", "Boolean") for v in probe.outputs if v.base_kind == kind]


def others_accepted(probe: Probe, variables: Sequence[Variable], *before: Action) -> list[Pair]:
    """Returns variables with other values that the FMU accepts at once after some actions."""
    return accepted_together(probe, values.other_values(variables[:MOST_VARIABLES]), *before)


def others_in_turn(probe: Probe, variables: Sequence[Variable], *before: Action) -> Iterator[list[Pair]]:
    """Yields sets of variables and values that the FMU accepts at once after some actions: first values near
    the start values, then sets of far values.
    """
    ways = ([(v, x) for x in (v.other_value, *values.far_values(v))] for v in variables)
    for some in itertools.zip_longest(*ways):
        pairs = [pair for pair in some if pair and pair[1] is not None]
        yield accepted_together(probe, pairs, *before)


def accepted_together(probe: Probe, pairs: Sequence[Pair], *before: Action) -> list[Pair]:
    """Returns variables and values with which the FMU takes a step at once after some actions: all, or each
    that it takes beside those before it; found once for all rules that begin alike.
    """

    def chosen(some: Sequence[Pair], beside: Sequence[Pair] = ()) -> list[Pair]:
        if not some or _takes(probe, [*beside, *some], before):
            return list(some)
        half = len(some) // 2
        left = chosen(some[:half], beside) if half else []
        return [*left, *(chosen(some[half:], [*beside, *left]) if half else [])]

    key = [(v.name, x) for v, x in pairs], probe.script(*before).calls
    return probe.once("choice of values", lambda: chosen(pairs), *key)


def _takes(probe: Probe, pairs: Sequence[Pair], before: Sequence[Action]) -> bool:
    """Whether the FMU takes a step after values were set in a new script."""

    def finish(script: Script) -> None:
        if script.state == "instantiated":
            initialise(script)
        if script.state == "initialization mode":
            exit_initialization_mode(script)
        script.write([step()])

    script = probe.script(*before, set_values(pairs), finish, logging=True)
    probe.play_each([script])
    return script.succeeded
