"""Start values, setting and reading variables, and values after fmi2Reset."""

from collections.abc import Iterable, Iterator

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import OF_EXPERIMENT, Row, differences, differential
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, behaviour_rule
from fmus.compliance.rules.derivatives import NOISE, values_of
from fmus.compliance.rules.events import follow_at_once
from fmus.compliance.script import SETTERS
from fmus.compliance.texts import VECTORS
from fmus.compliance.traces import paths
from fmus.compliance.traces.generator import excited
from fmus.fmi.binding import DISCARD, ERROR, FATAL, WARNING

_ROUNDED = 1e-6  # relative: tools write start values with as few as seven digits
_EXACT = 1e-12


def _rows_of_starts(probe: Probe, when: str, *before: do.Action) -> Iterator[Row]:
    """Yields rows of start values, read in initialization mode, or after it where only then they can be."""
    declared = values.start_values(
        v
        for v in probe.fmu.variables
        if v.variability != "constant" and (v.initial == "exact" or v.causality == "input")
    )
    readable = {*probe.fmu.readable_in_initialization}
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
    """After other values, a stop time, changed inputs, steps, fmi2Terminate and fmi2Reset, start values are
    back, and every variable is in the same steps as in a new instance.
    """
    changed = do.set_others(probe.fmu.settable_while_stepping)
    ended = do.together(changed, do.ignore(do.leap(1), do.terminate))
    others = do.set_others(probe.fmu.settable_before)
    yield from _rows_of_starts(probe, "after other values and fmi2Reset", others, do.reset)
    usual = do.begin, do.read_all(), do.run_all(5)
    for stop, words in ((do.step(5), ""), (ended, "other values, fmi2Terminate and ")):
        yield Row(
            f"after {words}fmi2Reset", (do.start, stop, do.reset, *usual), usual, tolerance=OF_EXPERIMENT
        )
    yield from paths.rows(probe, paths.after_reset)
    yield from paths.rows(probe, paths.after_an_error)


@differential("2.1.6")
def set_up_can_be_repeated(probe: Probe) -> Iterator[Row]:
    """fmi2SetupExperiment may be called again: the last call counts for start and stop time, and values that
    were set before stay.
    """
    another = do.call("set_up_experiment", probe.point(7), probe.point(8))
    yield Row("after a second fmi2SetupExperiment", (another, do.begin, do.run(2)))


@behaviour_rule("4.1.2")
def start_time_counts_at_once(probe: Probe) -> Iterator[str]:
    """Continuous outputs that keep their values when initialization mode ends, with the start time of the
    default experiment, also keep them with another start time.
    """
    outputs = values.continuous_reals(probe, "output")
    read, inputs = do.read(outputs), values.start_values(probe.fmu.settable_while_stepping)
    # earlier results are not kept; 4.2.4 has no reading between setting and a step
    sets = [do.set_values(inputs)] if probe.fmu.is_model_exchange else []
    anew = do.exit_initialization_mode, *sets, read

    def changed(start: int) -> dict[str, tuple[float, float]]:
        begin = do.set_up(1000, start=start), do.enter_initialization_mode
        (run,) = values_of(probe, [(*begin, read, *anew)])
        pairs = [(v, run[0][v.name], run[1][v.name]) for v in outputs if run]
        return {v.name: (a, b) for v, a, b in pairs if not values.same(a, b, _ROUNDED, v.nominal)}

    usual, other = changed(0), changed(3)
    for name in other.keys() - usual.keys():
        got, expected = values.texts(*other[name])
        when = f"in initialization mode with startTime {probe.point(3):g} s"
        yield f"{name} is {got} {when}: expected {expected}, as after it"


@differential("2.1.7")
def values_are_set_together(probe: Probe) -> Iterator[Row]:
    """Several variables that one call sets have the same values as if each were set in a separate call."""
    yield from paths.rows(probe, paths.set_otherwise)


# setting


@differential("2.1.6")
def values_that_are_set_are_read(probe: Probe) -> Iterator[Row]:
    """Values that are set when instantiated or in initialization mode are read afterwards, and have the same
    effect in both states.
    """
    readable = probe.fmu.readable_in_initialization
    instantiated = [v for v in probe.fmu.settable_before if v.initial == "exact"]
    for chosen, before, after, when in (
        (instantiated, (), (do.initialise,), "when instantiated"),
        (probe.fmu.settable_in_initialization, (do.initialise,), (), "in initialization mode"),
    ):
        taken = do.others_accepted(probe, chosen, *before)
        at_once = [(v, x) for v, x in taken if v in readable]
        later = [(v, x) for v, x in taken if v not in readable and values.keeps_its_value(v)]
        end = do.read_as(at_once), do.exit_initialization_mode, do.read_as(later)
        yield _set_and_read(when, *before, do.set_values(taken), *after, *end)
    taken = do.others_accepted(probe, instantiated, do.initialise)
    end = do.exit_initialization_mode, do.read_all(), do.run_all(2)
    sets, when = do.set_values(taken), "where values were set after fmi2EnterInitializationMode"
    varied, usual = (do.initialise, sets, *end), (sets, do.initialise, *end)
    again = "{}, as where the same values were set before it"
    yield Row(when, varied, usual, tolerance=_ROUNDED, may_fail=True, again=again)


