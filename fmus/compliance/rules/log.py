"""Messages: when the logger is called, with which instance, category and text."""

import re
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import takewhile

from fmus.compliance.comparison import failing_or_differing
from fmus.compliance.fmu_file import ONLY_ONCE
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, behaviour_rule
from fmus.compliance.rules.instance import unknown_reference
from fmus.compliance.script import CallError, Message, Script
from fmus.compliance.session import NAME, session
from fmus.fmi.binding import OK, WARNING

_CREATION = "2.1.5 Creation, Destruction and Logging of FMU Instances"
_REFERENCE = re.compile(r"#([ribs])(\d+)#")
_KINDS = {"r": "Real", "i": "Integer", "b": "Boolean", "s": "String"}


def messages_of_a_session(probe: Probe) -> list[Message]:
    """Returns the messages of the session, up to its reset, and of a call that fails."""

    def collected() -> list[Message]:
        script = probe.script(name=NAME, logging=True).begin().step()
        script.call("get", "Real", [unknown_reference(probe)])
        script.play(keep_going=True)
        before = takewhile(lambda reply: reply.function != "fmi2Reset", session(probe).script.everything)
        return [m for reply in (*before, *script.everything) for m in reply.messages]

    return probe.once("log", collected)


def declared_categories(probe: Probe) -> list[str]:
    return [c.get("name", "") for c in probe.fmu.root.iterfind("LogCategories/Category")]


@behaviour_rule(_CREATION)
def messages_have_the_instance_name(probe: Probe) -> Iterator[str]:
    """Messages carry the name of the instance that sends them, and the environment of its callbacks."""
    messages = messages_of_a_session(probe)
    for name in {m.instance for m in messages if m.instance != NAME}:
        shown = "NULL" if name is None else repr(name)
        yield f"a message carries the instance name {shown}: expected {NAME!r}, its instance"
    if any(not m.right_environment for m in messages):
        yield "the logger was called without the componentEnvironment of its instance"
    elif all(m.instance == NAME for m in messages) and not probe.fmu.claims(ONLY_ONCE):
        yield from _of_another(probe)


def _of_another(probe: Probe) -> Iterator[str]:
    """Yields a message that carries the name of another instance, of two that live side by side."""
    first, second = (probe.script(name=f"instance {i} of two", logging=True).forbidden() for i in (1, 2))
    for script in (first, second):
        script.begin().step().pause()
        script.call("get", "Real", [unknown_reference(probe)])
    try:
        probe.play(first, second, keep_going=True)
    except CallError:  # no second instance: `several-instances` tells it
        return
    for script in (first, second):
        name = script.options["name"]
        for message in [m for reply in script.replies for m in reply.messages]:
            if message.instance != name:
                yield (
                    f"a message to the environment of {name!r} carries the instance name "
                    f"{message.instance!r} beside another instance: expected its own"
                )
                return


@behaviour_rule(_CREATION)
def log_categories_are_declared(probe: Probe) -> Iterator[str]:
    """Messages have a category of LogCategories; without LogCategories it is NULL."""
    yield from _undeclared(probe, messages_of_a_session(probe))


@behaviour_rule(_CREATION)
def messages_have_a_category(probe: Probe) -> Iterator[str]:
    """Messages have a category, if LogCategories declares any."""
    declared = declared_categories(probe)
    if declared and any(m.category is None for m in messages_of_a_session(probe)):
        yield f"a message has no category: expected one of {', '.join(declared)}"


@behaviour_rule(_CREATION)
def log_category_of_a_refusal_is_declared(probe: Probe) -> Iterator[str]:
    """The message of an instantiation that fails, too, has a category of LogCategories."""
    created, messages = probe.creates(name=NAME, guid="wrong", logging=True)
    yield from () if created else _undeclared(probe, messages)


def _undeclared(probe: Probe, messages: Sequence[Message]) -> Iterator[str]:
    declared = declared_categories(probe)
    for category in dict.fromkeys(m.category for m in messages):
        if category is not None and category not in declared:
            expected = (
                f"one of {', '.join(declared)}" if declared else "NULL, as no LogCategories are declared"
            )
            yield f"a message has the category {category!r}: expected {expected}"


@behaviour_rule(_CREATION)
def messages_have_no_trailing_line_break(probe: Probe) -> Iterator[str]:
    """Messages do not end with a line break."""
    for text in dict.fromkeys(m.text for m in messages_of_a_session(probe) if m.text.endswith(("\n", "\r"))):
        yield f"a message ends with a line break: {text.strip()[:80]!r}"
        return


@behaviour_rule(_CREATION)
def variables_in_messages_exist(probe: Probe) -> Iterator[str]:
    """In messages `#r12#` is a variable with that type and value reference, and `##` stands for `#`."""
    known = {(v.base_kind, v.reference) for v in probe.fmu.variables}
    for text in dict.fromkeys(m.text for m in messages_of_a_session(probe) if "#" in m.text):
        rest = text.replace("##", "")
        for letter, digits in _REFERENCE.findall(rest):
            if (_KINDS[letter], int(digits)) not in known:
                yield f"a message refers to #{letter}{digits}#, which is no variable: {text[:80]!r}"
        if "#" in _REFERENCE.sub("", rest):
            yield f"a message has a single #: expected ## or the reference of a variable: {text[:80]!r}"


