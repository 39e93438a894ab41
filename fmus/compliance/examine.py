"""Judge an FMU by every rule, stage after stage. Nothing that a file holds makes it raise."""

from collections.abc import Iterator
from pathlib import Path

from fmus.compliance import (
    alias_rules,
    archive_rules,
    description_rules,
    documentation_rules,
    implementation_rules,
    library_rules,
    name_rules,
    structure_rules,
    type_rules,
    unit_rules,
    variable_rules,
)
from fmus.compliance.behaviour import DEFAULT_TIMEOUT_S, behaviour
from fmus.compliance.fmu_file import FmuFile, UnreadableMemberError
from fmus.compliance.rule import Result, Rule, Stage, messages_of, registered

MODULES = (
    archive_rules, implementation_rules, documentation_rules, description_rules, unit_rules, type_rules,
    name_rules, variable_rules, alias_rules, structure_rules, library_rules,
)  # fmt: skip


def all_rules() -> tuple[Rule, ...]:
    return tuple(rule for stage in Stage for rule in registered(stage))


def examine(path: Path, timeout: float = DEFAULT_TIMEOUT_S) -> list[Result]:
    """One result for every rule, in the order of `all_rules`.

    timeout: seconds that one behaviour may take. Raises OSError if there is no such file.
    """
    with path.open("rb"):
        fmu = FmuFile(path)
    earlier = list(static_results(fmu))
    return [*earlier, *behaviour(fmu, timeout, earlier)]


def static_results(fmu: FmuFile) -> Iterator[Result]:
    """One result for every rule of what the file holds: no code of the FMU runs."""
    unread = fmu.description_problem and "the model description cannot be read"
    unread = unread or (fmu.other_version and "it is no FMU of FMI 2.0")
    closed = {Stage.FILE: "", Stage.DESCRIPTION: unread, Stage.LIBRARY: unread}
    for stage, reason in closed.items():
        yield from (_result(rule, fmu, reason) for rule in registered(stage))


def _result(rule: Rule, fmu: FmuFile, closed: str) -> Result:
    try:
        if closed:
            return Result(rule, not_judged=closed)
        reason = rule.condition(fmu)
        return Result(rule, not_applicable=reason) if reason else Result(rule, messages_of(rule.check(fmu)))
    except UnreadableMemberError as error:
        return Result(rule, not_judged=str(error))
    except Exception as error:  # a validator that fails on what it reads has found something
        return Result(rule, messages_of([f"could not be judged, {type(error).__name__}: {error}"]))
