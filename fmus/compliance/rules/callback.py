"""Callbacks, and arguments that are valid during a call only."""

from collections.abc import Iterator, Sequence

from fmus.compliance.comparison import differing
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.script import CallError, Reading, Script
from fmus.compliance.values import unless_claimed

_CREATION = "2.1.5 Creation, Destruction and Logging of FMU Instances"
_OWN_MEMORY = "canNotUseMemoryManagementFunctions"
_NAME = "system.subsystem[2].'instance with a name of its own'.part"


def _overwritten(probe: Probe) -> tuple[Script, Sequence[Reading], list[str]]:
    """Returns a run after the arguments of fmi2Instantiate were overwritten, its readings, and the callbacks
    that the FMU takes from the structure after it.
    """

    def played() -> tuple[Script, Sequence[Reading], list[str]]:
        script = probe.script(name=_NAME, overwritten=True, logging=True)
        script.call("set_debug_logging", True, [])
        script.begin()
        got = script.run(2)
        script.reset()
        script.begin().step()
        number = probe.hold(script)
        traps = probe.ask("traps", number)
        probe.let_go(number)
        return script, got, sorted(set(traps))

    return probe.once("run with overwritten arguments", played)


@behaviour_rule(
    _CREATION,
    needs="reset-in-every-state allowed-calls-succeed statuses-are-legal messages-have-the-instance-name",
)
def arguments_of_instantiation_are_copied(probe: Probe) -> Iterator[str]:
    """Name, GUID and resource location are not used after fmi2Instantiate returned; a long name is kept
    whole.
    """
    usual = probe.script().begin()
    expected = usual.run(2)
    usual.play()
    script, got, _ = _overwritten(probe)
    if script.failure:
        yield f"after the arguments of fmi2Instantiate were overwritten: {script.failure.problem}"
        return
    yield from differing(expected, got, "after the arguments of fmi2Instantiate were overwritten")
    names = {m.instance for reply in script.replies for m in reply.messages} - {_NAME}
    if any(name is not None and name.strip("#") == "" for name in names):
        yield "messages carry the overwritten instance name: expected a copy of it"
    elif cut := sorted(name for name in names if name and _NAME.startswith(name)):
        yield f"messages carry the instance name {cut[0]!r}: expected {_NAME!r}"


@behaviour_rule(
    "advice: 2.1.5, a note on the structure of callbacks",
    needs="arguments-of-instantiation-are-copied",
)
def callbacks_are_copied(probe: Probe) -> Iterator[str]:
    """The structure of callbacks is not used after fmi2Instantiate returned."""
    for callback in _overwritten(probe)[2]:
        yield f"{callback} was taken from the structure after fmi2Instantiate: expected a copy of it"


@behaviour_rule(_CREATION)
def optional_callbacks_may_be_null(probe: Probe) -> Iterator[str]:
    """stepFinished and componentEnvironment may be NULL."""
    usual, fewest = probe.script().begin(), probe.script(callbacks="fewest", logging=True).begin()
    expected, got = usual.run(2), fewest.run(2)
    fewest.terminate()
    usual.play()
    try:
        fewest.play()
    except CallError as error:
        yield f"without stepFinished and environment: {error}"
        return
    yield from differing(expected, got, "without stepFinished and environment")


@behaviour_rule(
    "4.3.1 Co-Simulation FMU (CoSimulation): canNotUseMemoryManagementFunctions",
    condition=unless_claimed(_OWN_MEMORY),
    needs="state-can-be-saved-often",
)
def memory_functions_may_be_null(probe: Probe) -> Iterator[str]:
    """With canNotUseMemoryManagementFunctions, allocateMemory and freeMemory may be NULL, and are not
    called.
    """
    held = probe.ask("held_blocks")
    script = probe.script().begin().step()
    if probe.fmu.claims("canGetAndSetFMUstate"):
        script.call("get_fmu_state", 0)
    number = probe.hold(script)
    if probe.ask("held_blocks") != held:
        yield "allocateMemory was called: expected no call, as canNotUseMemoryManagementFunctions is claimed"
    probe.let_go(number)
    script = probe.script(callbacks="no memory", logging=True).begin().step()
    if probe.fmu.claims("canGetAndSetFMUstate"):
        script.call("get_fmu_state", 0)
        script.call("free_fmu_state", 0)
    script.terminate()
    try:
        script.play()
    except CallError as error:
        yield f"without memory functions: {error}"


@behaviour_rule("advice: 2.1.5, allocateMemory returns NULL if memory is used up")
def failed_allocation_is_handled(probe: Probe) -> Iterator[str]:
    """fmi2Instantiate returns NULL where allocateMemory does, or an instance that needs no such memory."""
    script = probe.script(callbacks="refused memory").begin().step()
    try:
        script.play(keep_going=True)
    except CallError:
        return  # no instance
    if script.failure:
        yield f"where allocateMemory returns NULL: {script.failure.problem}"
