"""Tables of the calls that the state machines of 3.2.3 and 4.2.4 allow, and how rules ask for calls."""

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row, late_lead
from fmus.compliance.fmu_file import CO_SIMULATION, MODEL_EXCHANGE
from fmus.compliance.probe import Probe
from fmus.compliance.script import KINDS, Action, Reply, Script
from fmus.compliance.texts import VECTORS
from fmus.fmi.binding import ERROR, FATAL

NAME = "instance of the tour"
_MOST_ALONE = 10  # variables, each set in a separate call
_MOST_FAILED = 5  # calls of a tour
TOLERANCE, LARGE_TOLERANCE = 1e-5, 1e-3
WITH_TOLERANCE = *do.begin_until(1000, TOLERANCE), do.step(2)

Calls = Callable[[Probe, str], Iterable[Action]]


def _log(probe: Probe, _: str) -> Iterator[Action]:
    yield do.set_debug_logging(False)
    if categories := probe.fmu.log_categories:
        yield do.set_debug_logging(True, *categories)
    yield do.set_debug_logging(True)


def _save(probe: Probe, _: str) -> Iterator[Action]:
    def action(script: Script) -> None:
        # the number of the call is a slot that no other state has
        slot = len(script.calls)
        for method in methods:
            script.call(method, slot)

    serialised = "state_size state_bytes " * probe.fmu.claims(values.SERIALISES)
    methods = f"save_state {serialised}set_state free_state".split()
    if probe.fmu.claims(values.SAVES):
        yield action


def _set(probe: Probe, state: str) -> Iterator[Action]:
    """Yields actions that set variables to their start values, some alone, so that a message names them."""
    fmu = probe.fmu
    at_first = {"I": fmu.settable_before, "M": fmu.settable_in_initialization}
    chosen = at_first.get(state, fmu.settable_while_stepping)
    pairs = values.start_values(chosen if state != "K" else values.continuous_reals(probe, "input"))
    yield from (do.set_values([pair]) for pair in pairs[:_MOST_ALONE])
    yield from do.set_at_once(pairs[_MOST_ALONE:])


def _get(probe: Probe, state: str) -> Iterator[Action]:
    # most FMUs answer when instantiated too, which does no harm
    if state != "I":
        at_first = probe.fmu.readable_in_initialization
        variables = at_first if state == "M" else probe.fmu.variables
        yield from (do.glance(variables), do.glance(variables[::-1]))
        # each type is read first after the time is set, which may compute it alone
        for kind in KINDS if state == "K" else ():
            yield from (do.set_time, do.glance([v for v in variables if v.base_kind == kind]))


def _output_derivatives(probe: Probe, _: str) -> Iterator[Action]:
    outputs = values.references_of(values.continuous_reals(probe, "output"))
    for order in range(1, probe.fmu.output_derivative_order + 1) if outputs else ():
        yield do.call("output_derivatives", outputs, order)


def _directional_derivatives(probe: Probe, state: str) -> Iterator[Action]:
    sections = ("InitialUnknowns",) if state == "M" else ("Outputs", "Derivatives")
    unknowns = {u.variable.index: u.variable for name in sections for u in probe.fmu.unknowns[name]}
    references = values.references_of(v for v in unknowns.values() if v.kind == "Real")
    inputs = values.references_of(values.continuous_reals(probe, "input"))
    if references and inputs and probe.fmu.claims("providesDirectionalDerivative"):
        yield do.call("directional_derivatives", references, inputs, [1.0] * len(inputs))


def vectors(probe: Probe, state: str) -> Iterator[Action]:
    """Yields calls that read non-empty vectors; when instantiated, only nominal values."""
    for function in VECTORS[-1:] if state == "I" else VECTORS:
        if probe.fmu.is_model_exchange and probe.fmu.vector_length(function):
            yield do.call("vector", function)


def _complete_step(probe: Probe, _: str) -> Iterator[Action]:
    if not probe.fmu.claims("completedIntegratorStepNotNeeded"):
        yield do.call("completed_integrator_step")


@dataclass(frozen=True)
class Table:
    """States of an interface, each a letter, and the calls that each allows.

    I instantiated, M initialization mode, B and C step complete, before the first step and after one, E event
    mode, K continuous-time mode, T terminated, D after an error.

    ways: state -> actions that lead there from instantiation
    questions, changes: states with their calls, with usual arguments, but calls that lead to another state or
      that another rule makes; only the latter may change values
    stepping: state between two steps of `CalledInstance.do_step`
    """

    ways: Mapping[str, Sequence[Action]]
    questions: Sequence[tuple[str, Calls]]
    changes: Sequence[tuple[str, Calls]]
    stepping: str

    @property
    def allowed(self) -> Sequence[tuple[str, Calls]]:
        """Questions and changes: by 4.2.4 a slave may refuse fmi2Get* from fmi2Set* until fmi2DoStep."""
        return *self.questions, *self.changes


