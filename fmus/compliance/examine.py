"""Judge an FMU by every rule, stage after stage. No content of the file raises an error."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from fmus.compliance.behaviour import (
    DEFAULT_SEED,
    DEFAULT_TIMEOUT_S,
    FUNDAMENTAL,
    OF_INSTANCES,
    behaviour,
    judged,
)
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Result, Stage, of_version, registered

GATES = "archive-is-zip", "archive-has-description", "description-is-readable", *FUNDAMENTAL
_STATIC = (Stage.FILE, Stage.DESCRIPTION, Stage.LIBRARY)


def examine(
    path: Path,
    timeout: float = DEFAULT_TIMEOUT_S,
    names: Collection[str] | None = None,
    seed: int = DEFAULT_SEED,
) -> list[Result]:
    """Returns one result for every rule, in the order of `all_rules`.

    Parameters
    ----------
    path
        The FMU.
    timeout
        Longest time [s] of one rule of behaviour.
    names
        Names of the rules to be judged, by default all.
    seed
        Seed of the random traces of calls.

    Returns
    -------
    list of Result
        Results of these rules, and broken rules of `OF_INSTANCES`; where a chosen rule is not judged, also
        broken rules of `GATES`.

    Raises
    ------
    OSError
        If the file does not exist.
    MissingExtraError
        Without pyelftools, pefile or macholib, if the FMU has a library of that format.
    """
    with path.open("rb"):
        fmu = FmuFile(path)
    of_archive = None if names is None else {*names, *GATES}
    runs = names is None or any(rule.name in names for rule in registered(Stage.BEHAVIOUR))
    of_files = list(static_results(fmu, (Stage.FILE, Stage.DESCRIPTION), of_archive))
    of_libraries = list(static_results(fmu, (Stage.LIBRARY,), None if runs else names))
    of_behaviour = list(behaviour(fmu, timeout, of_libraries, of_archive if runs else names, seed))
    results = [*of_files, *of_libraries, *of_behaviour]
    shown = {result.rule.name for result in results} if names is None else {*names}
    told = (*OF_INSTANCES, *(GATES if any(r.not_judged for r in results if r.rule.name in shown) else ()))
    return [r for r in results if r.rule.name in shown or (r.rule.name in told and r.messages)]


def static_results(
    fmu: FmuFile, stages: Sequence[Stage] = _STATIC, names: Collection[str] | None = None
) -> Iterator[Result]:
    """Yields one result for every rule of the file's contents, without running code of the FMU.

    names: of the rules that are judged, all by default
    """
    for stage in stages:
        unread = "" if stage is Stage.FILE else _unread(fmu)
        for rule in of_version(registered(stage), fmu.fmi):
            if names is None or rule.name in names:
                yield Result(rule, not_judged=unread) if unread else judged(rule, fmu)


def _unread(fmu: FmuFile) -> str:
    """Returns the reason why no more than the file is judged, if so."""
    unread = fmu.description_problem and "the model description cannot be read"
    return unread or fmu.other_version
