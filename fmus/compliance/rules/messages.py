"""Messages, which an FMU sends to the logger, statuses of its functions, and settings of its process."""

import re
from collections.abc import Iterator, Sequence, Set
from contextlib import suppress
from itertools import product
from typing import Any, NamedTuple

from fmus.compliance import actions as do
from fmus.compliance import rule, values
from fmus.compliance.differential import Row, differential, late_lead
from fmus.compliance.fmu_file import ONLY_ONCE
from fmus.compliance.probe import Probe
from fmus.compliance.rows import add_rows, row
from fmus.compliance.rules.lifecycle import MANY_STEPS
from fmus.compliance.script import SETTERS, Action, CallError, Message, Reply, Script
from fmus.compliance.texts import ARGUMENTS, PENDED, UNWRITTEN
from fmus.compliance.traces import generator, paths
from fmus.compliance.traces.table import NAME, tour
from fmus.fmi import binding
from fmus.fmi.binding import DISCARD, ERROR, OK, PENDING, WARNING, status_name

_REFERENCE = re.compile(r"#([ribs])(\d+)#")
_KINDS = {"r": "Real", "i": "Integer", "b": "Boolean", "s": "String"}
_ALL = "logAll"  # of 2.2.4: all messages, whatever their category
_NUMBER = r"(?:\*(?:\d+\$)?|\d+)"  # a width or a precision, also as an argument
_CONVERSION = re.compile(  # of C, POSIX, glibc and Microsoft, without %n, which writes
    rf"%(?:\d+\$)?[-+ #0'I]*{_NUMBER}?(?:\.{_NUMBER}?)?(?:hh|h|ll|l|j|z|t|L|q|w|I32|I64)?"
    "[diouxXeEfFgGaAcCsSpm]"
)
_NAME_WITH_A_PERCENT_SIGN = "tank at 5%d"
# as in "100 % sure" or "5% of"; C gives the blank no effect
_BLANK_OF_TEXT = re.compile(r"%[-+#0]* [-+#0 ]*[scpouxX](?=[a-zA-Z])")
_CALLS_THAT_LOG = do.begin, do.step(2), do.glance_all, do.terminate
_OF_STATES = "fmi2SetContinuousStates", "fmi2GetDerivatives", "fmi2GetEventIndicators", "fmi2GetReal"


def _log(probe: Probe) -> list[Message]:
    """Returns the messages of all runs with logging that other rules have played."""
    return list(probe.shared.log)


def _refusal(probe: Probe) -> list[Message]:
    """Returns the messages with a text of an instantiation that fails, or one without."""

    def refused() -> list[Message]:
        told = list[Message]()
        is_single = len(probe.fmu.interfaces) == 1
        other = binding.CO_SIMULATION if probe.fmu.is_model_exchange else binding.MODEL_EXCHANGE
        ways: list[tuple[str, dict[str, Any]]] = [
            ("", {"guid": "wrong", "logging": True}),
            (" with loggingOn = fmi2False", {"guid": "wrong", "logging": False}),
            *([(f" with fmuType {other}", {"interface": other, "logging": True})] * is_single),
        ]
        for words, options in ways:
            created, messages = probe.creates(name=NAME, **options)
            if created and not told:
                raise rule.NotJudgedError("fmi2Instantiate returns an instance for a wrong GUID")
            silent = Message(ERROR, "", NAME, None, given_name=words)
            told += [] if created else [m for m in messages if m.text.strip()] or [silent]
        return told

    return probe.once("refused instantiation", refused)


def _formats(probe: Probe) -> list[Message]:
    """Returns messages with the formats that they are before printf."""

    def collected() -> list[Message]:
        wrong = do.call("get", "Real", [do.refused_reference(probe)])
        options = {"name": _NAME_WITH_A_PERCENT_SIGN, "callbacks": "formats"}
        calls = do.begin, do.step(MANY_STEPS), do.glance_all, do.terminate, wrong
        scripts = [do.played(probe, calls, logging=True, **options)]
        # the default experiment may have too few steps
        with suppress(rule.NotApplicableError):
            scripts.append(do.played(probe, (do.begin, do.leap(3)), logging=True, **options))
        return [m for script in scripts for reply in script.everything for m in reply.messages]

    return probe.once("log of formats", collected)


def _undeclared(message: Message, probe: Probe) -> str:
    declared = probe.fmu.log_categories
    if message.category in (None, *declared):
        return ""
    return f"one of {', '.join(declared)}" if declared else "NULL, as no LogCategories are declared"


