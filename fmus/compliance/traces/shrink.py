"""Shortest trace of calls that shows a finding: calls are left out of its scripts while it still shows."""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from difflib import SequenceMatcher
from itertools import pairwise
from typing import Any

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.script import STATES, Script
from fmus.compliance.traces import replay
from fmus.compliance.traces.replay import Call, Case, Kept, Place, ShortTrace

_MOST_TRIALS, _MOST_PROCESSES = 120, 40  # of one finding; of one crash, each in a new process

_SKELETON = (
    "set_up_experiment",
    "exit_initialization_mode",
    "set_state",
    "state_of_bytes",
    "copy_state",
    "free",
    "fmi2ExitInitializationMode",
    "fmi2SetupExperiment",
    *STATES,
)

_QUESTIONS = (
    "get",
    "vector",
    "directional_derivatives",
    "output_derivatives",
    "save_state",
    "free_state",
    "state_size",
    "state_bytes",
    "status_of",
    "fmi2SetDebugLogging",
)


def shrunk(probe: Probe, case: Case) -> ShortTrace | None:
    """Returns the shortest trace that was found, or None if the finding does not show again."""
    ends = {
        number: max(i for n, i in case.places if n == number) for number, i in case.places if i != replay.END
    }
    kept: Kept = [
        range(ends.get(number, len(script.calls) - 1) + 1) for number, script in enumerate(case.scripts)
    ]
    if not replay.shows_again(probe, case, kept):
        return None
    kept = _minimal(case, kept, lambda candidate: replay.shows_again(probe, case, candidate), _MOST_TRIALS)
    alone = replace(case, scripts=case.scripts[: case.compared])
    if replay.shows_again(probe, alone, kept[: case.compared]):
        case, kept = alone, kept[: case.compared]
    single = _narrowed(case)
    return replay.recorded(probe, single if replay.shows_again(probe, single, kept) else case, kept)


def shrunk_crash(
    fmu: FmuFile, group: Sequence[Script], ends: Callable[[Sequence[Script]], bool], is_free: bool
) -> ShortTrace:
    """Returns the shortest trace that was found of scripts that end the process side by side.

    ends: whether some scripts end a new process; is_free: whether fmi2FreeInstance does
    """
    case = Case(group, (), lambda _: True)

    def shows(candidate: Kept) -> bool:
        copies = replay.copies_of(case, candidate)
        return all(replay.is_legal(script, script.calls) for script in copies) and ends(copies)

    kept: Kept = [range(len(script.calls)) for script in group]
    # a call that ends the process has none after it
    count = bisect_left(kept[-1], 1, key=lambda count: shows([*kept[:-1], range(count)]))
    kept = _minimal(case, [*kept[:-1], range(count)], shows, _MOST_PROCESSES)
    copies = replay.copies_of(case, kept)
    scripts = [script for script in copies if script.calls] or copies[:1]
    calls = list[Call]()
    for number, script in enumerate(scripts):
        calls += replay.rehearsed(number, script, fmu)
        calls += [Call(number, replay.FREE, [], 0)] * is_free
    return ShortTrace(calls, scripts[0].options.get("uses", 0))


def _minimal(case: Case, kept: Kept, shows: Callable[[Kept], bool], most: int) -> Kept:
    """Returns what is kept of the scripts where units are left out while the finding shows.

    most: number of trials
    """
    units, trials = _units(case, kept), 0
    size = max(1, len(units) // 2)
    while units and trials < most:
        left = list[frozenset[Place]]()
        for i in range(0, len(units), size):
            chunk = units[i : i + size]
            candidate = _without(kept, frozenset[Place]().union(*chunk))
            if trials >= most or candidate == kept:
                left += chunk
                continue
            trials += 1
            if shows(candidate):
                kept = candidate
            else:
                left += chunk
        if size == 1 and len(left) == len(units):
            break
        units, size = left, max(1, size // 2)
    return kept


def _narrowed(case: Case) -> Case:
    """Returns a case that reads single variables in the places of many."""
    scripts = list(case.scripts)
    for (number, i), element in zip(case.places, case.elements, strict=False):
        method, *arguments = scripts[number].calls[i]
        if method == "get":
            scripts[number] = copy(scripts[number])
            scripts[number].calls = [*scripts[number].calls]
            scripts[number].calls[i] = (method, arguments[0], [arguments[1][element]])
    return replace(case, scripts=scripts, elements=[0] * len(case.elements))


def _without(kept: Kept, left_out: frozenset[Place]) -> Kept:
    return [[i for i in some if (number, i) not in left_out] for number, some in enumerate(kept)]


def _units(case: Case, kept: Kept) -> list[frozenset[Place]]:
    """Returns the places that can be left out together, and what remains is legal still and comparable."""
    units, needed = list[frozenset[Place]](), {*case.places}
    for number in range(len(case.scripts)):
        if number >= case.compared:
            units.append(frozenset((number, i) for i in kept[number]))
    mains = list[list[int]]()
    for number in range(case.compared):
        calls, aside = case.scripts[number].calls, set[int]()
        for block in _detours([calls[i] for i in kept[number]]):
            units.append(frozenset((number, i) for i in block))
            aside.update(block)
        mains.append([i for i in kept[number] if i not in aside])
        units += [frozenset([(number, i)]) for i in sorted(aside) if calls[i][0] not in _SKELETON]
    if case.compared == 1:
        units += [frozenset([(0, i)]) for i in mains[0] if case.scripts[0].calls[i][0] not in _SKELETON]
    else:
        units += _pairs(case, mains)
    for number in range(case.compared, len(case.scripts)):
        calls = case.scripts[number].calls
        units += [frozenset([(number, i)]) for i in kept[number] if calls[i][0] not in _SKELETON]
    return [unit for unit in units if not unit & needed]


def _pairs(case: Case, mains: Sequence[Sequence[int]]) -> Iterator[frozenset[Place]]:
    """Yields equal calls of two compared scripts, and questions of one."""
    calls = [[case.scripts[number].calls[i] for i in main] for number, main in enumerate(mains)]
    first, second = ([repr(call) for call in some] for some in calls)
    blocks = SequenceMatcher(None, first, second, False).get_matching_blocks()
    pairs = {block.a + i: block.b + i for block in blocks for i in range(block.size)}
    for a, b in pairs.items():
        if calls[0][a][0] not in _SKELETON:
            yield frozenset([(0, mains[0][a]), (1, mains[1][b])])
    for number, matched in enumerate(({*pairs}, {*pairs.values()})):
        for i, (method, *_) in enumerate(calls[number]):
            if i not in matched and method in _QUESTIONS:
                yield frozenset([(number, mains[number][i])])


def _detours(calls: Sequence[tuple[Any, ...]]) -> Iterator[Sequence[int]]:
    """Yields the indices of calls up to the last fmi2Reset, and of those from a saved state to its return:
    what they do is undone.
    """
    methods = [method for method, *_ in calls]
    resets = [i + 1 for i, method in enumerate(methods) if method == "fmi2Reset"]
    begin = resets[-1] if resets else 0
    for first, last in ((0, begin), *pairwise([0, *resets])):
        if last:
            yield range(first, last)
    saved: int | None = None
    for i in range(begin, len(methods)):
        if methods[i] == "save_state" and saved is None:
            saved = i
        if methods[i] == "set_state" and saved is not None:
            yield range(saved, i + 1)
            saved = None
