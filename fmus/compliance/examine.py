"""Judge an FMU by every rule, stage after stage. Nothing that a file holds makes it raise."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from functools import cache
from pathlib import Path

from fmus.compliance.behaviour import DEFAULT_TIMEOUT_S, behaviour, obstacle
from fmus.compliance.fmu_file import BrokenMemberError, FmuFile, UnreadableMemberError
from fmus.compliance.fmu_process import start_process
from fmus.compliance.library_reader import check_lief, close_reader, no_library, start_reading
from fmus.compliance.rule import NotJudgedError, Result, Rule, Stage, defect, messages_of, registered
from fmus.errors import MissingExtraError

_STATIC = (Stage.FILE, Stage.DESCRIPTION, Stage.LIBRARY)


def examine(path: Path, timeout: float = DEFAULT_TIMEOUT_S) -> list[Result]:
    """Returns one result for every rule, in the order of `all_rules`.

    timeout: seconds that one behaviour, or LIEF for one library, may take. The process of LIEF stays for the
    next FMU until `close_reader`, or the end of this process. Raises OSError if there is no such file,
    MissingExtraError without LIEF.
    """
    check_lief()
    with path.open("rb"):
        fmu = FmuFile(path)
    with ExitStack() as stack:
        stack.push(lambda kind, *_: close_reader() if kind else None)  # answers that nobody will receive
        process = None
        if not obstacle(fmu):
            with suppress(OSError):  # which is told when its behaviour is judged
                process = stack.enter_context(closing(start_process()))
        with suppress(Exception):  # which is told when its libraries are judged
            if not (_unread(fmu) or no_library(fmu)):
                start_reading(fmu, timeout)
        of_files = list(static_results(fmu, (Stage.FILE, Stage.DESCRIPTION)))
        of_libraries = cache(lambda: list(static_results(fmu, (Stage.LIBRARY,))))
        of_behaviour = list(behaviour(fmu, timeout, of_libraries, process))
        return [*of_files, *of_libraries(), *of_behaviour]


def static_results(fmu: FmuFile, stages: Sequence[Stage] = _STATIC) -> Iterator[Result]:
    """Yields one result for every rule of what the file holds: no code of the FMU runs."""
    for stage in stages:
        reason = "" if stage is Stage.FILE else _unread(fmu)
        yield from (_result(rule, fmu, reason) for rule in registered(stage))


def _unread(fmu: FmuFile) -> str:
    """Returns the reason why no more than the file is judged, if so."""
    unread = fmu.description_problem and "the model description cannot be read"
    return unread or (fmu.other_version and "it is no FMU of FMI 2.0")


def _result(rule: Rule, fmu: FmuFile, closed: str) -> Result:
    try:
        if closed:
            return Result(rule, not_judged=closed)
        reason = rule.condition(fmu)
        return Result(rule, not_applicable=reason) if reason else Result(rule, messages_of(rule.check(fmu)))
    except MissingExtraError:
        raise
    except (UnreadableMemberError, NotJudgedError) as error:
        return Result(rule, not_judged=str(error))
    except BrokenMemberError as error:
        return Result(rule, messages_of([str(error)]))
    except Exception as error:
        return Result(rule, not_judged=defect(error))
