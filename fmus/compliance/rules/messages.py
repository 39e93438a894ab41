"""Messages, which an FMU sends to the logger, and settings of its process, which it leaves as they are."""

import re
from collections.abc import Iterator, Sequence

from fmus.compliance import actions as do
from fmus.compliance.differential import Row, differential
from fmus.compliance.fmu_file import ONLY_ONCE
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.rules.call_table import NAME, tour
from fmus.compliance.script import ARGUMENTS, UNWRITTEN, CallError, Message, Script
from fmus.compliance.values import refused_reference
from fmus.fmi.binding import OK, WARNING

_CREATION = "2.1.5 Creation, Destruction and Logging of FMU Instances"
_REFERENCE = re.compile(r"#([ribs])(\d+)#")
_ALL = "logAll"  # of 2.2.4: all messages, whatever their category
_KINDS = {"r": "Real", "i": "Integer", "b": "Boolean", "s": "String"}
_NUMBER = r"(?:\*(?:\d+\$)?|\d+)"  # a width or a precision, also as an argument
_CONVERSION = re.compile(  # of C, POSIX, glibc and Microsoft, without %n, which writes
    rf"%(?:\d+\$)?[-+ #0'I]*{_NUMBER}?(?:\.{_NUMBER}?)?(?:hh|h|ll|l|j|z|t|L|q|w|I32|I64)?"
    "[diouxXeEfFgGaAcCsSpm]"
)
_NAME_WITH_A_PERCENT_SIGN = "tank at 5%d"
_BLANK_OF_TEXT = re.compile(r"%[-+#0]* [-+#0 ]*[scp](?=[a-zA-Z])")  # as in "100 % sure"; C gives it no effect
_BLANK_FLAG = re.compile(r"%[-+#0]* [-+#0]*[a-zA-Z](?=[a-zA-Z])")  # as in "100 % done"
_GENERAL = "2.1 FMI Application Programming Interface"
_FLOATING_POINT = "floating-point control"


def _messages(probe: Probe) -> list[Message]:
    """Returns the messages of the tour of the states, and of a call that fails."""

    def collected() -> list[Message]:
        script = probe.script(name=NAME, logging=True).begin().step()
        script.call("get", "Real", [refused_reference(probe)])
        script.play(keep_going=True)
        return [m for reply in (*tour(probe).everything, *script.everything) for m in reply.messages]

    return probe.once("log", collected)


def _declared_categories(probe: Probe) -> list[str]:
    return [c.get("name", "") for c in probe.fmu.root.iterfind("LogCategories/Category")]


@behaviour_rule(_CREATION)
def messages_have_the_instance_name(probe: Probe) -> Iterator[str]:
    """Messages carry the name of the instance that sends them, and the environment of its callbacks."""
    messages = _messages(probe)
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
        script.call("get", "Real", [refused_reference(probe)])
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
    yield from _undeclared(probe, _messages(probe))


@behaviour_rule(_CREATION)
def messages_have_a_category(probe: Probe) -> Iterator[str]:
    """Messages have a category, if LogCategories declares any."""
    declared = _declared_categories(probe)
    if declared and any(m.category is None for m in _messages(probe)):
        yield f"a message has no category: expected one of {', '.join(declared)}"


@behaviour_rule(_CREATION)
def log_category_of_a_refusal_is_declared(probe: Probe) -> Iterator[str]:
    """The message of an instantiation that fails, too, has a category of LogCategories."""
    created, messages = probe.creates(name=NAME, guid="wrong", logging=True)
    yield from () if created else _undeclared(probe, messages)


def _undeclared(probe: Probe, messages: Sequence[Message]) -> Iterator[str]:
    declared = _declared_categories(probe)
    for category in dict.fromkeys(m.category for m in messages):
        if category is not None and category not in declared:
            expected = (
                f"one of {', '.join(declared)}" if declared else "NULL, as no LogCategories are declared"
            )
            yield f"a message has the category {category!r}: expected {expected}"


@behaviour_rule(_CREATION)
def messages_have_no_trailing_line_break(probe: Probe) -> Iterator[str]:
    """Messages do not end with a line break."""
    for text in dict.fromkeys(m.text for m in _messages(probe) if m.text.endswith(("\n", "\r"))):
        yield f"a message ends with a line break: {text.strip()[:80]!r}"
        return


