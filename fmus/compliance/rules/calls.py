"""Rules of the table of calls: what each state allows, what it forbids, and calls with wrong arguments."""

from collections.abc import Iterator
from contextlib import suppress

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.actions import MOST_VARIABLES
from fmus.compliance.differential import Row, differential
from fmus.compliance.fmu_file import CO_SIMULATION, MODEL_EXCHANGE
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.rules import call_table as table
from fmus.compliance.script import KINDS, Reply
from fmus.compliance.values import INTERPOLATES, unless_claimed
from fmus.fmi.binding import LAST_SUCCESSFUL_TIME, TERMINATED

_MORE = 4096  # bytes than the size of a serialised state
_NOTHING = {"Real": 0.0, "Integer": 0, "Boolean": 0, "String": ""}
_STATUS_KINDS = {  # fmi2StatusKind -> its name, and the type of its function
    0: ("fmi2DoStepStatus", ""),
    1: ("fmi2PendingStatus", "String"),
    LAST_SUCCESSFUL_TIME: ("fmi2LastSuccessfulTime", "Real"),
    TERMINATED: ("fmi2Terminated", "Boolean"),
}

# what a state allows


@behaviour_rule("3.2.3, 4.2.4")
def allowed_calls_succeed(probe: Probe) -> Iterator[str]:
    """The functions that the FMU supports succeed in the states, instantiated to terminated, that allow
    them.
    """
    for reply in table.tour(probe).failed:  # of other statuses `statuses-are-legal` tells
        probe.note_failure(reply, "allowed-calls-succeed")
        yield f"in the state {reply.state!r}: {_cause(probe, reply)}"


def _cause(probe: Probe, reply: Reply) -> str:
    """Returns the problem of a call, or of the call before that is the cause."""
    if reply.function == "fmi2SerializeFMUstate":
        larger = probe.script(do.save(), do.call("serialize_fmu_state", 0, _MORE)).play(keep_going=True)
        if larger.succeeded:
            size = f"fmi2SerializedFMUstateSize is {len(larger.content) // 2 - _MORE}, which is too small"
            return f"{size}: {reply.function} fails with it, and succeeds with {_MORE} more; {reply.logged}"
    return reply.problem


@table.call_rule("3.2.3, 4.2.4", table.SUCCESS)
def reset_in_every_state(_: Probe) -> Iterator[table.Ask]:
    """fmi2Reset is allowed when instantiated, in initialization mode, while stepping, after fmi2Terminate and
    after an error.
    """
    return (table.Ask(state, (do.reset, do.begin, do.step())) for state in "IMCEKTD")


@behaviour_rule("3.2.3, 4.2.4")
def frees_in_every_state(probe: Probe) -> Iterator[str]:
    """fmi2FreeInstance is allowed when instantiated, in initialization mode, while stepping and after
    fmi2Terminate.
    """
    for actions in ((), (do.initialise,), (do.begin, do.step())):
        probe.script(*actions).play()
    do.played(probe, (do.begin, do.terminate))
    yield from ()


@table.call_rule("3.2.3", table.SUCCESS, interface=MODEL_EXCHANGE)
def event_mode_is_entered_from_itself(_: Probe) -> Iterator[table.Ask]:
    """fmi2EnterEventMode succeeds in event mode too, as the table of 3.2.3 has it."""
    yield table.Ask("E", (do.plain("fmi2EnterEventMode"), do.call("new_discrete_states")))


@table.call_rule("3.2.3", table.SUCCESS, interface=MODEL_EXCHANGE)
def vectors_are_given_in_every_state(probe: Probe) -> Iterator[table.Ask]:
    """Vectors can be read in initialization mode and when terminated, nominal values also before."""
    return (table.Ask(state, [*table.vectors(probe, state)]) for state in "IMT")


@table.call_rule("3.2.3", table.SUCCESS, interface=MODEL_EXCHANGE)
def states_are_set_by_reference(probe: Probe) -> Iterator[table.Ask]:
    """In continuous-time mode fmi2SetReal sets continuous states too, as the table of 3.2.3 has it."""
    states = [probe.fmu.variables[index - 1] for index in probe.fmu.state_derivatives.values()]
    return (table.Ask("K", [do.set_values([pair])]) for pair in values.start_values(states))


