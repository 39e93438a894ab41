"""Calls of scripts made again, some of them left out, and recorded as calls of FMI."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from fmus.compliance.called_instance import CalledInstance
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.model_exchange import CalledModelExchange
from fmus.compliance.probe import Probe
from fmus.compliance.process_settings import ProcessSettings
from fmus.compliance.rule import NotJudgedError
from fmus.compliance.script import SETTERS, CallError, DefectError, Reply, Script
from fmus.compliance.texts import STEPS
from fmus.fmi.callbacks import CountingAllocator

CREATE, FREE = "fmi2Instantiate", "fmi2FreeInstance"

_DIGITS = 12  # of times that are shifted: sums of sizes are as exact


_TIMED = "do_step", "do_steps", "set_time", "fmi2SetTime"  # the first argument is a time

Place = tuple[int, int]  # a script and the index of a call in it

CREATION, END = -1, -2  # places of fmi2Instantiate and fmi2FreeInstance
Kept = Sequence[Sequence[int]]  # of each script, the indices of its calls


@dataclass(frozen=True)
class Case:
    """A finding with what showed it.

    scripts: the usual run, which is played alone, if there is one, and runs that are played side by side
    places: of the calls whose replies show the finding; elements: of the values that they read, if that is
      of single variables
    shows: whether these replies, or the values of these elements, show it
    compared: number of scripts at the begin that do the same but for what varies, 1 or 2
    """

    scripts: Sequence[Script]
    places: Sequence[Place]
    shows: Callable[[Sequence[Any]], bool]
    elements: Sequence[int] = ()
    compared: int = 1


@dataclass(frozen=True)
class Call:
    """A call as it was made: instance, function, arguments as `plain` has them, and status."""

    instance: int
    function: str
    arguments: Sequence[Any]
    status: int


@dataclass(frozen=True)
class ShortTrace:
    """The calls that show a finding, in their order, with fmi2Instantiate and fmi2FreeInstance.

    uses: of instances of FMI 3.0, see `Fmi3Library`
    """

    calls: Sequence[Call]
    uses: int = 0


def _reply(script: Script, kept: Sequence[int], place: int) -> Reply:
    if place in (CREATION, END):
        return script.creation if place == CREATION else script.end
    return script.replies[list(kept).index(place)]


def shows_again(probe: Probe, case: Case, kept: Kept) -> bool:
    scripts = copies_of(case, kept)
    if not all(is_legal(script, script.calls) for script in scripts):
        return False
    if not _keeps_contexts(case, scripts, kept):
        return False
    try:
        _play(probe, case, scripts)
    except (NotJudgedError, CallError, DefectError):
        return False
    replies = [_reply(scripts[number], kept[number], i) for number, i in case.places]
    # what failed before may fail again: calls that return error, or whose failure is ignored
    others = [
        reply
        for number, script in enumerate(scripts[: case.compared])
        for i, reply in zip(kept[number], script.replies, strict=True)
        if case.scripts[number].replies[i].ok and not any(reply is target for target in replies)
    ]
    try:
        elements = zip(replies, case.elements, strict=False)
        seen = [reply.value[i] for reply, i in elements] if case.elements else replies
        return all(reply.ok for reply in others) and case.shows(seen)
    except (TypeError, LookupError):
        return False


def recorded(probe: Probe, case: Case, kept: Kept) -> ShortTrace:
    """Returns the calls of FMI of what is kept, in their order."""
    scripts = copies_of(case, kept, recorded=True)
    _play(probe, case, scripts)
    rows = [(row, number) for number, script in enumerate(scripts) for row in script.end.value]
    # each row begins with the time of its call
    rows.sort(key=lambda pair: pair[0][0])
    uses = scripts[0].options.get("uses", 0)
    return ShortTrace([Call(number, *call) for (_, *call), number in rows], uses)


class _Silent:
    """A library all of whose functions return ok and write nothing."""

    def __getattr__(self, name: str) -> Callable[..., int]:
        return lambda *_: int(name == CREATE)


def rehearsed(number: int, script: Script, fmu: FmuFile) -> list[Call]:
    """Returns the calls of FMI that a script makes, without the FMU: it ends the process that calls it."""
    kind = CalledModelExchange if fmu.is_model_exchange else CalledInstance
    options = {**script.options, "recorded": True}
    library: Any = _Silent()
    instance = kind(library, CountingAllocator(), ProcessSettings(), options, lambda _: None)
    instance.create()
    for method, *arguments in script.calls:
        is_function = method.startswith("fmi2")
        call = partial(instance.call_with_lists, method) if is_function else getattr(instance, method)
        call(*arguments)
    *recorded, _ = instance.free()
    return [Call(number, *call) for _, *call in recorded]


def copies_of(case: Case, kept: Kept, **options: Any) -> list[Script]:
    copies = list[Script]()
    for script, some in zip(case.scripts, kept, strict=True):
        made = Script(script.probe, {**script.options, **options})
        for method, *arguments in _calls(script, some):
            made.call(method, *arguments)
        made.parts = [sum(i < part for i in some) for part in script.parts]
        copies.append(made)
    return copies


def _calls(script: Script, kept: Sequence[int]) -> list[tuple[Any, ...]]:
    """Returns the calls that are kept; times follow from the steps that are left."""
    calls, chosen = list[tuple[Any, ...]](), {*kept}
    shift, saved = 0.0, dict[int, float]()
    for i, (method, *arguments) in enumerate(script.calls):
        if i in chosen:
            time = [round(arguments[0] + shift, _DIGITS)] if method in _TIMED else arguments[:1]
            calls.append((method, *time, *arguments[1:]))
        elif method == "do_step":
            shift -= arguments[1]
        elif method == "do_steps":
            shift -= arguments[1] * arguments[3]
        if method == "set_up_experiment":
            shift = 0.0
        if method == "save_state":
            saved[arguments[0]] = shift
        elif method == "copy_state":
            saved[arguments[1]] = saved.get(arguments[0], shift)
        elif method == "set_state":
            shift = saved.get(arguments[0], shift)
    return calls


def _play(probe: Probe, case: Case, scripts: Sequence[Script]) -> None:
    first, beside = scripts[: case.compared - 1], scripts[case.compared - 1 :]
    probe.play_each(first)
    probe.play(*sorted(beside, key=lambda script: bool(script.calls)), keep_going=True)


def is_legal(script: Script, calls: Sequence[tuple[Any, ...]]) -> bool:
    """Whether no value is read between a value that is set and the next step, as 4.2.4 has it."""
    is_stepping = is_set = False
    for method, *_ in calls if not script.probe.fmu.is_model_exchange else ():
        is_stepping = method == "exit_initialization_mode" or (is_stepping and method != "fmi2Reset")
        is_set = (is_set or method in SETTERS) and is_stepping and method not in STEPS
        if is_set and method in ("get", "output_derivatives"):
            return False
    return True


def _keeps_contexts(case: Case, scripts: Sequence[Script], kept: Kept) -> bool:
    """Whether the values that are compared depend on the same as one another, or as they did."""
    if not case.elements:
        return True
    before = [_context(case.scripts[number], i) for number, i in case.places]
    now = [_context(scripts[number], list(kept[number]).index(i)) for number, i in case.places]
    if len(now) == 2 and before[0] == before[1]:
        return now[0] == now[1]
    return now == before


def _context(script: Script, end: int) -> dict[Any, Any]:
    """Returns what a reading depends on: the time, and the values that were set last, by type and reference.

    end: index of the reading
    """
    context, saved = dict[Any, Any](), dict[int, dict[Any, Any]]()
    for method, *arguments in script.calls[:end]:
        match method, arguments:
            case ("do_step", [t, h, *_]):
                context["time"] = round(t + h, 9)
            case ("do_steps", [t, h, first, count, *_]):
                context["time"] = round(t + (first + count) * h, 9)
            case ("set_time" | "fmi2SetTime" | "set_up_experiment", [t, *_]):
                context["time"] = round(t, 9)
            case ("fmi2SetContinuousStates", [states, *_]):
                context["states"] = states
            case (_, [references, _, some]) if method in SETTERS:
                context |= {(method, r): x for r, x in zip(references, some, strict=True)}
            case ("fmi2Reset", _):
                context = {}
            case ("save_state", [slot]):
                saved[slot] = context.copy()
            case ("copy_state", [slot, other]):
                saved[other] = saved.get(slot, {})
            case ("set_state", [slot]):
                context = saved.get(slot, {}).copy()
            case _:
                pass
    return context
