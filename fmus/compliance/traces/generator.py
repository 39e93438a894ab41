"""Random legal traces of an FMU: a start time, values that are set in each mode, and steps."""

import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError
from fmus.compliance.script import Action, CallError, Script
from fmus.compliance.variable import Variable

_LEGS, _MOST_STEPS = 7, 6  # of a trace; in a leg
_ODD = 0.30901699, 0.7548777, 1.6180340  # parts of the usual step size: no simple fractions
_TOGETHER = 0.4  # share of the variables that are set before a leg
_LATER = 3  # communication points from the start of the default experiment to another start
_MOST_TRIES = 6
_BEFORE = 2  # readings before the first leg
Pairs = Sequence[do.Pair]
Setting = Callable[[Pairs], Action]


def set_together(pairs: Pairs) -> Action:
    """Sets variables, all of one type in one call."""
    return lambda script: script.write(do.set_at_once(pairs))


@dataclass(frozen=True)
class Leg:
    """Values that are set at a communication point, and the sizes of the steps after it, in step sizes of the
    default experiment.
    """

    sets: Pairs
    sizes: Sequence[float]


@dataclass(frozen=True)
class Trace:
    """A run by its data: each part of it can be left out, and it stays legal.

    start: number of the communication point that it starts from
    before, early: values that are set when instantiated, and in initialization mode
    is_late: whether most of the default experiment comes before the legs
    """

    start: int
    before: Pairs
    early: Pairs
    legs: Sequence[Leg]
    is_late: bool = False

    def begin(self, setting: Setting = set_together) -> Sequence[Action]:
        """Returns actions that initialise the instance, and read what is allowed then.

        setting: returns the action that sets values
        """
        enter = setting(self.before), do.set_up(None, start=self.start), do.enter_initialization_mode
        exited = do.exit_initialization_mode, do.count_from(self.start), do.read_all()
        late = (do.leap(2), do.read_all()) if self.is_late else ()
        return *enter, setting(self.early), do.read_readable, *exited, *late

    def run(
        self, first: int = 0, last: int | None = None, setting: Setting = set_together
    ) -> Iterator[Action]:
        """Yields actions that set values and make steps of some legs, and read all variables after each."""
        for leg in self.legs[first:last]:
            yield from (setting(leg.sets), *map(do.advance, leg.sizes), do.read_all())

    @property
    def sets(self) -> Sequence[Pairs]:
        """Values that are set before each leg."""
        return [leg.sets for leg in self.legs]

    @property
    def initialised(self) -> Sequence[Action]:
        """Actions that initialise the instance at the usual start time, and read nothing."""
        sets = do.set_values(self.before), do.initialise, do.set_values(self.early)
        return *sets, do.exit_initialization_mode

    def whole(self, setting: Setting = set_together) -> Sequence[Action]:
        """Returns the actions of the whole run."""
        return *self.begin(setting), *self.run(setting=setting)


def traces(probe: Probe) -> Sequence[Trace]:
    """Returns the random traces that the FMU runs without a failed call, made once for all rules."""
    return probe.once("traces", lambda: [*_generated(probe)])


def excited(probe: Probe) -> Sequence[Trace]:
    """Returns the traces that set values while the FMU steps; none where calls of usual runs fail."""
    with suppress(CallError, NotJudgedError, NotApplicableError):
        return [trace for trace in traces(probe) if any(trace.sets)]
    return []


def played(probe: Probe) -> list[Script]:
    """Returns the runs of the traces, all watched, played once for all rules."""
    some = [probe.script(*trace.whole(), logging=True, watched=True) for trace in excited(probe)]
    probe.play_once(some)
    return some


def _generated(probe: Probe) -> Iterator[Trace]:
    lots = random.Random(probe.shared.seed)
    fmu, any_step = probe.fmu, probe.fmu.is_model_exchange or probe.fmu.claims(values.ANY_STEP)
    settable = fmu.settable_while_stepping[: do.MOST_VARIABLES]
    near, *far = [*do.others_in_turn(probe, settable, do.begin, do.step())] or [[]]
    before = do.others_accepted(probe, fmu.settable_before)
    early = do.others_accepted(probe, fmu.settable_in_initialization, do.initialise)
    is_input = [[pair for pair in pairs if pair[0].causality == "input"] for pairs in (near, *far)]
    usual, odd = (1.0,), (1.0, *_ODD) if any_step else (1.0,)
    for start, first, sets, sizes, is_late in (
        (0, False, [], usual, False),
        (0, True, [near], usual, False),
        (0, False, is_input, odd, True),
        (_LATER, True, [near, *far], odd, False),
    ):
        ways = _ways(sets)
        legs = [_leg(lots, ways, sizes) for _ in range(_LEGS)]
        at_first = [_some(lots, before), _some(lots, early)] if first else [(), ()]
        if trace := _tried(probe, Trace(start, at_first[0], at_first[1], legs, is_late)):
            yield trace


def _ways(sets: Sequence[Pairs]) -> Sequence[tuple[Variable, Sequence[Any]]]:
    """Returns each variable with its start value and others."""
    variables = {v.index: v for v, _ in chain(*sets)}
    return [
        (v, [start, *(x for other, x in chain(*sets) if other is v)])
        for v, start in values.start_values(variables.values())
    ]


def _some(lots: random.Random, pairs: Pairs) -> Pairs:
    return [pair for pair in pairs if lots.random() < _TOGETHER]


def _leg(lots: random.Random, ways: Sequence[tuple[Variable, Sequence[Any]]], sizes: Sequence[float]) -> Leg:
    chosen = ((v, some[0], lots.choice(some)) for v, some in ways if lots.random() < _TOGETHER)
    # instances and points of time seldom have a value in common then
    sets = [(v, start + lots.random() * (x - start) if v.kind == "Real" else x) for v, start, x in chosen]
    return Leg(sets, [lots.choice(sizes) for _ in range(lots.randint(1, _MOST_STEPS))])


def _tried(probe: Probe, trace: Trace) -> Trace | None:
    """Returns a trace up to where the FMU refuses a value, or discards a step; None if it does so at once."""
    for _ in range(_MOST_TRIES):
        with suppress(NotJudgedError, NotApplicableError):
            script = probe.script(*trace.whole())
            with suppress(NotJudgedError):
                probe.play_once([script])
            if script.succeeded:
                return trace
            done = sum(reading.ok for reading in script.readings) - _BEFORE - trace.is_late
            if done > 0:
                trace = replace(trace, legs=trace.legs[:done])
                continue
        if trace.is_late:
            trace = replace(trace, is_late=False)
        elif trace.before or trace.early:
            trace = replace(trace, before=(), early=())
        else:
            return None
    return None
