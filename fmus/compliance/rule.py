"""Rules: each is one decorated function, or a row of data; all of them in their order."""

import inspect
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache, wraps
from importlib import import_module
from typing import Any

from fmus.compliance.sentences import ADVICE, clauses_of, levels, rule_table, titles
from fmus.compliance.texts import without_folders

Check = Callable[[Any], Iterable[str] | None]
Condition = Callable[[Any], str]  # why the rule does not apply to an FMU; nothing if it does


class Level(StrEnum):
    """Level of a rule by the consequence of breaking it; the most severe one comes first.

    ERROR: an importer that keeps the standard fails, crashes or gets a wrong result.
    DEVIATION: a sentence demands it, but no importer known to us stumbles over it.
    ADVICE: no sentence demands it.
    """

    ERROR = "error"
    DEVIATION = "deviation"
    ADVICE = "advice"


class Stage(StrEnum):
    """Stage in which a rule is judged, by the part of the FMU that it needs."""

    FILE = "file"
    DESCRIPTION = "description"
    LIBRARY = "library"
    BEHAVIOUR = "behaviour"


@dataclass(frozen=True)
class Rule:
    """One rule: `check` yields a message for each breach, or makes calls that must succeed.

    interface: the element of the only interface that it applies to; "" for both
    fmi: version of the standard whose clause it names
    """

    name: str
    clause: str
    claim: str
    stage: Stage
    check: Check
    condition: Condition
    needs: tuple[str, ...] = ()
    last: bool = False
    interface: str = ""
    module: str = ""
    fmi: int = 2

    @property
    def level(self) -> Level:
        """Level of the rule in `sentences/rules.toml`."""
        table = rule_table()["levels_of_fmi3"] if self.fmi == 3 else {}
        return Level(table.get(self.name, levels()[self.name][0]))

    @property
    def place(self) -> str:
        """The clause; of FMI 3.0 with the version of its text."""
        is_advice = self.clause.startswith(ADVICE)
        return self.clause if self.fmi == 2 or is_advice else f"FMI 3.0.2, {self.clause}"

    def of_version(self, fmi: int) -> "Rule | None":
        """Returns the rule with clause and claim of a version of FMI; None if it is of others alone."""
        if fmi == 2:
            return None if self.module.endswith(".fmi3") else self
        clause = clauses_of(self.name, fmi) or (self.clause if self.name in rule_table()["both"] else "")
        claim = rule_table()["claims_of_fmi3"].get(self.name) or names_of_fmi3(self.claim)
        return replace(self, clause=clause, claim=claim, fmi=3) if clause else None


_TYPES = "Real", "Integer", "Boolean", "String"
_ENTER = "fmi2EnterInitializationMode"
_FUNCTION = re.compile(r"\bfmi2(?=[A-Z])")
_RENAMED = {
    "fmi2SetupExperiment": "fmi3EnterInitializationMode",
    "fmi2Instantiate": "fmi3Instantiate",
    "fmi2NewDiscreteStates": "fmi3UpdateDiscreteStates",
    "GetRealOutputDerivatives": "GetOutputDerivatives",
    "fmi2GetDerivatives": "fmi3GetContinuousStateDerivatives",
    "returned error: expected ok; check: ": "returned ok: ",
    "FMUstate": "FMUState",
    **{f"fmi2{verb}{kind}": f"fmi3{verb}{{VariableType}}" for verb in ("Get", "Set") for kind in _TYPES},
    "DeSerialize": "Deserialize",
    "newDiscreteStatesNeeded": "discreteStatesNeedUpdate",
    "GUID": "instantiationToken",
}


def names_of_fmi3(text: str) -> str:
    """Returns a text about FMI 2.0 with the names that its functions have in FMI 3.0."""
    for old, new in _RENAMED.items():
        text = text.replace(old, new)
    return _FUNCTION.sub("fmi3", text)


IS_BROKEN = " is broken"
"""After the name of a rule: why another one, which would find the same, is not judged."""

CANNOT_LOAD = "this machine cannot load the library"
"""At the begin of the reason why no behaviour is judged on this machine."""


RANDOM = "the outputs are random"
"""Reason why no behaviour is judged, of an FMU whose runs cannot be compared."""


class NotJudgedError(Exception):
    """A rule that cannot be judged, for the reason in the message."""


class NotApplicableError(Exception):
    """A rule about a feature that its `check` does not find in the FMU; the message names the feature."""


@dataclass(frozen=True)
class Shown:
    """Calls that show a finding, a line for each, and programs that make them, by file name.

    reason: why there are no calls
    """

    calls: tuple[str, ...] = ()
    programs: Mapping[str, str] = field(default_factory=dict[str, str])
    reason: str = ""


@dataclass(frozen=True)
class Result:
    """Result of one rule on one FMU: messages, or the reason why it does not apply or could not be judged.

    shown: message -> what shows it, of some messages of behaviour
    """

    rule: Rule
    messages: tuple[str, ...] = ()
    not_applicable: str = ""
    not_judged: str = ""
    shown: Mapping[str, Shown] = field(default_factory=dict[str, Shown])

    @property
    def outcome(self) -> str:
        """One of `OUTCOMES`."""
        if self.messages:
            return self.rule.level.value
        if self.not_judged:
            return "not judged"
        return "not applicable" if self.not_applicable else "passed"


