"""Setting up, initialising and resetting an FMU: start values, and what fmi2Reset gives back."""

from collections.abc import Iterable, Iterator
from itertools import chain

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.actions import MOST_VARIABLES, Action
from fmus.compliance.differential import OF_EXPERIMENT, Row, differential
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError
from fmus.compliance.script import KINDS

_ROUNDED = 1e-6  # relative: tools write start values with as few as seven digits


def _rows_of_starts(probe: Probe, when: str, *before: Action) -> Iterator[Row]:
    """Yields rows of start values, read in initialization mode, or after it where only then they can be."""
    declared = values.start_values(
        v
        for v in probe.fmu.variables
        if v.variability != "constant" and (v.initial == "exact" or v.causality == "input")
    )
    readable = values.readable_in_initialization(probe.fmu)
    at_first = do.initialise, do.read_as([(v, x) for v, x in declared if v in readable])
    later = do.begin, do.read_as([(v, x) for v, x in declared if values.keeps_its_value(v)])
    for after in (at_first, later):
        yield Row(when, (*before, *after), (), tolerance=_ROUNDED, may_fail=True, again="its start value {}")


@differential("2.1.7")
def start_values_are_as_declared(probe: Probe) -> Iterable[Row]:
    """Variables with initial exact and inputs have their start values: in initialization mode, or after it
    where only then they can be read.
    """
    return _rows_of_starts(probe, "at first")


@differential("2.1.6")
def reset_gives_the_start_values(probe: Probe) -> Iterator[Row]:
    """After other values, a stop time, changed inputs, steps and fmi2Reset, start values are back, and every
    variable is in the same steps as in a new instance.
    """
    usual = do.begin, do.read_all(), do.run_all(5)
    for stop, words in (((do.step(5),), ""), ((do.step(), do.fail), "an error and ")):
        when, varied = f"after {words}fmi2Reset", (do.start, *stop, do.reset, *usual)
        yield Row(when, varied, usual, tolerance=OF_EXPERIMENT)
    others = do.set_others(values.settable_before(probe.fmu))
    yield from _rows_of_starts(probe, "after other values and fmi2Reset", others, do.reset)
    stepping = do.set_others(values.settable_while_stepping(probe.fmu)), do.step(), do.set_derivatives()
    varied = do.ignore(others, *do.begin_until(2), *stepping, do.reset), do.begin, do.run_all(5)
    when, failing = "after other values and fmi2Reset", "after other values, a stop time and fmi2Reset"
    yield Row(when, varied, (do.begin, do.run_all(5)), failing, OF_EXPERIMENT)


@differential("2.1.6")
def set_up_can_be_repeated(probe: Probe) -> Iterator[Row]:
    """fmi2SetupExperiment may be called at least once: the last call counts, for time and stop time, and what
    was set before it stays.
    """
    another = do.call("set_up_experiment", probe.point(7), probe.point(8))
    yield Row("after a second fmi2SetupExperiment", (another, do.begin, do.run(2)))


@differential("advice: a user may want to see windows")
def visible_instances_run(_: Probe) -> Iterator[Row]:
    """With visible = fmi2True an instance is created and takes a step."""
    yield Row("with visible = fmi2True", (do.begin, do.step()), options={"visible": True})


@differential("2.1.7")
def values_are_set_together(probe: Probe) -> Iterator[Row]:
    """Several variables that are set in one call have the values that they have if each is set in a call of
    its own.
    """
    pairs = values.other_values(values.settable_in_initialization(probe.fmu))
    of_kinds = [[pair for pair in pairs if pair[0].base_kind == kind][:MOST_VARIABLES] for kind in KINDS]
    taken = values.accepted_together(probe, list(chain(*of_kinds)), lambda: probe.script().initialise())
    several = [
        chosen for of_kind in of_kinds if len(chosen := [pair for pair in of_kind if pair in taken]) > 1
    ]
    if not several:
        raise NotApplicableError("no two variables of one type take other values in initialization mode")
    for ordered in [*several, *(chosen[::-1] for chosen in several)]:
        kind = ordered[0][0].base_kind
        end = do.exit_initialization_mode, do.read([v for v, _ in ordered])
        usual = do.initialise, do.set_values(ordered), *end
        together = do.initialise, do.set_at_once(kind, ordered), *end
        when = f"where one fmi2Set{kind} sets {len(ordered)} variables"
        yield Row(when, together, usual, may_fail=True, again="{}, as it is set alone")
