"""Behaviour that every FMU owes: it is loaded, created, initialised, stepped, reset and freed, also beside
other instances.
"""

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import PurePath

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row, differential
from fmus.compliance.fmu_file import ONLY_ONCE, FmuFile
from fmus.compliance.probe import DiscardedStepError, Probe, refusal
from fmus.compliance.rule import CANNOT_LOAD, RANDOM, NotJudgedError, behaviour_rule
from fmus.compliance.script import CallError, Reply, Script
from fmus.compliance.traces import paths
from fmus.fmi.binding import CO_SIMULATION, DISCARD, ERROR, MODEL_EXCHANGE

_WRONG_GUID = "{00000000-0000-0000-0000-000000000000}"
_NEW_STATES = "fmi2NewDiscreteStates"
_STEPS, MANY_STEPS, _INSTANCES = 5, 30, 10
_ELSEWHERE = "install what it needs, or check it on a machine that has it"
# messages of the loaders of glibc, musl, macOS and Windows; undefined symbols are the library's own fault
_OF_THE_MACHINE = re.compile(
    r"(?P<name>[^\s:]+): cannot open shared object"
    r"|(?:Error loading shared library|Library not loaded:) (?P<other>[^\s:]+)"
    r"|version `\S+' not found|wrong ELF class|incompatible architecture|\[WinError (?:126|193)\]"
    r"|Could not find module|needs a library of fmi3_calls"
)


@behaviour_rule("2.1.1")
def library_loads(probe: Probe) -> None:
    """The library of this platform loads, and has every function of FMI 2.0 for co-simulation."""
    try:
        # the first question loads the library
        probe.ask("resource_location")
    except CallError as error:
        if is_of_the_machine(probe.fmu, str(error)):
            raise NotJudgedError(f"{CANNOT_LOAD}: {error}; {_ELSEWHERE}") from error
        raise


def is_of_the_machine(fmu: FmuFile, message: str) -> bool:
    """Whether a library cannot be loaded because of this machine: its processor, its C library, or a library
    that it does not have and that is not in the FMU.
    """
    found = _OF_THE_MACHINE.search(message)
    name = found and PurePath(found["name"] or found["other"] or "").name
    folder, _, own = fmu.host_library.rpartition("/")
    return found is not None and (name == own or f"{folder}/{name}" not in fmu.paths)


@behaviour_rule("2.1.5")
def instantiates_and_frees(probe: Probe) -> None:
    """An instance is created, freed, and created and freed again."""
    for _ in range(2):
        created, messages = probe.creates(logging=True)
        if not created:
            raise refusal(messages)


@behaviour_rule("2.1.4")
def library_version(probe: Probe) -> Iterator[str]:
    """fmi2GetVersion is 2.0, and fmi2GetTypesPlatform default, a static string, also after an instance."""
    probe.creates()  # a library that serves several versions may choose one then
    for function, expected in (("GetVersion", "2.0"), ("GetTypesPlatform", "default")):
        got, is_static = probe.ask("text", f"fmi2{function}")
        if got != expected:
            yield f"fmi2{function} is {got!r}: expected {expected!r}"
        elif function == "GetTypesPlatform" and not is_static:
            yield f"fmi2{function} returns another address each time: expected a static string"


@behaviour_rule("2.1.5")
def free_of_null_is_ignored(probe: Probe) -> None:
    """fmi2FreeInstance of NULL does nothing, also after an instance was freed."""
    probe.creates()
    probe.ask("free_of_null")


@behaviour_rule("3.2.3, 4.2.2")
def steps_and_terminates(probe: Probe) -> Iterator[str]:
    """It is initialised; equal steps of the default experiment's size succeed, then fmi2Terminate."""
    script = probe.script(do.begin, do.step(_STEPS), do.terminate, logging=True)
    _find_discarded_step(probe)
    try:
        script.play()
    except (CallError, DiscardedStepError) as error:
        failure, is_exchanged = script.failure, probe.fmu.is_model_exchange
        if not failure:
            raise
        # where its description states no step size, a slave may refuse one by an error too (4.2.2)
        is_unstated = failure.is_step and not is_exchanged and not probe.states_step_size
        if isinstance(error, DiscardedStepError) or (is_unstated and failure.status == ERROR):
            stated = "it states in DefaultExperiment" if probe.states_step_size else "is not stated by it"
            refused = f"the FMU refuses the step size {probe.step_size:g} s, which {stated}"
            probe.shared.refused_steps = str(error) if is_exchanged else refused
            raise NotJudgedError(probe.shared.refused_steps) from None
        yield f"in the state {failure.state!r}: {_cause(probe, script, failure)}"


def _find_discarded_step(probe: Probe) -> None:
    """Notes, for all rules, whether the FMU discards one of some equal steps of the usual size."""
    script = probe.script(do.begin, do.step(MANY_STEPS))
    # steps beyond the stop time may be refused
    with suppress(NotJudgedError):
        probe.play_each([script])
    failure = script.failure
    if failure and failure.is_step and failure.status == DISCARD:
        probe.shared.discards = failure.reason or "the FMU discards a step of the usual size"