def _unknown_variable(message: Message, probe: Probe) -> str:
    found = _REFERENCE.findall(message.text.replace("##", ""))
    # the FMU may name a wrong reference that it was asked for
    asked = values.unknown_reference(probe.fmu) if found else 0
    return next(
        (f"#{k}{x}#" for k, x in found if int(x) != asked and (_KINDS[k], int(x)) not in probe.fmu.aliases),
        "",
    )


def _has_a_single_percent_sign(message: Message, _: Probe) -> bool:
    text = message.text.replace("%%", "")
    return "%" in _CONVERSION.sub("", text) or _BLANK_OF_TEXT.search(text) is not None


class _Change(NamedTuple):
    """Change of a setting that a function makes."""

    function: str
    setting: str
    before: str
    after: str
    reply: Reply


def _is_of_floating_point(change: _Change, _: Probe) -> str:
    if not change.setting.startswith("floating-point control"):
        return ""
    values = f" ({change.before} before, {change.after} after)" if change.before else ""
    return f"{change.setting}{values}"


def _changes(probe: Probe) -> Iterator[_Change]:
    """Yields what functions change in the tour of the states, in runs with other inputs, where the status
    of a step is asked for, and in the default experiment.
    """
    scripts = [tour(probe).script, *generator.played(probe)]
    if not probe.fmu.is_model_exchange and probe.fmu.fmi == 2:
        pending = do.call("status_of", "String", binding.PENDING_STATUS)
        scripts.append(do.played(probe, [do.begin, do.step(), pending], watched=True))
    with suppress(rule.NotApplicableError, rule.NotJudgedError):
        scripts.append(do.over_the_experiment(probe))
    told = set[tuple[str, str, str]]()
    for reply in (reply for script in scripts for reply in script.everything):
        for setting, before, after in reply.changed:
            # a step is many calls, and its reply names the last one, which is not the cause
            if reply.is_step and (setting, before, after) in told:
                continue
            told.add((setting, before, after))
            function = before if setting in (ARGUMENTS, UNWRITTEN) else reply.function
            yield _Change(function, setting, before, after, reply)


def _set_odd_parameters(probe: Probe) -> None:
    """Sets Real parameters to 0 and to another sign, within their limits, which the FMU may refuse, and a
    fixed one of each type at a communication point, which it does.
    """
    settable = probe.fmu.settable_before
    parameters = [v for v in settable if values.keeps_its_value(v) and v.kind == "Real"]
    starts = values.start_values(parameters[: do.MOST_VARIABLES])
    pairs = [(v, x) for v, start in starts for x in (0.0, -start) if x != start and v.low <= x <= v.high]
    ways = [(do.set_values([pair]),) for pair in pairs]
    fixed = [v for v in probe.fmu.variables if (v.causality, v.variability) == ("parameter", "fixed")]
    late = {p[0].base_kind: (do.begin, do.step(), do.set_values([p])) for p in values.start_values(fixed)}
    probe.play_once([probe.script(*way, logging=True) for way in (*ways, *late.values())])


def _refused(probe: Probe) -> list[Reply]:
    """Returns replies with logging that are warning, discard or error."""
    _set_odd_parameters(probe)
    replies = [*probe.shared.refusals.values(), *tour(probe).script.replies, *tour(probe).failed]
    refused = [reply for reply in replies if reply.status not in (None, OK, PENDING)]
    return [reply for reply in refused if not reply.reason]


def _illegal(reply: Reply, probe: Probe) -> str:
    """Returns what is wrong with a status, which is noted for all rules."""
    may_discard = (*SETTERS, "fmi2DoStep", *(_OF_STATES if probe.fmu.is_model_exchange else ()))
    is_discard = reply.status == DISCARD and not reply.function.endswith("Status")
    is_wrong = is_discard and reply.function not in may_discard
    is_wrong |= reply.status == PENDING and reply.function not in ("fmi2DoStep", "fmi2GetStatus")
    if reply.status is None or reply.reason or (OK <= reply.status <= PENDING and not is_wrong):
        return ""
    probe.shared.failing[reply.function, reply.state] = "statuses-are-legal"
    legal = f": expected an fmi2Status, 0 to {PENDING}"
    return f", which it may not: {reply.logged}" if is_wrong else legal


