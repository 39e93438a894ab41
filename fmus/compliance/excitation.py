"""Runs in which inputs and tunable parameters have random values, and the states that they lead to."""

import random
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import chain, pairwise, product
from typing import Any, NamedTuple

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError
from fmus.compliance.script import Action, CallError, Script
from fmus.compliance.variable import Variable

_MOST_RUNS, _MOST_VAIN, _LONGEST_S = 24, 4, 3.0  # runs; in a row that show nothing new; CPU time of all
_CHANGING, _SLIGHT = 0.5, 0.1  # share of values that change in a part, and part by which some do
_LATE = range(4, 7)  # of eight parts of a run: some is left for what follows
_KINDS = 3  # of runs: inputs that change slightly, or far; and parameters and the first states, too
_INSIDE = 0.9  # of the way to a far start value of a state, which may be a limit
_CHOSEN = 6  # runs
_MOST_VALUES = 8  # of a variable that distinguishes cases; a counter has more
Sets = Sequence[Sequence[do.Pair]]
_Case = tuple[str, Any]  # name and value of a discrete variable


class Excitation(NamedTuple):
    """A run by the values that are set: states in initialization mode, and others for each of its parts."""

    states: Sequence[do.Pair]
    sets: Sets

    @property
    def begin(self) -> Sequence[Action]:
        """Actions that initialise the instance."""
        return do.initialise, do.set_values(self.states), do.exit_initialization_mode


_Run = tuple[Excitation, Sequence[set[_Case]]]  # with the cases at the begin, and at each end that is met


class Excitations(NamedTuple):
    """Some runs.

    runs: those whose discrete variables change as in few others; lead: the values of the begin of a run, up
    to where most of them have other values than at its start, and rare ones
    """

    runs: list[Excitation]
    lead: Sets


def excitations(probe: Probe) -> Excitations:
    """Returns runs in which inputs and tunable parameters have values by lot: those at the start, and others
    that the FMU accepts. There are no runs without other values, or where calls of usual runs fail.
    """

    def chosen() -> Excitations:
        with suppress(CallError, NotJudgedError, NotApplicableError):
            return _chosen(_runs(probe))
        return Excitations([], [])

    return probe.once("runs with other inputs", chosen)


def played(probe: Probe) -> list[Script]:
    """Returns such runs, in which all variables are read after each part; played once for all rules."""
    read = do.read(probe.fmu.variables)
    runs = ([*run.begin, do.excite(run.sets, lambda _: read)] for run in excitations(probe).runs)
    return [do.played(probe, run, logging=True, watched=True) for run in runs]


def _runs(probe: Probe) -> list[_Run]:
    chosen = values.settable_while_stepping(probe.fmu)[: do.MOST_VARIABLES]
    near, *far = [*do.others_in_turn(probe, chosen, do.begin, do.step())] or [[]]
    others = [*chain(*far)]

    def ways(pairs: Sequence[do.Pair], variables: Sequence[Variable] = chosen) -> list[list[do.Pair]]:
        return [[(v, x), *(p for p in pairs if p[0] is v)] for v, x in values.start_values(variables)]

    # what one FMU needs to get on is too much for another, and parameters may contradict others
    slight = [(v, values.other_value(v, _SLIGHT)) if v.kind == "Real" else (v, x) for v, x in near]
    inputs = ([way for way in ways(pairs) if way[0][0].causality == "input"] for pairs in (slight, others))
    kinds = *inputs, ways(others)
    states = [v for v in values.settable_in_initialization(probe.fmu) if v.index in probe.fmu.states]
    moved = [(v, x + _INSIDE * (y - x)) for v, x in values.start_values(states) for y in values.far_values(v)]
    first = ways(do.accepted_together(probe, moved, do.initialise), states)
    discrete = [v for v in probe.fmu.variables if v.variability == "discrete" and v.causality != "input"]
    read = do.read([v for v in discrete if v.kind != "Real"])
    lots, lots_of_states, cpu_time = random.Random(1), random.Random(2), 0.0
    runs, seen, vain = list[_Run](), set[_Case](), 0
    while [*near, *others] and len(runs) < _MOST_RUNS and vain < _MOST_VAIN and cpu_time < _LONGEST_S:
        kind = kinds[len(runs) % _KINDS]
        sets = [[lots.choice(way) for way in kind]]
        for _ in range(do.LEAPS - 1):
            drawn = [(lots.choice(way), lots.random() < _CHANGING) for way in kind]
            sets.append([new if is_new else old for (new, is_new), old in zip(drawn, sets[-1], strict=True)])
        run = Excitation([lots_of_states.choice(way) for way in first if kind is kinds[-1]], sets)
        measure = do.call("cpu_time")
        script = probe.script(measure, *run.begin, read, do.excite(sets, lambda _: read), measure)
        probe.play_each([script])
        cpu_time += script.cpu_time
        met = sum(reply.is_step and reply.ok for reply in script.replies)
        places = [{*reading.values.items()} for reading in script.readings[: met + 1]]
        runs.append((run, places))
        vain = 0 if set[_Case]().union(*places) - seen else vain + 1
        seen.update(*places)
    return runs


def _chosen(runs: Sequence[_Run]) -> Excitations:
    """Returns the runs and the begin of one that lead to the rarest cases, of all variables and of each."""
    counts = Counter(chain(*(set[_Case]().union(*places) for _, places in runs)))
    cases = Counter(name for name, _ in counts)
    rarities = {case: 1 / n if cases[case[0]] <= _MOST_VALUES else 0.0 for case, n in counts.items()}
    ends = [
        (sum(1 + rarities[case] for case in place - first), run.sets[:i])
        for number, (run, (first, *places)) in enumerate(runs)
        for i, place in enumerate(places, 1)
        # odd parameters often cause numerical trouble
        if i in _LATE and number % _KINDS < _KINDS - 1
    ]
    lead = max(ends, key=lambda end: end[0], default=(0.0, []))[1]
    changes = [_changes(places, rarities) for _, places in runs]
    numbers, chosen = Counter(chain(*changes)), list[Excitation]()
    while len(chosen) < _CHOSEN and (any(changes) or (runs and not chosen)):
        best = max(range(len(runs)), key=lambda i: sum(1 / numbers[change] for change in changes[i]))
        chosen.append(runs[best][0])
        changes = [some - changes[best] for some in changes]
    return Excitations(chosen, lead)


def _changes(places: Sequence[set[_Case]], rarities: Mapping[_Case, float]) -> set[Any]:
    """Returns the cases that variables with few of them leave and enter, and whether a call fails."""
    changes = {
        (old, new)
        for before, after in pairwise(places)
        for old, new in product(before - after, after - before)
        if old[0] == new[0] and rarities[old]
    }
    return changes if len(places) > do.LEAPS else {*changes, "a call fails"}
