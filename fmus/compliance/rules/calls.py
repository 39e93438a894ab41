"""Rules of the table of calls: allowed and forbidden calls of each state, and wrong arguments."""

from collections.abc import Iterator
from contextlib import suppress

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row, differential
from fmus.compliance.fmu_file import CO_SIMULATION, MODEL_EXCHANGE
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.rules.lifecycle import MANY_STEPS
from fmus.compliance.script import KINDS, Action, Reply, Script
from fmus.compliance.traces import table
from fmus.fmi.binding import DISCARD, ERROR, FATAL, LAST_SUCCESSFUL_TIME, OK, TERMINATED, WARNING

_MORE = 4096  # bytes than the size of a serialised state
_ORDER_0 = " of {} and order 0, which does not exist,"
_NOTHING = {"Real": 0.0, "Integer": 0, "Boolean": 0, "String": ""}
_STATUS_KINDS = {  # fmi2StatusKind -> its name, and the type of its function
    0: ("fmi2DoStepStatus", ""),
    1: ("fmi2PendingStatus", "String"),
    LAST_SUCCESSFUL_TIME: ("fmi2LastSuccessfulTime", "Real"),
    TERMINATED: ("fmi2Terminated", "Boolean"),
}


def _finding(expected: str, words: str = "{reply.words}") -> str:
    """Returns the message for a call with an unexpected status; words: for its arguments."""
    return (
        f"in the state {{reply.state!r}} {{reply.function}}{words} {{reply.status_name}}: expected {expected}"
    )


# calls that a state allows


@behaviour_rule("3.2.3, 4.2.4")
def allowed_calls_succeed(probe: Probe) -> Iterator[str]:
    """The functions that the FMU supports succeed in the states, instantiated to terminated, that allow
    them.
    """
    # `statuses-are-legal` reports other statuses
    for reply in table.tour(probe).failed:
        probe.shared.failing[reply.function, reply.state] = "allowed-calls-succeed"
        yield f"in the state {reply.state!r}: {_cause(probe, reply)}"


def _cause(probe: Probe, reply: Reply) -> str:
    """Returns the problem of a call, or of the call before that is the cause."""
    if reply.function == "fmi2SerializeFMUstate":
        larger = probe.script(do.save(), do.call("state_bytes", 0, _MORE)).play(keep_going=True)
        if larger.succeeded:
            size = f"fmi2SerializedFMUstateSize is {len(larger.content) // 2 - _MORE}, which is too small"
            return f"{size}: {reply.function} fails with it, and succeeds with {_MORE} more; {reply.logged}"
    return reply.problem


@differential("3.2.3, 4.2.4")
def reset_in_every_state(probe: Probe) -> Iterator[Row]:
    """fmi2Reset is allowed when instantiated, in initialization mode, while stepping, after fmi2Terminate and
    after an error; start values can be set after it, as at first.
    """
    pairs = values.start_values(probe.fmu.settable_before[: do.MOST_VARIABLES])
    taken = list[do.Pair]()
    # the FMU may refuse start values, as another rule reports
    with suppress(NotJudgedError):
        taken = do.accepted_together(probe, pairs)
    again = do.in_state("instantiated after fmi2Reset"), do.set_values(taken)
    return table.in_states(probe, "IMCEKTD", do.reset, *again, do.begin, do.step())


@behaviour_rule("3.2.3, 4.2.4")
def frees_in_every_state(probe: Probe) -> None:
    """fmi2FreeInstance is allowed when instantiated, in initialization mode, while stepping and after
    fmi2Terminate.
    """
    for actions in ((), (do.initialise,), (do.begin, do.step())):
        probe.script(*actions).play()
    do.played(probe, (do.begin, do.terminate))


@differential("3.2.3", interface=MODEL_EXCHANGE)
def event_mode_is_entered_from_itself(probe: Probe) -> Iterator[Row]:
    """fmi2EnterEventMode succeeds in event mode too, as the table of 3.2.3 has it."""
    return table.in_states(probe, "E", do.enter_event_mode, do.call("new_discrete_states"))


@differential("3.2.3", interface=MODEL_EXCHANGE)
def vectors_are_given_in_every_state(probe: Probe) -> Iterator[Row]:
    """Vectors can be read in initialization mode and when terminated, nominal values also before."""
    for state in "IMT":
        yield from table.in_states(probe, state, *table.vectors(probe, state))


@differential("3.2.3", interface=MODEL_EXCHANGE)
def states_are_set_by_reference(probe: Probe) -> Iterator[Row]:
    """In continuous-time mode fmi2SetReal sets continuous states too, as the table of 3.2.3 has it."""
    for pair in values.start_values(probe.fmu.state_variables):
        yield from table.in_states(probe, "K", do.set_values([pair]))


