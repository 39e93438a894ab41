"""The table of calls that are allowed in each state, and what FMI says of statuses."""

from collections.abc import Iterator
from functools import partial

from fmus.compliance.fmu_file import CO_SIMULATION
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.rules.session import session
from fmus.compliance.script import KINDS, Reply, Script
from fmus.compliance.values import INTERPOLATES, continuous_reals, references_of, start_value
from fmus.compliance.variable import Variable
from fmus.fmi.binding import ERROR, FATAL

_STATES = "4.2.4 State Machine of Calling Sequence from Master to Slave"


@behaviour_rule(_STATES, needs="variables-can-be-read")
def allowed_calls_succeed(probe: Probe) -> Iterator[str]:
    """The functions that the FMU supports succeed in the states, instantiated to terminated, that allow
    them.
    """
    named = set()
    played = session(probe)
    for reply in played.script.replies:
        refused = reply.status in (ERROR, FATAL)  # of other statuses `statuses_are_legal` tells
        if not refused or (reply.function, reply.state) in named:
            continue
        named.add((reply.function, reply.state))
        yield f"in the state {reply.state!r}: {reply.problem}"
        return  # what follows in this instance has the same cause


# calls that FMI forbids to the importer: it does not say what the FMU does then


def _setting(
    probe: Probe, causality: str, variability: str | None, kind: str = ""
) -> tuple[Variable, float | str] | None:
    """Returns a variable with a start value, and that value.

    variability: None for any but constant; kind: of the variable, any but String without
    """
    for v in probe.fmu.variables:
        right_kind = v.base_kind == kind if kind else v.base_kind != "String"
        right = v.variability == variability if variability else v.variability != "constant"
        if v.causality == causality and right and right_kind and (value := start_value(v)) is not None:
            return v, value
    return None


def _forbidden(probe: Probe) -> Iterator[tuple[Script, Reply]]:
    """Scripts, each with a call that is not allowed where it stands."""
    t, h, new = probe.start_time, probe.step_size, partial(_forbidden_script, probe)
    for script in (new(), new().initialise()):
        yield script, script.call("do_step", t, h)
    for script in (new(), new().begin()):
        yield script, script.plain("fmi2ExitInitializationMode")
    for script in (new().initialise(), new().begin()):
        yield script, script.plain("fmi2EnterInitializationMode")
    for script in (new(), new().initialise()):
        yield script, script.plain("fmi2Terminate")
    for script in (new().initialise(), new().begin().step()):
        yield script, script.call("set_up_experiment", t)
    for method, *arguments in (
        ("do_step", probe.point(1), h),
        ("set_up_experiment", t),
        ("enter_initialization_mode",),
        ("call_plain", "fmi2Terminate"),
    ):
        terminated = new().begin().step()
        terminated.terminate()
        yield terminated, terminated.call(method, *arguments)
    script = new().begin()
    yield script, script.plain("fmi2CancelStep")
    for kind in KINDS:
        if fixed := _setting(probe, "parameter", "fixed", kind):
            script = new().begin().step()
            yield script, script.set(*fixed)
    yield from _forbidden_values(probe)
    yield from _forbidden_derivatives(probe)
    for step in (0.0, -h):
        script = new().begin().step()
        yield script, script.call("do_step", probe.point(1), step)


def _forbidden_script(probe: Probe) -> Script:
    return probe.script(logging=True).forbidden()


def _forbidden_values(probe: Probe) -> Iterator[tuple[Script, Reply]]:
    """Scripts, each with a value that is set where that is not allowed, or another time than the
    present.
    """
    new = partial(_forbidden_script, probe)
    for kind in KINDS:
        if setting := _setting(probe, "input", None, kind) or _setting(probe, "parameter", "tunable", kind):
            script = new().begin().step()
            script.terminate()
            yield script, script.set(*setting)
    if setting := _setting(probe, "output", None):
        script = new().begin().step()
        yield script, script.set(*setting)
    for steps in (0, 1):
        script = new().begin().step(steps)
        yield script, script.call("do_step", probe.point(steps + 5), probe.step_size)


def _forbidden_derivatives(probe: Probe) -> Iterator[tuple[Script, Reply]]:
    """Scripts, each with derivatives of order 0, or in a state that does not allow them."""
    new = partial(_forbidden_script, probe)
    inputs, outputs = (references_of(continuous_reals(probe, c))[:1] for c in ("input", "output"))
    if inputs and probe.fmu.claims(INTERPOLATES):
        script, terminated = new().begin().step(), new().begin().step()
        yield script, script.call("set_input_derivatives", inputs, [0], [1.0])
        terminated.terminate()
        yield terminated, terminated.call("set_input_derivatives", inputs, [1], [0.0])
    if outputs and probe.fmu.output_derivative_order:
        for script, order in ((new().begin().step(), 0), (new(), 1), (new().initialise(), 1)):
            yield script, script.call("output_derivatives", outputs, order)
    if inputs and outputs and probe.fmu.claims("providesDirectionalDerivative"):
        script = new()
        yield script, script.call("directional_derivatives", outputs, inputs, [1.0])


@behaviour_rule(
    "advice: calls that 4.2.4 and 4.2.2 forbid to importers",
    last=True,
    interface=CO_SIMULATION,
)
def forbidden_calls_are_refused(probe: Probe) -> Iterator[str]:
    """A call that its state forbids, a fixed parameter or an output set while stepping, a step that is not
    above 0 or does not start at the present, or a derivative of order 0 is refused.
    """
    pairs = list(_forbidden(probe))
    probe.play_each([script for script, _ in pairs])
    for script, reply in pairs:
        if reply.ok:
            yield f"in the state {reply.state!r} {_named(reply, script)} returned ok: expected error"


def _named(reply: Reply, script: Script) -> str:
    arguments = script.calls[script.replies.index(reply)][1:]
    if reply.function == "fmi2DoStep" and reply.state == "step complete":
        return f"fmi2DoStep from {arguments[0]:g} s with the communication step size {arguments[1]:g} s"
    values = ("fmi2SetReal", "fmi2SetInteger", "fmi2SetBoolean", "fmi2SetString")
    if reply.function in values and reply.state == "step complete":
        return f"{reply.function} of the value reference {arguments[1][0]}, a fixed parameter or an output"
    orders = {"fmi2SetRealInputDerivatives": 1, "fmi2GetRealOutputDerivatives": 1}  # among the arguments
    if reply.function in orders:
        order = arguments[orders[reply.function]]
        return f"{reply.function} of order {order[0] if isinstance(order, list) else order}"
    return reply.function


@behaviour_rule("advice: an empty call has nothing to refuse", needs="allowed-calls-succeed")
def empty_calls_succeed(probe: Probe) -> Iterator[str]:
    """Getting or setting no variables, with NULL for both arrays, succeeds."""
    script = probe.script(logging=True).begin()
    kinds = ("Real", "Integer", "Boolean", "String")
    replies = [script.call("transfer_nothing", f"fmi2Set{kind}") for kind in kinds]
    script.step()
    replies += [script.call("transfer_nothing", f"fmi2Get{kind}") for kind in kinds]
    if probe.fmu.claims(INTERPOLATES):
        replies.append(script.call("set_input_derivatives", [], [], []))
    if probe.fmu.output_derivative_order:
        replies.append(script.call("output_derivatives", [], 1))
    script.play(keep_going=True)
    failed = next((reply for reply in replies if not reply.ok), None)
    if failed:
        yield f"{failed.function} of no variables: {failed.status_name}: expected ok"