def _set_and_read(when: str, *actions: do.Action) -> Row:
    return Row(f"after it was set {when}", actions, (), tolerance=_EXACT, may_fail=True, again="{}")


@differential("4.1.2")
def inputs_that_are_set_are_read(probe: Probe) -> Iterator[Row]:
    """An input or tunable parameter that is set at a communication point has that value after the step, and
    the others keep theirs: near its start value, or far from it within its range; a String also if it is
    long or empty. The FMU may refuse a value.
    """
    chosen = probe.fmu.settable_while_stepping[: do.MOST_VARIABLES]
    for taken in do.others_in_turn(probe, chosen, do.begin, do.step()):
        others, actions = chosen, [do.begin, do.step()]
        for i, (v, x) in enumerate(taken, 1):
            others = [other for other in others if other is not v]
            when = f"after {v.name} was set at a communication point"
            actions += do.expect(do.read(others)), do.set_values([(v, x)]), do.step()
            actions += do.read(others, when), do.read_as(taken[:i], when)
        yield Row("", actions, (), tolerance=_EXACT, may_fail=True, again="{}")
    for run in excited(probe):
        yield _set_and_read("in a run", *run.initialised, do.excite(run.sets, do.read_as))
    yield from paths.rows(probe, paths.set_twice)
    near = do.others_accepted(probe, chosen, do.begin, do.step())
    first = do.start, do.set_values(near), do.step()
    yield _set_and_read("at a communication point", *first, do.read_as(near))
    if probe.fmu.is_model_exchange:
        near = [(v, x) for v, x in near if v in values.continuous_reals(probe, "input")]
        sets = (do.set_values([(v, v.start_value), (v, x)]) for v, x in near)
        first = do.start, do.enter_continuous_time_mode, *sets
        yield _set_and_read("twice in continuous-time mode", *first, do.read_as(near))


@behaviour_rule("2.1.3")
def setting_ends_nothing(probe: Probe) -> Iterator[str]:
    """After an input or a tunable parameter that the FMU takes with fmi2Warning or discards, or a Boolean
    that it takes, in initialization mode or at a communication point, a step is made.
    """
    chosen = probe.fmu.settable_while_stepping[: do.MOST_VARIABLES]
    far = [(v, x) for v in chosen for x in values.far_values(v)]
    for first, then in (((do.initialise,), (do.exit_initialization_mode,)), ((do.begin, do.step()), ())):
        taken = {(v.name, x) for pairs in do.others_in_turn(probe, chosen, *first) for v, x in pairs}
        for pair in (pair for pair in far if (pair[0].name, pair[1]) not in taken):
            way = *first, do.ignore(do.set_values([pair])), *then, do.step(), do.glance_all
            script = do.played(probe, way, logging=True)
            pairs = zip(script.calls, script.replies, strict=True)
            (reply,) = [reply for call, reply in pairs if call[0].startswith("fmi2Set")]
            goes_on = reply.status in (WARNING, DISCARD) or (reply.ok and pair[0].base_kind == "Boolean")
            if goes_on and (failure := script.failure) and failure.status in (ERROR, FATAL):
                yield f"after {reply.function}{reply.words} {reply.status_name}: {failure.problem}"


@differential("2.1.2")
def strings_are_copied(probe: Probe) -> Iterator[Row]:
    """A String that is set is copied: it is read as it was although its memory was overwritten."""
    chosen = [v for v in probe.fmu.settable_in_initialization if v.base_kind == "String"]
    kept = [v for v in chosen[: do.MOST_VARIABLES] if v.start and values.keeps_its_value(v)]
    for pair in values.start_values(kept):
        set_start = do.initialise, do.set_values([pair]), do.exit_initialization_mode
        when = "after it was set and its memory overwritten"
        yield Row(when, (*set_start, do.read_as([pair])), (), "", again="{}, a copy")


