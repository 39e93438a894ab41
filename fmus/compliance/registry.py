"""All rules, in an order that does not depend on what was imported first."""

from functools import cache
from importlib import import_module

from fmus.compliance.rule import RULES, Rule, Stage

MODULES = (
    "archive", "files", "description", "variables", "structure", "library",
    "lifecycle", "location", "reset", "initialization", "instance",
    "resource", "call", "discard", "value", "constancy", "setting", "step", "asynchronous", "callback",
    "messages", "state", "saved_value", "derivatives", "effects", "reference",
    "model_exchange",
    "status",  # of refusals in the calls of all others
)  # fmt: skip
"""Modules of `fmus.compliance.rules`, in the order in which their rules are judged and told."""


@cache
def registered(stage: Stage) -> tuple[Rule, ...]:
    """Returns the rules of a stage, in the order of `MODULES`, and of their definitions in each."""
    modules = [import_module(f"fmus.compliance.rules.{name}").__name__ for name in MODULES]
    rules = (rule for rule in RULES.values() if rule.stage is stage)
    return tuple(sorted(rules, key=lambda rule: modules.index(rule.module)))


def all_rules() -> tuple[Rule, ...]:
    return tuple(rule for stage in Stage for rule in registered(stage))