_BEGIN = {"I": (), "M": (do.initialise,)}
_END = {"T": (do.begin, do.step(), do.terminate), "D": (do.begin, do.fail, do.in_state("error"))}
TABLES = {
    CO_SIMULATION: Table(
        ways={**_BEGIN, "B": (do.begin,), "C": (do.begin, do.step()), **_END},
        questions=(
            ("IMBCT", _log),
            ("MBCT", _get),
            ("BCT", _output_derivatives),
            ("MBCT", _directional_derivatives),
        ),
        changes=(("IMBCT", _save), ("IMBC", _set), ("MBC", lambda *_: [do.set_derivatives(0.0)])),
        stepping="C",
    ),
    MODEL_EXCHANGE: Table(
        ways={**_BEGIN, "E": (do.begin,), "K": (do.begin, do.enter_continuous_time_mode), **_END},
        questions=(
            ("IMEKT", _log),
            ("MEKT", _get),
            ("MEKT", _directional_derivatives),
            ("EK", vectors),
        ),
        changes=(
            ("IMEKT", _save),
            ("IMEK", _set),
            ("M", lambda *_: [do.set_derivatives(0.0)]),
            ("K", _complete_step),
            ("E", lambda *_: [do.call("new_discrete_states")]),
        ),
        stepping="E",
    ),
}


class Tour(NamedTuple):
    """The calls that the states from instantiated to terminated allow, with a tolerance and a stop time, at
    the begin of a run and late in it.

    script: with settings of the process watched; failed: replies of calls that it leaves out, as they fail
    """

    script: Script
    failed: list[Reply]


def tour(probe: Probe) -> Tour:
    """Returns the tour through the states, played once for all rules."""
    return probe.once("tour of the states", lambda: _played_tour(probe))


def _played_tour(probe: Probe) -> Tour:
    failed, left_out = list[Reply](), set[tuple[int, str]]()
    while True:
        script, rows = _tour(probe, left_out)
        script.play(keep_going=True)
        wrong = [reply for reply in script.replies if reply.status in (ERROR, FATAL)]
        row = next((row for row, replies in rows.items() if wrong and wrong[0] in replies), None)
        failed += wrong[:1]
        if row is None or len(failed) == _MOST_FAILED:
            return Tour(script, failed)
        left_out.add(row)


def _tour(
    probe: Probe, left_out: Container[tuple[int, str]]
) -> tuple[Script, dict[tuple[int, str], list[Reply]]]:
    """Returns the script of a tour, and the replies of each row in each state but those left out."""
    tolerance = TOLERANCE if run_with_tolerance(probe).succeeded else None
    initialise = do.set_up(1000, tolerance), do.enter_initialization_mode
    late = late_lead(probe)
    steps, enter = ((do.step(),), (*late, do.step())), (do.enter_continuous_time_mode,)
    states, later = "IMBCCT", (*steps, (do.step(), do.terminate))
    if probe.fmu.is_model_exchange:
        # the event of the settings before is over then
        iterated = do.step(), *enter
        states, later = "IMEKEEEKT", (enter, (do.enter_event_mode,), *steps, iterated, (do.terminate,))
    script, rows = probe.script(name=NAME, logging=True, watched=True), dict[tuple[int, str], list[Reply]]()
    leads = (), initialise, (do.exit_initialization_mode,), *later
    for lead, state in zip(leads, states, strict=True):
        script.write(lead)
        for i, (allowed, calls) in enumerate(TABLES[probe.fmu.interface].allowed):
            if state in allowed and (i, state) not in left_out:
                rows.setdefault((i, state), []).extend(script.write(calls(probe, state)))
    return script, rows


def run_with_tolerance(probe: Probe) -> Script:
    """Returns a run in which tolerance and stop time are defined."""
    return do.played(probe, WITH_TOLERANCE, logging=True)


# calls that rules ask for


def in_states(probe: Probe, states: str, *actions: Action) -> Iterator[Row]:
    """Yields a row for each state that the interface has: calls in it that succeed."""
    ways = TABLES[probe.fmu.interface].ways
    for state in (state for state in states if state in ways):
        yield Row("", (*ways[state], *actions), (), failing="in the state {state!r}")