@behaviour_rule(_CREATION)
def status_of_messages_is_legal(probe: Probe) -> Iterator[str]:
    """Messages carry an fmi2Status."""
    for status in {m.status for m in messages_of_a_session(probe)}:
        if not 0 <= status <= 5:
            yield f"a message has the status {status}: expected an fmi2Status"


@cache
def _unwanted(category: str | None) -> str:
    return f"of the category {category!r}" if category else "without category"


@behaviour_rule(_CREATION)
def no_messages_with_logging_off(probe: Probe) -> Iterator[str]:
    """With loggingOn = fmi2False, and after fmi2SetDebugLogging with it, no messages with the status ok
    arrive from calls that return ok, also after fmi2Reset.
    """
    created_off = probe.script().begin().step(2)
    created_off.reset()
    created_off.begin().step()
    turned_off = probe.script(logging=True)
    off = turned_off.call("set_debug_logging", False, [])
    turned_off.begin().step(2)
    probe.play_each([created_off, turned_off])
    for script, when in ((created_off, "at fmi2Instantiate"), (turned_off, "by fmi2SetDebugLogging")):
        replies = script.replies[script.replies.index(off) + 1 :] if script is turned_off else script.replies
        texts = [m.text for reply in replies for m in reply.messages if reply.status == m.status == OK]
        if texts:
            yield f"a message arrives although logging is off {when}: {texts[0][:80]!r}"


@behaviour_rule(_CREATION, needs="allowed-calls-succeed statuses-are-legal")
def debug_logging_can_be_set(probe: Probe) -> Iterator[str]:
    """fmi2SetDebugLogging accepts each declared category, and none at all, on and off; outputs stay the
    same.
    """
    usual, script = probe.script().begin(), probe.script(logging=True)
    expected = usual.run(2)
    for on in (True, False):
        for category in declared_categories(probe):
            script.call("set_debug_logging", on, [category])
        script.call("set_debug_logging", on, [])
    got = script.begin().run(2)
    usual.play()
    script.play(keep_going=True)
    yield from failing_or_differing(script, expected, got, "after fmi2SetDebugLogging", failing="")


@behaviour_rule(_CREATION, needs="debug-logging-can-be-set")
def only_chosen_categories_are_logged(probe: Probe) -> Iterator[str]:
    """After fmi2SetDebugLogging with one category, messages of others do not arrive."""
    declared = declared_categories(probe)
    if len(declared) < 2:
        raise NotApplicableError("fewer than two log categories are declared")
    for chosen in declared:
        script = probe.script()
        script.call("set_debug_logging", True, [chosen])
        first = len(script.replies)
        calls_that_log(probe, script)
        script.play(keep_going=True)
        others = {
            m.category
            for reply in script.replies[first:]
            for m in reply.messages
            if m.status <= WARNING and m.category != chosen and m.category in declared
        }
        for category in sorted(map(str, others)):
            yield f"a message {_unwanted(category)} arrives although {chosen!r} alone is enabled"
            return


@behaviour_rule(_CREATION, needs="debug-logging-can-be-set")
def chosen_categories_are_logged(probe: Probe) -> Iterator[str]:
    """Messages that arrive with all categories enabled arrive with their own alone, and if all are named."""
    usual = probe.script(logging=True)
    usual.call("set_debug_logging", True, [])
    calls_that_log(probe, usual)
    usual.play(keep_going=True)
    before = {
        m.category for reply in usual.replies for m in reply.messages if m.status <= WARNING and m.category
    }
    for category in sorted(before & set(declared_categories(probe))):
        script = probe.script()
        script.call("set_debug_logging", True, [category])
        calls_that_log(probe, script)
        script.play(keep_going=True)
        if not any(m.category == category for reply in script.replies for m in reply.messages):
            yield (
                f"no message of the category {category!r} arrives although it is enabled: expected "
                "those of before"
            )


def calls_that_log(probe: Probe, script: Script) -> None:
    """Calls at which FMUs send messages."""
    script.begin().step(2)
    script.read(probe.fmu.variables)
    script.terminate()


@behaviour_rule("advice: an unknown log category is no reason to fail", needs="reset-in-every-state")
def reset_works_after_unknown_categories(probe: Probe) -> Iterator[str]:
    """After fmi2SetDebugLogging with a category that is not declared, which may be refused, fmi2Reset
    works.
    """
    script = probe.script(logging=True).forbidden()
    script.call("set_debug_logging", True, ["no category of this FMU"])
    script.reset()
    script.begin().step().play(keep_going=True)
    failure = next((reply for reply in script.replies[1:] if not reply.ok), None)
    if failure:
        yield failure.problem