@table.call_rule("4.2.4", table.SUCCESS, condition=unless_claimed(INTERPOLATES))
def input_derivatives_when_instantiated(_: Probe) -> Iterator[table.Ask]:
    """Derivatives of inputs can be set when instantiated: 4.2.4 allows it, although 4.2.1 gives them the
    restrictions of fmi2SetReal, which cannot set inputs there.
    """
    yield table.Ask("I", (do.set_derivatives(0.0), do.begin, do.step()))


@differential("advice: an empty call has nothing to refuse")
def empty_calls_succeed(probe: Probe) -> Iterator[Row]:
    """Getting or setting no variables, with NULL for both arrays, succeeds and changes nothing."""
    set_nothing, get_nothing = (
        [do.call("call", f"fmi2{x}{kind}", None, 0, None) for kind in KINDS] for x in ("Set", "Get")
    )
    if probe.fmu.claims(INTERPOLATES):
        set_nothing.append(do.call("set_input_derivatives", [], [], []))
    if probe.fmu.output_derivative_order:
        get_nothing.append(do.call("output_derivatives", [], 1))
    varied = do.begin, *set_nothing, do.run(1), *get_nothing, do.run(1)
    yield Row("after calls for no variables", varied, failing="of no variables")


# what a state forbids, and wrong arguments: FMI does not say what the FMU does then, but for some


@table.call_rule("advice: calls that 4.2.4, 4.2.2 and 3.2.3 forbid to importers", table.REFUSAL, last=True)
def forbidden_calls_are_refused(probe: Probe) -> Iterator[table.Ask]:
    """A call that its state forbids, a step that is not above 0 or does not start at the present, or a
    derivative of order 0 is refused.
    """
    states = set(table.STATES[probe.fmu.interface])
    for row in table.TABLE:
        for state in sorted(states & set("IMCEKT") - set(row.allowed)) if states & set(row.allowed) else ():
            yield from (table.Ask(state, [action]) for action in row.calls(probe, state))
    for action in (do.set_derivatives(0.0, order=0), *table.output_derivatives(probe, "C", orders=[0])):
        yield table.Ask("C", [action], " of order 0")
    for state, i, size in (("B", 5, 1), ("C", 6, 1), ("C", 1, 0), ("C", 1, -1)):
        t, h = probe.point(i), size * probe.step_size
        words = f" from {t:g} s with the communication step size {h:g} s"
        yield table.Ask(state, [do.call("do_step", t, h)], words)


@table.call_rule("2.1.2", table.AN_ERROR)
def wrong_references_are_refused(probe: Probe) -> Iterator[table.Ask]:
    """A value reference that no variable has is an error to read and to set, also for derivatives; the
    instance is freed then.
    """
    reference = values.refused_reference(probe)
    words = f" of the value reference {reference}, which is none,"
    calls = [("CE", do.call("get", kind, [reference])) for kind in KINDS]
    calls += [("M", do.call("set", kind, [reference], [_NOTHING[kind]])) for kind in KINDS]
    if probe.fmu.claims(INTERPOLATES):
        calls.append(("C", do.call("set_input_derivatives", [reference], [1], [0.0])))
    if probe.fmu.output_derivative_order > 0:
        calls.append(("C", do.call("output_derivatives", [reference], 1)))
    return (table.Ask(state, [action], words) for states, action in calls for state in states)


@table.call_rule("2.1.2", table.AN_ERROR)
def constants_cannot_be_set(probe: Probe) -> Iterator[table.Ask]:
    """Setting a constant is an error."""
    constants = [v for v in probe.fmu.variables if v.variability == "constant"]
    for v, x in values.start_values(constants[:MOST_VARIABLES]):
        yield table.Ask("M", [do.set_values([(v, x)])], f" of the constant {v.name}")


# steps that are discarded or canceled