_WRONG_STATUS = (_illegal, "{function} {status_name}{value}")
add_rows(__name__, rule.Stage.BEHAVIOUR, rows=(
    row("formats-of-messages-are-legal", _formats,
     (lambda m, _: _NAME_WITH_A_PERCENT_SIGN in m.text,
      f"the format {{text!r:.80}} holds the name {_NAME_WITH_A_PERCENT_SIGN!r}: expected its % doubled"),
     (_has_a_single_percent_sign,
      "the format {text!r:.80} of a message has a single %: expected %% or a conversion")),
    row("messages-of-a-refusal-are-complete", _refusal,
     (lambda m, _: not m.text,
      "fmi2Instantiate{given_name} returned NULL and logged nothing: expected the reason"),
     (lambda m, _: m.instance != NAME,
      f"the message of a refused instantiation carries the name {{instance!r}}: expected {NAME!r}"),
     (lambda m, _: not m.right_environment,
      "the message of a refused instantiation comes without the componentEnvironment"),
     (lambda _, probe: all(m.status == OK for m in _refusal(probe)),
      "the messages of a refused instantiation have the status ok: expected error")),
    row("floating-point-control-is-restored", _changes,
     (_is_of_floating_point, "{function} changes the {value}: expected it restored")),
    row("process-settings-are-restored", _changes,
     (lambda c, probe: not _is_of_floating_point(c, probe)
      and c.setting not in (ARGUMENTS, UNWRITTEN, PENDED)
      and (c.after or "as at first", c.before or "no change"),
      "{function} changes the {setting}: {value[0]}, expected {value[1]}")),
    row("arguments-are-not-written", _changes,
     (lambda c, _: c.setting == ARGUMENTS,
      "{function} writes into an array that is constant, or behind one: expected that unchanged")),
    row("values-are-written", _changes, (lambda c, _: c.setting == UNWRITTEN and (c.after or "a value"),
      "{function} returned ok and left {value} unwritten, or wrote no Boolean: expected each written")),
    row("statuses-are-legal", lambda probe: tour(probe).script.replies, _WRONG_STATUS),
))  # fmt: skip
add_rows(__name__, rule.Stage.BEHAVIOUR, last=True, rows=(
    row("messages-have-the-instance-name", _log,
     (lambda m, _: not m.right_environment,
      "the logger was called without the componentEnvironment of its instance"),
     (lambda m, _: m.instance != m.given_name and ("NULL" if m.instance is None else repr(m.instance)),
      "a message carries the instance name {value}: expected {given_name!r}, its instance")),
    row("log-categories-are-declared", _log,
     (_undeclared, "a message has the category {category!r}: expected {value}")),
    row("messages-have-a-category", _log,
     (lambda m, probe: m.category is None and ", ".join(probe.fmu.log_categories),
      "a message has no category: expected one of {value}")),
    row("variables-in-messages-exist", _log,
     (_unknown_variable, "a message refers to {value}, which is no variable: {text!r:.80}"),
     (lambda m, _: "#" in _REFERENCE.sub("", m.text.replace("##", "")),
      "a message has a single #: expected ## or the reference of a variable: {text!r:.80}")),
    row("status-of-messages-is-legal", _log, (lambda m, _: not OK <= m.status <= PENDING,
      "a message has the status {status}: expected an fmi2Status")),
    row("messages-are-utf-8", _log,
     (lambda m, _: "\ufffd" in m.text, "a message is not UTF-8: {text!r:.80}")),
    row("refusals-have-legal-statuses", lambda probe: list(probe.shared.refusals.values()), _WRONG_STATUS),
    row("refusals-are-logged", _refused,
     # fmi2SetDebugLogging may have turned logging off
     (lambda reply, _: not reply.messages and reply.function != "fmi2SetDebugLogging",
      "{function}{words} {status_name} and logged nothing: expected the reason")),
    row("messages-of-refusals-are-no-information", _refused,
     (lambda r, _: r.messages and all(m.status == OK for m in r.messages) and status_name(r.status or OK),
      "{function} {status_name} and logged {subject.logged!r:.60} with the status ok: expected {value}")),
))  # fmt: skip


# logging that is turned on and off


class _Run(NamedTuple):
    """Run with logging.

    when: words; enabled: categories whose messages may arrive; sent: category -> text of a message that did
    """

    when: str
    enabled: Set[str | None]
    sent: dict[str | None, str]


def _runs_with_logging(probe: Probe) -> list[_Run]:
    """Returns runs with settings of logging in which no call fails, the first with all categories."""
    return probe.once("runs with logging", lambda: list(_played_with_logging(probe)))


