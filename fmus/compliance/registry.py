"""All rules, in an order that does not depend on what was imported first."""

from fmus.compliance import (
    alias_rules,
    archive_rules,
    asynchronous_rules,
    call_rules,
    callback_rules,
    constancy_rules,
    dependency_rules,
    derivative_rules,
    description_rules,
    directional_rules,
    discard_rules,
    documentation_rules,
    implementation_rules,
    initialization_rules,
    input_derivative_rules,
    input_slope_rules,
    instance_rules,
    library_rules,
    lifecycle_rules,
    location_rules,
    log_rules,
    message_rules,
    name_rules,
    output_derivative_rules,
    process_rules,
    reference_rules,
    reset_rules,
    resource_rules,
    saved_value_rules,
    setting_rules,
    source_rules,
    state_rules,
    status_rules,
    step_dependency_rules,
    step_directional_rules,
    step_rules,
    structure_rules,
    type_rules,
    unit_rules,
    value_rules,
    variable_rules,
)
from fmus.compliance.rule import RULES, Rule, Stage

MODULES = (
    archive_rules, implementation_rules, source_rules, documentation_rules, description_rules, unit_rules,
    type_rules, name_rules, variable_rules, alias_rules, structure_rules, library_rules,
    lifecycle_rules, location_rules, reset_rules, initialization_rules, instance_rules, resource_rules,
    call_rules, discard_rules, value_rules, constancy_rules, setting_rules, step_rules,
    asynchronous_rules, callback_rules, log_rules, message_rules, process_rules, state_rules,
    saved_value_rules, input_derivative_rules, output_derivative_rules, derivative_rules, input_slope_rules,
    directional_rules, step_directional_rules, dependency_rules, step_dependency_rules, reference_rules,
    status_rules,  # of refusals in the calls of all others
)  # fmt: skip


def registered(stage: Stage) -> tuple[Rule, ...]:
    """Returns the rules of a stage, in the order of `MODULES`, and of their definitions in each."""
    names = [module.__name__ for module in MODULES]
    rules = (rule for rule in RULES.values() if rule.stage is stage)
    return tuple(sorted(rules, key=lambda rule: names.index(rule.check.__module__)))


def all_rules() -> tuple[Rule, ...]:
    return tuple(rule for stage in Stage for rule in registered(stage))