@behaviour_rule("2.1.7")
def values_follow_what_is_set(probe: Probe) -> Iterator[str]:
    """Values can be set, and follow what is set, also if they had been read before that: in initialization
    mode, and for model exchange in event mode, and in continuous-time mode after continuous inputs.
    """
    rows = [*_rows_of_what_follows(probe)]
    yield from differences(probe, rows)
    for row in rows:
        failure = do.played(probe, row.varied, logging=False).failure
        if failure and failure.function in SETTERS and do.played(probe, row.usual or ()).succeeded:
            told = do.played(probe, row.varied, logging=True).failure or failure
            yield f"{row.when}: {told.problem}"


def _rows_of_what_follows(probe: Probe) -> Iterator[Row]:
    fmu, enter = probe.fmu, do.enter_continuous_time_mode
    modes = [
        ("initialization mode", (do.initialise,), fmu.settable_in_initialization,
         fmu.readable_in_initialization),
        ("event mode", (do.begin,), fmu.settable_while_stepping, fmu.variables),
        ("continuous-time mode", (do.begin, enter), values.continuous_reals(probe, "input"), fmu.variables),
    ]  # fmt: skip
    for mode, begin, settable, readable in modes if fmu.is_model_exchange else modes[:1]:
        others = do.others_accepted(probe, settable, *begin) if enter not in begin else []
        pairs = values.other_values(settable[: do.MOST_VARIABLES])
        # a variable may have an effect beside others alone, or an input without them alone
        alone = [(pair, []) for pair in pairs if others and pair[0].causality == "input"]
        for (v, x), beside in (*((pair, others) for pair in pairs), *alone):
            first = *begin, *do.set_at_once([pair for pair in beside if pair[0] is not v])
            vectors = VECTORS[1:3] if begin[1:] else ()
            end = do.set_values([(v, x)]), do.read(readable), do.read_vectors(vectors)
            when = f"where it had been read in {mode} before {v.name} was set"
            varied = *first, do.glance(readable), do.glance_vectors(vectors), *end
            yield Row(when, varied, (*first, *end), tolerance=_ROUNDED, may_fail=True)
        # setting the time computes variables anew, so it gives the expected values
        if mode != "initialization mode":
            # an event iteration ends first, after which relations that follow what is set are frozen
            iterate, into = ((), ()) if begin[1:] else ((do.call("new_discrete_states"),) * 3, (enter,))
            set_all = do.start, *begin[1:], do.glance(readable), do.set_values(values.other_values(settable))
            follow = follow_at_once(fmu)
            usual = *set_all, *iterate, *into, do.set_time, do.read(follow)
            when = f"where it had been read in {mode} before others were set"
            yield Row(when, (*set_all, *iterate, do.read(follow)), usual, tolerance=_ROUNDED, may_fail=True)


@differential("4.1.2")
def setting_the_same_changes_nothing(probe: Probe) -> Iterator[Row]:
    """Inputs and tunable parameters can be set at communication points; setting their present values loses
    no state.
    """
    chosen = probe.fmu.settable_while_stepping
    if not chosen:
        raise NotApplicableError("there is neither an input nor a tunable parameter")
    yield from paths.rows(probe, paths.set_again, with_plain=True)


@behaviour_rule("2.2.7, 3.1")
def tunable_parameters_have_an_effect(probe: Probe) -> Iterator[str]:
    """If a tunable parameter changes an output in the first step where it is set in initialization mode, it
    changes something where it is set after it: in that step, or later.
    """
    others = do.others_accepted(probe, probe.fmu.settable_while_stepping, do.begin)
    tunable = [(v, x) for v, x in others if v.causality == "parameter"]
    if not tunable:
        raise NotApplicableError("there is no tunable parameter")

    def changed(name: str, begin: Iterable[do.Action], *end: do.Action) -> set[str]:
        """Returns names of other variables that differ from a usual run, or of a run that fails."""
        runs = values_of(probe, [(*some, *end, do.read_all()) for some in ((do.begin,), begin)])
        if not all(runs):
            return {"a run that fails"}
        (usual,), (row,) = runs
        return {n for n, x in usual.items() if n != name and not values.same(x, row[n], NOISE)}

    outputs = {v.name for v in probe.outputs}
    for v, x in tunable:
        change, step = do.set_values([(v, x)]), do.step()
        early, late = (do.initialise, change, do.exit_initialization_mode), (do.begin, change)
        # the parameter may act from the next event on
        ends = step, do.leap(3, True)
        if outputs & changed(v.name, early, step) and not any(changed(v.name, late, end) for end in ends):
            modes = "where it is set in initialization mode, and on nothing where it is set after it"
            yield f"{v.name} acts on outputs {modes}: expected the same effect"