@behaviour_rule("4.2.2", interface=CO_SIMULATION)
def discarded_steps_have_a_last_time(probe: Probe) -> Iterator[str]:
    """After a discarded step, fmi2LastSuccessfulTime, if given, lies in that step, before its end, and
    fmi2Terminated is a Boolean.
    """
    number = table.discarded_step(probe)
    script = probe.script(logging=True).begin().step(number + 1)
    time = script.call("status_of", "Real", LAST_SUCCESSFUL_TIME)
    terminated = script.call("status_of", "Boolean", TERMINATED)
    present = script.read(v for v in probe.fmu.variables if v.causality == "independent")
    with suppress(NotJudgedError):  # that a step is discarded
        script.play(keep_going=True)
    start, end = probe.point(number), probe.point(number + 1)
    rounding = 1e-9 * max(abs(start), abs(end), probe.step_size)
    step = f"a step from {start:g} to {end:g} s"
    if time.ok and not start - rounding <= time.value < end - rounding:
        yield f"{step} is discarded, and fmi2LastSuccessfulTime is {time.value:g} s"
    for name, t in present.values.items() if time.ok and present.ok else ():
        if abs(t - time.value) > rounding:
            last = f"{time.value:g} s, fmi2LastSuccessfulTime"
            yield f"{step} is discarded, and {name} is {t:g} s: expected {last}"
    if terminated.ok and terminated.value not in (0, 1):
        yield f"after a discarded step fmi2Terminated is {terminated.value}: expected 0 or 1, a Boolean"
    if script.failure and not script.failure.messages:
        yield f"{step} was discarded and nothing was logged: expected the reason"


@table.call_rule("4.2.4", table.SUCCESS, interface=CO_SIMULATION)
def discarded_steps_can_be_left(probe: Probe) -> Iterator[table.Ask]:
    """After a step was discarded variables can be read, and fmi2Terminate, fmi2Reset and, if it is
    supported, fmi2SetFMUstate succeed.
    """
    yield table.Ask("F", (do.glance(probe.fmu.variables), do.terminate))
    yield table.Ask("F", (do.reset, do.begin))
    if probe.fmu.claims("canGetAndSetFMUstate"):
        yield table.Ask("F", [do.restore()])


# what fmi2GetXXXStatus returns


@table.call_rule("4.2.3", table.KNOWN_OR_NOT, interface=CO_SIMULATION)
def unknown_statuses_are_discarded(probe: Probe) -> Iterator[table.Ask]:
    """fmi2GetXXXStatus returns ok, or discard for what it cannot retrieve; no other status."""
    kinds = [(kind, number) for number, (_, kind) in _STATUS_KINDS.items()]
    for kind, number in (*kinds, ("Integer", 0)):
        states = "CT" if probe.shared.discarded_step is None else "CFT"
        yield from (table.Ask(state, [do.call("status_of", kind, number)]) for state in states)


@table.call_rule("4.2.3", table.REFUSAL, interface=CO_SIMULATION)
def statuses_have_their_types(_: Probe) -> Iterator[table.Ask]:
    """A status is given by the function of its type alone: another function returns discard."""
    for number, (name, right) in _STATUS_KINDS.items():
        for kind in sorted({"", *KINDS} - {right}):
            words = f" of {name}, which has another type,"
            yield table.Ask("C", [do.call("status_of", kind, number)], words)


@behaviour_rule("4.2.3", interface=CO_SIMULATION)
def last_successful_time_is_right(probe: Probe) -> Iterator[str]:
    """fmi2LastSuccessfulTime, where it is given, is the end of the last step; fmi2Terminated is then
    false.
    """
    if not probe.states_step_size:
        raise NotJudgedError("no step size is stated, and an internal step may be longer than others")
    script = probe.script().begin().step(3)
    time = script.call("status_of", "Real", LAST_SUCCESSFUL_TIME)
    terminated = script.call("status_of", "Boolean", TERMINATED)
    probe.play_each([script])
    expected, h = probe.point(3), probe.step_size
    if time.ok and not abs(time.value - expected) <= 1e-3 * h + 1e-9 * abs(expected):
        yield (
            f"fmi2LastSuccessfulTime is {time.value:.9g} s after a step to {expected:.9g} s: expected its end"
        )
    if terminated.ok and terminated.value:
        yield "fmi2Terminated is true after steps that succeeded: expected false"
