"""Setting variables: which, when, and what is read then."""

from collections.abc import Iterator

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.actions import MOST_VARIABLES
from fmus.compliance.differential import Row, differential
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError
from fmus.compliance.values import RESTARTED
from fmus.compliance.variable import is_true

_ROUNDED, _EXACT = 1e-6, 1e-12
_MANY_SETS = "canHandleMultipleSetPerTimeInstant"


@differential("2.1.6")
def values_that_are_set_are_read(probe: Probe) -> Iterator[Row]:
    """Values that are set when instantiated or in initialization mode are read afterwards."""
    readable = values.readable_in_initialization(probe.fmu)
    instantiated = [v for v in values.settable_before(probe.fmu) if v.initial == "exact"]
    for chosen, before, after, when in (
        (instantiated, (), (do.initialise,), "when instantiated"),
        (values.settable_in_initialization(probe.fmu), (do.initialise,), (), "in initialization mode"),
    ):
        for v, x in values.other_values(chosen[:MOST_VARIABLES]):
            if v in readable:
                end = do.read_as([(v, x)]), do.exit_initialization_mode
            elif values.keeps_its_value(v):
                end = do.exit_initialization_mode, do.read_as([(v, x)])
            else:
                continue
            yield _set_and_read(when, *before, do.set_values([(v, x)]), *after, *end)


def _set_and_read(when: str, *actions: do.Action) -> Row:
    return Row(f"after it was set {when}", actions, (), tolerance=_EXACT, may_fail=True, again="{}")


@differential("4.1.2")
def inputs_that_are_set_are_read(probe: Probe) -> Iterator[Row]:
    """An input or tunable parameter that is set at a communication point has that value after the step: near
    its start value, or far from it within its range; a String also if it is long or empty. The FMU may refuse
    a value.
    """
    chosen = values.settable_while_stepping(probe.fmu)[:MOST_VARIABLES]
    far = [(v, x) for v in chosen for x in values.far_values(v)]
    for pair in [*values.other_values(chosen), *far]:
        actions = do.begin, do.step(), do.set_values([pair]), do.step(), do.read_as([pair])
        yield _set_and_read("at a communication point", *actions)
    if probe.fmu.is_model_exchange:
        chosen = [v for v in chosen if is_true(v.attributes.get(_MANY_SETS, "true"))]
    near = do.others_accepted(probe, chosen, do.begin, do.step())
    starts = do.set_values(values.start_values(v for v, _ in near))
    first = do.start, do.set_values(near), do.step(), starts, do.set_values(near), do.step()
    yield _set_and_read("twice at a communication point", *first, do.read_as(near))
    if probe.fmu.is_model_exchange:
        near = [(v, x) for v, x in near if v in values.continuous_reals(probe, "input")]
        sets = (do.set_values([(v, values.start_value(v)), (v, x)]) for v, x in near)
        first = do.start, do.enter_continuous_time_mode, *sets
        yield _set_and_read("twice in continuous-time mode", *first, do.read_as(near))


@differential("2.1.2")
def strings_are_copied(probe: Probe) -> Iterator[Row]:
    """A String that is set is copied: it is read as it was although its memory was overwritten."""
    chosen = [v for v in values.settable_in_initialization(probe.fmu) if v.base_kind == "String"]
    kept = [v for v in chosen[:MOST_VARIABLES] if v.start and values.keeps_its_value(v)]
    for pair in values.start_values(kept):
        set_start = do.initialise, do.set_values([pair]), do.exit_initialization_mode
        when = "after it was set and its memory overwritten"
        yield Row(when, (*set_start, do.read_as([pair])), (), "", again="{}, a copy")


@differential("2.1.7")
def values_follow_what_is_set(probe: Probe) -> Iterator[Row]:
    """Values follow what is set, also if they had been read before that: in initialization mode, and for
    model exchange in event mode, and in continuous-time mode after continuous inputs.
    """
    fmu, enter = probe.fmu, do.enter_continuous_time_mode
    modes = [
        ("initialization mode", (do.initialise,), values.settable_in_initialization(fmu),
         values.readable_in_initialization(fmu)),
        ("event mode", (do.begin,), values.settable_while_stepping(fmu), fmu.variables),
        ("continuous-time mode", (do.begin, enter), values.continuous_reals(probe, "input"), fmu.variables),
    ]  # fmt: skip
    for mode, begin, settable, readable in modes if fmu.is_model_exchange else modes[:1]:
        # without an effect of others, one variable may have none
        others = do.others_accepted(probe, settable, *begin) if enter not in begin else []
        for v, x in values.other_values(settable[:MOST_VARIABLES]):
            first = *begin, do.set_values([pair for pair in others if pair[0] is not v])
            end = do.set_values([(v, x)]), do.read(readable)
            when = f"where it had been read in {mode} before {v.name} was set"
            varied = *first, do.glance(readable), *end
            yield Row(when, varied, (*first, *end), tolerance=_ROUNDED, may_fail=True)
        if mode != "initialization mode":  # as if time had been set, which computes anew
            # an event iteration ends first, after which relations that follow what is set are frozen
            iterate, into = ((), ()) if begin[1:] else ((do.call("new_discrete_states"),) * 3, (enter,))
            set_all = do.start, *begin[1:], do.glance(readable), do.set_values(values.other_values(settable))
            follow = [v for v in fmu.variables if v.kind == "Real" and v.variability == "continuous"]
            usual = *set_all, *iterate, *into, do.set_time, do.read(follow)
            when = f"where it had been read in {mode} before others were set"
            yield Row(when, (*set_all, *iterate, do.read(follow)), usual, tolerance=_ROUNDED, may_fail=True)


@differential("4.1.2")
def setting_the_same_changes_nothing(probe: Probe) -> Iterator[Row]:
    """Inputs and tunable parameters can be set at communication points; set to what they are, no state
    is lost.
    """
    chosen = values.settable_while_stepping(probe.fmu)
    if not chosen:
        raise NotApplicableError("there is neither an input nor a tunable parameter")
    varied = do.start, *(do.set_values(values.start_values(chosen)), do.run(1)) * 4
    when = "where inputs and tunable parameters were set to what they are"
    yield Row(when, varied, (do.start, do.run(4)), "in the state {state!r}", RESTARTED)
