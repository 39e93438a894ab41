"""Findings with what showed them: a call that fails, or two readings that differ."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from fmus.compliance.probe import Shared
from fmus.compliance.script import Message, Reading, Reply, Script
from fmus.compliance.traces.replay import CREATION, END, Case, Place
from fmus.compliance.values import Difference, same, texts


def case_of_reply(reply: Reply, plays: Sequence[Script]) -> Case:
    """Returns the case of a call with a wrong status, in one of the runs that were played side by side."""
    beside = [play for play in plays if play is not reply.script]
    return Case([reply.script, *beside], [(0, _index(reply.script, reply))], partial(_returns, reply))


def case_of_difference(
    found: Difference, tolerance: float, usual: Script, play: Script, plays: Sequence[Script]
) -> Case:
    """Returns the case of a value that differs from the usual run, or from another one of the same run."""
    scripts = [play, *(other for other in plays if other is not play)]
    seen, element = _place(play, found.got, found.name)
    if isinstance(found.expected, dict):
        differs = partial(_differ, tolerance, found.scale, found.expected[found.name])
        return Case(scripts, [(0, seen)], differs, [element])
    source = play if any(found.expected is mine for mine in play.expected) else usual
    expected, of_it = _place(source, found.expected, found.name)
    differs = partial(_differ, tolerance, found.scale)
    return Case([source, *scripts], [(0, expected), (1, seen)], differs, [of_it, element], compared=2)


def case_of_subject(shared: Shared, subject: Any, message: str) -> Case | None:
    """Returns the case of a message that is about one reply, or about what came with it, if it is known."""
    runs = shared.played.values()
    reply = getattr(subject, "reply", subject)
    if isinstance(subject, Message):
        heard = (r for run in runs for r in run.everything if any(m is subject for m in r.messages))
        reply = shared.log.get(subject) or next(heard, None)
    elif subject is None:
        reply = next((r for problem, r in shared.failed.items() if problem in message), None)
    if reply is None or reply.script is None:
        return next(_of_a_value(shared, message), None)
    script: Script = reply.script
    ends = {id(script.creation): CREATION, id(script.end): END}
    place = ends[id(reply)] if id(reply) in ends else _index(script, reply)
    return Case([script], [(0, place)], partial(_speaks, reply, subject))


def _of_a_value(shared: Shared, message: str) -> Iterator[Case]:
    """Yields the cases of a message that begins with a variable and a value, in the runs that read that."""
    name = message.split(" is ", 1)[0]
    for run in shared.played.values():
        for reading in run.readings:
            read: dict[str, Any] = reading.values if reading.ok else {}
            if name in read and message.startswith(f"{name} is {texts(read[name])[0]} "):
                place, element = _place(run, reading, name)
                yield Case([run], [(0, place)], partial(_is_value, read[name]), [element])


def _is_value(known: Any, seen: Sequence[Any]) -> bool:
    (value,) = seen
    return same(known, bytes.fromhex(value) if isinstance(known, bytes) and isinstance(value, str) else value)


def _speaks(known: Reply, subject: Any, replies: Sequence[Reply]) -> bool:
    """Whether a reply is as the known one in what a message is about."""
    (reply,) = replies
    if isinstance(subject, Message):
        return any(replace(m, given_name=subject.given_name) == subject for m in reply.messages)
    if subject is None or subject is known:
        is_silent = not reply.messages and not known.messages
        return _returns(known, replies) and (is_silent or bool(reply.messages and known.messages))
    return subject.setting in {setting for setting, *_ in reply.changed}


def _differ(tolerance: float, scale: float, *seen: Any) -> bool:
    *given, last = seen
    first, second = [*given, *last]
    return not same(first, second, tolerance, scale)


def _returns(known: Reply, replies: Sequence[Reply]) -> bool:
    (reply,) = replies
    return reply.status == known.status and reply.function == known.function


def _index(script: Script, reply: Reply) -> int:
    return next(i for i, other in enumerate(script.replies) if other is reply)


def _place(script: Script, reading: Reading, name: str) -> Place:
    """Returns the call that reads a variable, and the variable's element among its values."""
    for kind, variables in reading.groups.items():
        for element, variable in enumerate(variables):
            if variable.name == name:
                return _index(script, reading.replies[kind]), element
    raise LookupError(name)