def _played_with_logging(probe: Probe) -> Iterator[_Run]:
    declared = probe.fmu.log_categories
    names, everything = [name for name in declared if name != _ALL], {None, *declared}
    on, off = (do.set_debug_logging(is_on) for is_on in (True, False))
    all_names = do.set_debug_logging(True, *names[::-1])
    another = "where fmi2SetDebugLogging of another instance turned logging"
    late = late_lead(probe)
    again = do.reset, do.begin, *late, do.step()
    # words; enabled categories; loggingOn at first; settings of logging, and the settings of another instance
    rows: list[tuple[str, Set[str | None], bool, Sequence[Action], Sequence[Action]]] = [
        ("where logging is on", everything, False, [on], []),
        ("where all categories are enabled by name", everything, False, [all_names], []),
        ("where logging is off at fmi2Instantiate", set(), False, [], []),
        ("where fmi2SetDebugLogging turned logging off", set(), True, [off], []),
        (f"{another} off", everything, True, [], [off]),
        (f"{another} on", set(), False, [], [on]),
    ]
    for name in names:
        alone, without = (do.set_debug_logging(is_on, name) for is_on in (True, False))
        rows.append((f"where {name!r} alone is enabled", {name}, False, [alone], []))
        when = f"where logging was turned off with the category {name!r}"
        # FMI 2.0 says "it is disabled", and FMI 3.0 for which categories
        others = everything - {name} if probe.fmu.fmi == 3 else set[str | None]()
        rows.append((when, others, False, [on, without], []))
    for when, enabled, logging, settings, others in rows:
        actions = do.pause, *settings, do.begin, *late, *_CALLS_THAT_LOG[1:], *(() if settings else again)
        scripts = [probe.script(*some, logging=logging) for some in (others, actions) if some]
        if len(scripts) == 1 or not probe.fmu.claims(ONLY_ONCE):
            # the FMU may refuse a second instance
            with suppress(CallError):
                probe.play(*scripts, keep_going=True)
        if scripts[-1].succeeded:
            yield _Run(when, enabled, _sent(scripts[-1], declared))


def _sent(script: Script, declared: Sequence[str]) -> dict[str | None, str]:
    """Returns category -> text of its first message, of a call that returns ok and turns nothing off."""
    replies = (r for r in script.replies if r.status == OK and r.function != "fmi2SetDebugLogging")
    messages = [m for reply in replies for m in reply.messages]
    chosen = [m for m in messages if m.status == OK or (m.status == WARNING and m.category in declared)]
    return {m.category: m.text for m in reversed(chosen)}


@rule.behaviour_rule("2.1.5")
def no_messages_with_logging_off(probe: Probe) -> Iterator[str]:
    """Messages of a category that is not enabled do not arrive from calls that return ok: with loggingOn =
    fmi2False, also after fmi2Reset, and after fmi2SetDebugLogging with other categories, but logAll (2.2.4),
    or of another instance.
    """
    declared = probe.fmu.log_categories
    for run in _runs_with_logging(probe):
        for category, text in run.sent.items():
            if category not in run.enabled and (category in declared or not run.enabled):
                yield f"a message of the category {category!r} arrives {run.when}: {text[:80]!r}"
                break


@rule.behaviour_rule("2.1.5")
def chosen_categories_are_logged(probe: Probe) -> Iterator[str]:
    """Messages that arrive with all categories enabled, by name or without names, arrive where their own, but
    logAll, is enabled.
    """
    runs, categories = _runs_with_logging(probe), probe.fmu.log_categories or [None]
    everything = [run for run in runs[:2] if run.enabled >= {*probe.fmu.log_categories}]
    for usual, run in product(everything, runs):
        for category in [name for name in categories if name != _ALL]:
            if category in run.enabled and category in usual.sent and category not in run.sent:
                text = usual.sent[category][:80]
                yield f"no message of the category {category!r} arrives {run.when}: expected {text!r}"


@differential("2.1.5")
def debug_logging_can_be_set(probe: Probe) -> Iterator[Row]:
    """fmi2SetDebugLogging accepts each declared category, and none at all, on and off; outputs stay the
    same.
    """
    choices = [*([category] for category in probe.fmu.log_categories), []]
    calls = [do.set_debug_logging(on, *choice) for on in (True, False) for choice in choices]
    yield Row("after fmi2SetDebugLogging", (*calls, do.begin, do.run(2)), failing="")
    yield from paths.rows(probe, paths.again)


@differential("4.2.4")
def debug_logging_is_allowed_after_an_error(_: Probe) -> Iterator[Row]:
    """fmi2SetDebugLogging succeeds after another function returned error."""
    varied = do.begin, do.step(), do.fail, do.set_debug_logging(True)
    yield Row("", varied, (), failing="after an error")