OUTCOMES = ("passed", "not applicable", "not judged", *reversed(Level))
RULES: dict[str, Rule] = {}  # by name, of the modules that are imported; `registered` imports all
_MOST_MESSAGES, _LONGEST_MESSAGE = 100, 2000


def always(_: Any) -> str:
    """Returns no reason why a rule does not apply: it applies to every FMU."""
    return ""


def rule(
    clause: str, stage: Stage, condition: Condition = always, last: bool = False, interface: str = "",
) -> Callable[[Check], Check]:  # fmt: skip
    """Makes a function a rule: its name with dashes is the rule's, its docstring what the rule claims.

    clause: number of a section of FMI 2.0.5, or who else demands it.
    last: it is judged after the rules of its stage that are not, as it judges what came of their calls, or as
    its own may leave the process of the FMU damaged.
    interface: see `Rule`.
    """

    def register(check: Check) -> Check:
        name = check.__name__.replace("_", "-")
        claim = " ".join((inspect.getdoc(check) or "").split())
        add_rule(Rule(name, clause, claim, stage, check, condition, (), last, interface, check.__module__))
        return check

    return register


def add_rule(added: Rule) -> None:
    """Registers a rule, with the title of its clause, its needs and its claim, if that is in `rules.toml`.

    Raises ValueError for a name that another one has.
    """
    if added.name in RULES:
        raise ValueError(f"rule {added.name}: expected one of that name, got a second")
    clause = ", ".join(f"{n} {titles()[n]}" if n in titles() else n for n in added.clause.split(", "))
    needs = tuple(rule_table()["needs"].get(added.name, "").split())
    claim = added.claim or rule_table()["claims"][added.name]
    RULES[added.name] = replace(added, clause=clause, claim=claim, needs=needs)


def behaviour_rule(clause: str, condition: Condition = always, **options: Any) -> Callable[[Check], Check]:
    """Makes a function a rule of behaviour; arguments as in `rule`."""
    return rule(clause, Stage.BEHAVIOUR, condition, **options)


def rule_of(
    judge: Callable[[Any, Any], Iterable[str]], clause: str, **options: Any
) -> Callable[[Callable[..., Any]], Check]:
    """Makes a function a rule of behaviour, whose messages `judge` yields, given a probe and the function.

    options: of `behaviour_rule`
    """

    def register(function: Callable[..., Any]) -> Check:
        check = wraps(function)(lambda probe: judge(probe, function))
        return behaviour_rule(clause, **options)(check)

    return register


def messages_of(check: Iterable[str]) -> tuple[str, ...]:
    """Returns the messages of a check, each on one line: as many and as much of each as somebody may read.

    No text of an FMU in them can move the cursor of a terminal or begin a line.
    """
    messages = [_plain(" ".join(without_folders(text)[:_LONGEST_MESSAGE].split())) for text in check]
    left = len(messages) - _MOST_MESSAGES
    if left < 2:  # a number alone would hide one message
        return tuple(messages)
    return (*messages[:_MOST_MESSAGES], f"{left} more of this kind")


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def repeated(names: Iterable[Any]) -> dict[Any, int]:
    """Returns the number of times that each name occurs, of those that occur more than once.

    None is left out, as the schema reports a missing name.
    """
    return {name: count for name, count in Counter(names).items() if count > 1 and name is not None}


MODULES = (
    "archive", "files", "description", "variables", "structure", "fmi3",
    "lifecycle", "calls", "value", "setting", "step",
    "environment", "messages", "state", "derivatives", "effects", "events", "continuous_time",
)  # fmt: skip
"""Modules of `fmus.compliance.rules`, in the order in which their rules are judged and reported."""


@cache
def registered(stage: Stage) -> tuple[Rule, ...]:
    """Returns the rules of a stage, in the order of `MODULES`, and of their definitions in each."""
    modules = [import_module(f"fmus.compliance.rules.{name}").__name__ for name in MODULES]
    rules = (rule for rule in RULES.values() if rule.stage is stage)
    return tuple(sorted(rules, key=lambda rule: modules.index(rule.module)))


def of_fmi3(result: Result) -> Result:
    """Returns a result of behaviour with the names of functions in FMI 3.0."""
    # fmi3EnterInitializationMode has the arguments of fmi2SetupExperiment, which stands before it
    shown = {
        names_of_fmi3(message): replace(
            one,
            calls=tuple(names_of_fmi3(call) for call in one.calls if not call.endswith(f"{_ENTER}()")),
            reason=names_of_fmi3(one.reason),
        )
        for message, one in result.shown.items()
    }
    reasons = {name: names_of_fmi3(getattr(result, name)) for name in ("not_applicable", "not_judged")}
    return replace(result, messages=tuple(map(names_of_fmi3, result.messages)), shown=shown, **reasons)


def of_version(rules: Iterable[Rule], fmi: int) -> tuple[Rule, ...]:
    """Returns the rules of a version of the standard, with their clauses in it."""
    return tuple(rule for known in rules if (rule := known.of_version(fmi)))


def all_rules() -> tuple[Rule, ...]:
    return tuple(rule for stage in Stage for rule in registered(stage))