@differential("4.2.1, 4.2.4", condition=values.unless_claimed(values.INTERPOLATES))
def input_derivatives_in_each_state(probe: Probe) -> Iterator[Row]:
    """Derivatives of inputs can be set when instantiated: 4.2.4 allows it, although 4.2.1 restricts them as
    fmi2SetReal, which cannot set inputs there. After fmi2Terminate they are refused if inputs are.
    """
    yield from table.in_states(probe, "I", do.set_derivatives(0.0), do.begin, do.step())
    sets = do.set_values(values.start_values(values.continuous_reals(probe, "input")))
    asked = do.played(probe, (do.begin, do.terminate, do.forbidden, sets))
    if ERROR in {reply.status for reply in asked.replies}:
        refused = do.error(do.set_derivatives(0.0), _finding("error, as fmi2SetReal returns"))
        yield from table.in_states(probe, "T", do.forbidden, refused)


# wrong arguments


@differential("2.1.2")
def wrong_references_are_refused(probe: Probe) -> Iterator[Row]:
    """Reading or setting an unknown value reference returns error, also for derivatives. So do derivatives of
    order 0, and input derivatives of an output. The instance can then be freed.
    """
    reference = do.refused_reference(probe)
    finding = _finding("error", f" of the value reference {reference}, which no variable has,")
    calls = [("CE", do.call("get", kind, [reference]), finding) for kind in KINDS]
    calls += [("M", do.call(f"fmi2Set{kind}", [reference], 1, [_NOTHING[kind]]), finding) for kind in KINDS]
    outputs = values.continuous_reals(probe, "output")[:1]
    if probe.fmu.claims(values.INTERPOLATES):
        wrong = [(reference, 1, finding)]
        wrong += [(v.reference, 1, _finding("error", f" of {v.name}, which is no input,")) for v in outputs]
        inputs = values.continuous_reals(probe, "input")[:1]
        wrong += [(v.reference, 0, _finding("error", _ORDER_0.format(v.name))) for v in inputs]
        for number, order, told in wrong:
            calls.append(("C", do.call("fmi2SetRealInputDerivatives", [number], 1, [order], [0.0]), told))
    if probe.fmu.output_derivative_order > 0:
        calls.append(("C", do.call("output_derivatives", [reference], 1), finding))
        for v in outputs:
            told = _finding("error", _ORDER_0.format(v.name))
            calls.append(("C", do.call("output_derivatives", [v.reference], 0), told))
    for states, action, told in calls:
        yield from table.in_states(probe, states, do.error(action, told))


@differential("2.1.2")
def constants_cannot_be_set(probe: Probe) -> Iterator[Row]:
    """Setting a constant is an error, when instantiated and in initialization mode."""
    constants = [v for v in probe.fmu.variables if v.variability == "constant"]
    for v, x in values.start_values(constants[: do.MOST_VARIABLES]):
        refused = do.error(do.set_values([(v, x)]), _finding("error"))
        yield from table.in_states(probe, "IM", refused)


# what fmi2GetXXXStatus returns


@differential("4.2.3", interface=CO_SIMULATION)
def unknown_statuses_are_discarded(probe: Probe) -> Iterator[Row]:
    """fmi2GetXXXStatus returns ok, or discard for a status that it cannot retrieve; no other status."""
    kinds = [(kind, number) for number, (_, kind) in _STATUS_KINDS.items()]
    for kind, number in (*kinds, ("Integer", 0)):
        call, finding = do.call("status_of", kind, number), _finding("ok or discard")
        yield from table.in_states(probe, "CT", do.error(call, finding, OK, WARNING, DISCARD))


@differential("4.2.3", interface=CO_SIMULATION)
def statuses_have_their_types(probe: Probe) -> Iterator[Row]:
    """Only the function of its type gives a status; another function returns discard or error."""
    for number, (name, right) in _STATUS_KINDS.items():
        for kind in sorted({"", *KINDS} - {right}):
            finding = _finding("error or discard", f" of {name}, which has another type,")
            refused = do.error(do.call("status_of", kind, number), finding, DISCARD, ERROR, FATAL)
            yield from table.in_states(probe, "C", do.forbidden, refused)


@behaviour_rule("4.2.3", interface=CO_SIMULATION)
def last_successful_time_is_right(probe: Probe) -> Iterator[str]:
    """fmi2LastSuccessfulTime, where it is given, is the end of the last step; fmi2Terminated is then
    false. After a step of the default experiment that is discarded, steps up to it succeed.
    """
    if not probe.states_step_size:
        raise NotJudgedError("no step size is stated, and an internal step may be longer than others")
    script = probe.script(do.begin, do.step(3))
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
    with suppress(NotApplicableError, NotJudgedError):
        steps = MANY_STEPS if probe.shared.discards else do.steps_of_experiment(probe)
        if not probe.shared.discards and not do.over_the_experiment(probe).failure:
            return
        *_, last = _played(probe, do.go_on(steps), do.call("status_of", "Real", LAST_SUCCESSFUL_TIME)).replies
        count = int((last.value - probe.start_time) / h + 1e-6) if last.ok else 0
        if _played(probe, do.go_on(count)).failure:
            what = f"fmi2LastSuccessfulTime is {last.value:.9g} s after a step that is discarded"
            yield f"{what}: expected less, as a step up to there is discarded"


def _played(probe: Probe, *actions: Action) -> Script:
    """Returns a run that was played, also if a step is discarded."""
    script = probe.script(do.begin, *actions)
    with suppress(NotJudgedError):
        probe.play_each([script])
    return script