@behaviour_rule(_CREATION)
def variables_in_messages_exist(probe: Probe) -> Iterator[str]:
    """In messages `#r12#` is a variable with that type and value reference, and `##` stands for `#`."""
    known = {(v.base_kind, v.reference) for v in probe.fmu.variables}
    for text in dict.fromkeys(m.text for m in _messages(probe) if "#" in m.text):
        rest = text.replace("##", "")
        for letter, digits in _REFERENCE.findall(rest):
            if (_KINDS[letter], int(digits)) not in known:
                yield f"a message refers to #{letter}{digits}#, which is no variable: {text[:80]!r}"
        if "#" in _REFERENCE.sub("", rest):
            yield f"a message has a single #: expected ## or the reference of a variable: {text[:80]!r}"


@behaviour_rule(_CREATION)
def status_of_messages_is_legal(probe: Probe) -> Iterator[str]:
    """Messages carry an fmi2Status."""
    for status in {m.status for m in _messages(probe)}:
        if not 0 <= status <= 5:
            yield f"a message has the status {status}: expected an fmi2Status"


@behaviour_rule(_CREATION, needs="formats-of-messages-are-legal")
def messages_are_utf_8(probe: Probe) -> Iterator[str]:
    """Messages are UTF-8, as every string of FMI."""
    for text in dict.fromkeys(m.text for m in _messages(probe) if "\ufffd" in m.text):
        yield f"a message is not UTF-8: {text[:80]!r}"
        return


@behaviour_rule("advice: a message is read for its text")
def messages_have_a_text(probe: Probe) -> Iterator[str]:
    """Messages have a text."""
    if any(not m.text.strip() for m in _messages(probe)):
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
        _calls_that_log(probe, script)
        script.call("get", "Real", [refused_reference(probe)])
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


@differential(_CREATION, needs="allowed-calls-succeed statuses-are-legal")
def debug_logging_can_be_set(probe: Probe) -> Iterator[Row]:
    """fmi2SetDebugLogging accepts each declared category, and none at all, on and off; outputs stay the
    same.
    """
    choices = [*([category] for category in _declared_categories(probe)), []]
    calls = [do.call("set_debug_logging", on, choice) for on in (True, False) for choice in choices]
    yield Row("after fmi2SetDebugLogging", (*calls, do.begin, do.run(2)), failing="")


def _calls_that_log(probe: Probe, script: Script) -> None:
    """Calls at which FMUs send messages."""
    script.begin().step(2)
    script.read(probe.fmu.variables)
    script.terminate()


def _sent(probe: Probe, *settings: tuple[bool, list[str]]) -> set[str]:
    """Returns declared categories of the messages in a run after these calls of fmi2SetDebugLogging."""
    script = probe.script()
    for on, categories in settings:
        script.call("set_debug_logging", on, categories)
    first = len(script.replies)
    _calls_that_log(probe, script)
    script.play(keep_going=True)
    if not script.succeeded:
        raise NotJudgedError("a run fails")
    messages = [m for reply in script.replies[first:] for m in reply.messages if m.status <= WARNING]
    return {m.category for m in messages if m.category} & set(_declared_categories(probe))


@behaviour_rule(_CREATION, needs="debug-logging-can-be-set")
def only_chosen_categories_are_logged(probe: Probe) -> Iterator[str]:
    """After fmi2SetDebugLogging with one category, but logAll (2.2.4), messages of others do not arrive."""
    declared = _declared_categories(probe)
    if len(declared) < 2:
        raise NotApplicableError("fewer than two log categories are declared")
    for chosen in [name for name in declared if name != _ALL]:
        for other in sorted(_sent(probe, (True, [chosen])) - {chosen}):
            yield f"a message of the category {other!r} arrives although {chosen!r} alone is enabled"
            return


@behaviour_rule(_CREATION, needs="debug-logging-can-be-set")
def chosen_categories_are_logged(probe: Probe) -> Iterator[str]:
    """Messages that arrive with all categories enabled arrive with their own alone, and if all are named."""
    for category in sorted(_sent(probe, (True, []))):
        if category not in _sent(probe, (True, [category])):
            yield (
                f"no message of the category {category!r} arrives although it is enabled: expected "
                "those of before"
            )


