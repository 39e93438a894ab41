"""The text of messages, the messages of a refusal, and which categories fmi2SetDebugLogging disables."""

import re
from collections.abc import Iterator

from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.rules.instance import unknown_reference
from fmus.compliance.rules.log import calls_that_log, declared_categories, messages_of_a_session
from fmus.compliance.session import NAME
from fmus.fmi.binding import WARNING

_CREATION = "2.1.5 Creation, Destruction and Logging of FMU Instances"
_NUMBER = r"(?:\*(?:\d+\$)?|\d+)"  # a width or a precision, also as an argument
_CONVERSION = re.compile(  # of C, POSIX, glibc and Microsoft, without %n, which writes
    rf"%(?:\d+\$)?[-+ #0'I]*{_NUMBER}?(?:\.{_NUMBER}?)?(?:hh|h|ll|l|j|z|t|L|q|w|I32|I64)?"
    "[diouxXeEfFgGaAcCsSpm]"
)
_NAME_WITH_A_PERCENT_SIGN = "tank at 5%d"
_BLANK_OF_TEXT = re.compile(r"%[-+#0]* [-+#0 ]*[scp](?=[a-zA-Z])")  # as in "100 % sure"; C gives it no effect
_BLANK_FLAG = re.compile(r"%[-+#0]* [-+#0]*[a-zA-Z](?=[a-zA-Z])")  # as in "100 % done"


@behaviour_rule(_CREATION, needs="formats-of-messages-are-legal")
def messages_are_utf_8(probe: Probe) -> Iterator[str]:
    """Messages are UTF-8, as every string of FMI."""
    for text in dict.fromkeys(m.text for m in messages_of_a_session(probe) if "\ufffd" in m.text):
        yield f"a message is not UTF-8: {text[:80]!r}"
        return


@behaviour_rule("advice: a message is read for its text")
def messages_have_a_text(probe: Probe) -> Iterator[str]:
    """Messages have a text."""
    if any(not m.text.strip() for m in messages_of_a_session(probe)):
        yield "a message has no text"


@behaviour_rule(_CREATION)
def formats_of_messages_are_legal(probe: Probe) -> Iterator[str]:
    """A message is a format of printf: each % begins a conversion or is doubled, also one of the instance's
    name, and none writes (%n).
    """
    for text in _formats(probe):
        if _NAME_WITH_A_PERCENT_SIGN in text:
            shown = repr(_NAME_WITH_A_PERCENT_SIGN)
            yield f"the format {text[:80]!r} holds the instance name {shown}: expected its % doubled"
            return
        plain = text.replace("%%", "")
        if "%" in _CONVERSION.sub("", plain) or _BLANK_OF_TEXT.search(plain):
            yield f"the format {text[:80]!r} of a message has a single %: expected %% or a conversion"
            return


@behaviour_rule("advice: a % before a word is seldom a conversion")
def percent_signs_before_words_are_doubled(probe: Probe) -> Iterator[str]:
    """No format of a message has a conversion with a blank inside a word, as "100 % done" has."""
    for text in _formats(probe):
        plain = text.replace("%%", "").replace(_NAME_WITH_A_PERCENT_SIGN, "")
        if _BLANK_FLAG.search(_BLANK_OF_TEXT.sub("", plain)):
            yield f"the format {text[:80]!r} of a message has a single % before a word: expected %%"
            return


def _formats(probe: Probe) -> list[str]:
    """Returns the formats of messages, as they are before printf."""

    def collected() -> list[str]:
        script = probe.script(name=_NAME_WITH_A_PERCENT_SIGN, logging=True, callbacks="formats")
        calls_that_log(probe, script)
        script.call("get", "Real", [unknown_reference(probe)])
        script.play(keep_going=True)
        return list(dict.fromkeys(m.text for reply in script.everything for m in reply.messages))

    return probe.once("log of formats", collected)


@behaviour_rule(_CREATION)
def messages_of_a_refusal_are_complete(probe: Probe) -> Iterator[str]:
    """The message of a failed instantiation has the instance's name, its environment, and no status ok."""
    created, messages = probe.creates(name=NAME, guid="wrong", logging=True)
    if created or not messages:
        return
    if any(m.instance != NAME for m in messages):
        yield f"the message of a refused instantiation does not carry the instance name {NAME!r}"
    if any(not m.right_environment for m in messages):
        yield "the message of a refused instantiation comes without the componentEnvironment"
    if all(m.status == 0 for m in messages):
        yield "the messages of a refused instantiation have the status ok: expected error"


@behaviour_rule(_CREATION, needs="debug-logging-can-be-set")
def disabled_categories_alone_are_disabled(probe: Probe) -> Iterator[str]:
    """Messages of a category that is disabled do not arrive, and those of others do."""
    declared = declared_categories(probe)
    sent = _sent(probe, [(True, [])])
    for disabled in sorted(sent):
        if disabled in _sent(probe, [(True, []), (False, [disabled])]):
            yield f"a message of the category {disabled!r} arrives although it was disabled"
    for category in sorted(sent):
        others = [name for name in declared if name != category]
        if others and category not in _sent(probe, [(True, []), (False, others[:1])]):
            yield f"no message of {category!r} arrives after {others[0]!r} alone was disabled"
        if others and category not in _sent(probe, [(True, [*others, category])]):
            yield f"no message of {category!r} arrives although it is enabled, after others in one call"


def _sent(probe: Probe, settings: list[tuple[bool, list[str]]]) -> set[str]:
    """Returns declared categories of the messages in a run after these calls of fmi2SetDebugLogging."""
    script = probe.script()
    for on, categories in settings:
        script.call("set_debug_logging", on, categories)
    first = len(script.replies)
    calls_that_log(probe, script)
    script.play(keep_going=True)
    if not script.succeeded:
        raise NotJudgedError("a run fails")
    messages = [m for reply in script.replies[first:] for m in reply.messages if m.status <= WARNING]
    return {m.category for m in messages if m.category} & set(declared_categories(probe))


@behaviour_rule(
    "4.2.4 State Machine of Calling Sequence from Master to Slave",
    needs="allowed-calls-succeed",
)
def debug_logging_is_allowed_after_an_error(probe: Probe) -> Iterator[str]:
    """fmi2SetDebugLogging succeeds after another function returned error."""
    script = probe.script(logging=True).begin().step()
    script.call("get", "Real", [unknown_reference(probe)])
    reply = script.call("set_debug_logging", True, [])
    script.play(keep_going=True)
    if reply.status is not None and not reply.ok:
        yield f"after an error: {reply.problem}"