def _cause(probe: Probe, script: Script, failure: Reply) -> str:
    """Returns the problem of a call, or that initialization mode does not lead into event mode."""
    if failure is script.replies[2] and failure.function == _NEW_STATES:
        exited = do.initialise, do.call("fmi2ExitInitializationMode"), do.enter_event_mode
        if probe.script(*exited, do.call("new_discrete_states")).play(keep_going=True).succeeded:
            words = f"{_NEW_STATES} fails before fmi2EnterEventMode, and succeeds after it"
            return f"fmi2ExitInitializationMode does not lead into event mode: {words}; {failure.logged}"
    return failure.problem


@behaviour_rule("4.1.2")
def runs_are_repeatable(probe: Probe) -> Iterator[str]:
    """Instances give the same outputs for the same calls, if processes do so: else nothing more is judged."""
    different = [*_differences(probe)]
    if different:
        with probe.process.in_new_processes():
            if any(_differences(probe)):
                raise NotJudgedError(RANDOM)
    # equation (4.1): the generator of random numbers is a part of that state
    reason = "by 4.1.2 steps follow from the instance's own state: instances share no random numbers"
    yield from (f"{message}; {reason}" for message in different)


def _differences(probe: Probe) -> Iterator[str]:
    first, second = (probe.script(do.begin, do.run(5)).play().readings for _ in range(2))
    return (found.text for found in values.differing(first, second, "in a second instance"))


@behaviour_rule("2.1.5")
def wrong_guid_is_refused(probe: Probe) -> Iterator[str]:
    """fmi2Instantiate returns NULL for any GUID but the description's, also for a similar one."""
    guid = probe.fmu.root.get("guid", "")
    other = guid[:-2] + ("1" if guid[-2:-1] == "0" else "0") + guid[-1:]
    for wrong in dict.fromkeys([_WRONG_GUID, guid[:-1], f"{guid}0", other, guid.swapcase()]):
        if wrong != guid and probe.creates(guid=wrong)[0]:
            yield f"fmi2Instantiate gave an instance for the wrong GUID {wrong!r}: expected NULL"
            return


@differential("4.3.1", condition=values.if_not_claimed(ONLY_ONCE))
def several_instances(probe: Probe) -> Iterator[Row]:
    """Instances share no state: setting and reading values, steps and the end of one change nothing in
    another. An error of another rule that a new process does not show is a finding of this rule.
    """
    yield from paths.rows(probe, paths.beside)
    changed = do.set_others(probe.fmu.settable_before), do.initialise
    moved = do.begin, do.set_others(probe.fmu.settable_while_stepping), do.step()
    usual, another = (do.start, do.run(5)), (changed[0], *moved)
    # once it is created last, once it begins last
    for beside in ((changed, another, usual), (usual, another)):
        varied = do.start, do.run(2), do.pause, do.run(3)
        yield Row("beside another instance", varied, usual, beside=beside)
    fmu = probe.fmu
    modes = [((do.initialise,), fmu.settable_in_initialization, fmu.readable_in_initialization)]
    if probe.fmu.is_model_exchange:
        modes.append(((do.begin,), fmu.settable_while_stepping, [*fmu.variables]))
    for begin, settable, readable in modes:
        glance, last = do.glance(readable), do.read(readable)
        # the FMU may refuse values, as another rule reports
        with suppress(NotJudgedError):
            others = do.set_values(do.others_accepted(probe, settable, *begin))
            for first in ((*begin, glance, others), (*begin, others, glance)):
                varied, usual = (*first, do.pause, last), (*first, last)
                yield Row("after another instance was read", varied, usual, beside=((*begin, glance),))
    varied = do.begin, do.run(1), do.pause, do.pause, do.run(2)
    identifiers = [stated.get("modelIdentifier") for stated in probe.fmu.interfaces.values()]
    # both interfaces are in one library
    if len({*identifiers}) < len(identifiers):
        other = {"interface": CO_SIMULATION if probe.fmu.is_model_exchange else MODEL_EXCHANGE}
        run, beside = (do.begin, do.run(3)), ((do.set_debug_logging(False),),)
        yield Row("beside an instance of the other interface", run, run, options=other, beside=beside)
    freed = do.begin, do.step(), do.pause, do.call("free")
    yield Row("after another instance was freed", varied, beside=(freed,))


@behaviour_rule("2.1.5", condition=values.if_not_claimed(ONLY_ONCE))
def instances_follow_each_other(probe: Probe) -> None:
    """After some instances that were used and freed, another one takes a step."""
    for _ in range(_INSTANCES):
        probe.script(do.begin, do.step()).play()


@differential("2.1.3", condition=values.if_not_claimed(ONLY_ONCE))
def error_leaves_other_instances_unchanged(probe: Probe) -> Iterator[Row]:
    """After an error, other instances go on as before."""
    failing = do.begin, do.step(), do.pause, do.fail, do.pause, do.reset, do.begin, do.step(3)
    varied = do.begin, do.run(1), do.pause, do.pause, do.run(2)
    yield Row("beside an instance in error", varied, beside=(failing,))