@behaviour_rule(_CREATION, needs="debug-logging-can-be-set")
def disabled_categories_alone_are_disabled(probe: Probe) -> Iterator[str]:
    """Messages of a category that is disabled do not arrive, and those of others do."""
    sent = sorted(_sent(probe, (True, [])))
    for disabled in sent:
        if disabled in _sent(probe, (True, []), (False, [disabled])):
            yield f"a message of the category {disabled!r} arrives although it was disabled"
    for category in sent:
        others = [name for name in _declared_categories(probe) if name not in (category, _ALL)]
        if others and category not in _sent(probe, (True, []), (False, others[:1])):
            yield f"no message of {category!r} arrives after {others[0]!r} alone was disabled"
        if others and category not in _sent(probe, (True, [*others, category])):
            yield f"no message of {category!r} arrives although it is enabled, after others in one call"


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


@behaviour_rule(
    "4.2.4 State Machine of Calling Sequence from Master to Slave",
    needs="allowed-calls-succeed",
)
def debug_logging_is_allowed_after_an_error(probe: Probe) -> Iterator[str]:
    """fmi2SetDebugLogging succeeds after another function returned error."""
    script = probe.script(logging=True).begin().step()
    script.call("get", "Real", [refused_reference(probe)])
    reply = script.call("set_debug_logging", True, [])
    script.play(keep_going=True)
    if reply.status is not None and not reply.ok:
        yield f"after an error: {reply.problem}"


# settings of the process


@behaviour_rule(_GENERAL)
def floating_point_control_is_restored(probe: Probe) -> Iterator[str]:
    """Rounding mode, traps and flushing to zero are as before when a function returns or calls back."""
    named = set()
    for reply in tour(probe).everything:
        for setting, before, after in reply.changed:
            if setting.startswith(_FLOATING_POINT) and reply.function not in named:
                named.add(reply.function)
                where = setting.removeprefix(_FLOATING_POINT)
                values = f" ({before} before, {after} after)" if before else ""
                yield (
                    f"{reply.function} changes the floating-point control{where}{values}: expected "
                    "it restored"
                )


@behaviour_rule(_GENERAL)
def process_settings_are_restored(probe: Probe) -> Iterator[str]:
    """Working directory, locale, file mode mask, signal handlers and mask, environment, standard streams,
    timers, limits and priority are not changed.
    """
    named = set()
    for reply in tour(probe).everything:
        for setting, before, after in reply.changed:
            if not setting.startswith((_FLOATING_POINT, ARGUMENTS, UNWRITTEN)) and setting not in named:
                named.add(setting)
                got, expected = after or "as at first", before or "no change"
                yield f"{reply.function} changes the {setting}: {got}, expected {expected}"


@behaviour_rule("2.1.7 Getting and Setting Variable Values")
def arguments_are_not_written(probe: Probe) -> Iterator[str]:
    """Arrays that are constant by their declaration, value references and values to set, stay as they are,
    and so does what lies behind an array of values that are read.
    """
    everything = tour(probe).everything
    for name in dict.fromkeys(r.function for r in everything for row in r.changed if row[0] == ARGUMENTS):
        yield f"{name} writes into an array that is constant, or behind one: expected that unchanged"


@behaviour_rule("2.1.7 Getting and Setting Variable Values")
def values_are_written(probe: Probe) -> Iterator[str]:
    """fmi2GetXXX that returns ok has written each value."""
    everything = tour(probe).everything
    for name in dict.fromkeys(r.function for r in everything for row in r.changed if row[0] == UNWRITTEN):
        yield f"{name} returned ok and left a value unwritten: expected each written"


@behaviour_rule("advice: messages belong to the logger")
def nothing_is_printed(probe: Probe) -> Iterator[str]:
    """Nothing is printed to standard output or standard error."""
    printing = {reply.function: reply.printed for reply in tour(probe).everything if reply.printed}
    for function, count in printing.items():
        yield f"{function} prints {count} bytes to standard output or standard error: expected none"
        return
