"""Judge rules of behaviour in another process: a crash or a hang of the FMU is a finding."""

import errno
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from fmus.compliance.fmu_file import CO_SIMULATION, MODEL_EXCHANGE, ONLY_ONCE, BrokenMemberError, FmuFile
from fmus.compliance.fmu_process import START_S
from fmus.compliance.probe import NO_INSTANCE, Probe
from fmus.compliance.rule import (
    CANNOT_LOAD,
    IS_BROKEN,
    RANDOM,
    Level,
    NotApplicableError,
    NotJudgedError,
    Result,
    Rule,
    Stage,
    defect,
    messages_of,
    registered,
)
from fmus.compliance.script import KINDS, CallError, DefectError
from fmus.errors import HostError
from fmus.fmi.binding import platform_name
from fmus.fmi.process import ProcessEndedError, WorkerProcess

FUNDAMENTAL = (
    "library-loads", "instantiates-and-frees", "steps-and-terminates", "frees-in-every-state",
    "runs-are-repeatable",
)  # fmt: skip
"""Without these no behaviour is judged: what else would be found has the same cause."""
ENDED = "the FMU ended the process with"
_RANDOM_RUNS = "runs-are-not-random"
HUNG, SLOW = "the FMU took more than", "the FMU is slow: its calls took more than"


def judged_by_one_process(
    probe: Probe, rules: Sequence[Rule], results: Mapping[str, Result], timeout: float
) -> Iterator[Result]:
    """Results, up to the first rule that the process does not survive, but one at least.

    results: of the rules before; it grows with what this yields
    """
    rule, limit = rules[0], START_S
    try:
        probe.process.calls([])  # it has started
        limit = timeout
        for rule in rules:
            probe.process.deadline = time.monotonic() + limit
            yield _judge(rule, probe, results)
    except TimeoutError:
        if probe.process.hangs(limit):
            yield Result(rule, (f"{HUNG} {limit:g} s in one call{_call(probe)}",))
        else:
            yield Result(rule, not_judged=f"{SLOW} {limit:g} s")
    except ProcessEndedError as ended:
        yield Result(rule, (f"{ENDED} {ended}{_call(probe)}",))
    finally:
        probe.process.close()


def _call(probe: Probe) -> str:
    call = probe.process.call_under_way
    return f", in {call}" if call else ""


def _breach(result: Result) -> str:
    """Returns the reason why what needs a rule is not judged: it is broken, or is not judged itself."""
    if result.messages:
        return f"{result.rule.name}{IS_BROKEN}"
    is_of_all = result.not_judged.startswith(CANNOT_LOAD) or result.not_judged.endswith((IS_BROKEN, RANDOM))
    return result.not_judged if is_of_all else ""


def _judge(rule: Rule, probe: Probe, results: Mapping[str, Result]) -> Result:
    needed = [results[name] for name in (*FUNDAMENTAL, *rule.needs) if name in results]
    reasons = set(filter(None, map(_breach, needed)))
    if others := reasons - {RANDOM}:
        return Result(rule, not_judged=min(others))
    try:
        messages = messages_of(rule.check(probe))
        is_random = RANDOM in reasons and rule.name != _RANDOM_RUNS  # calls that fail or crash are told still
        return Result(rule, not_judged=RANDOM) if is_random else Result(rule, messages)
    except (TimeoutError, ProcessEndedError):
        raise
    except (NotJudgedError, DefectError) as reason:
        return Result(rule, not_judged=str(reason))
    except NotApplicableError as reason:
        return Result(rule, not_applicable=str(reason))
    except (CallError, BrokenMemberError) as error:  # whatever an FMU answers is a finding
        return Result(rule, messages_of([str(error)]))
    except Exception as error:
        return Result(rule, not_judged=defect(error))


DEFAULT_TIMEOUT_S = 30.0
_STEPS = "steps-and-terminates"
_FORMATS = "formats-of-messages-are-legal"  # a wrong format crashes whatever logs
_AFTER_OTHERS, _MOST_CRASHES = "instances-follow-each-other", 2
_MOST_HANGS, _MOST_SLOW = 3, 20  # then the rest is not judged: it would take minutes
_NAMES = {CO_SIMULATION: "co-simulation", MODEL_EXCHANGE: "model exchange"}
_OF_THE_HOST = ("ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EMFILE", "ENFILE", "EIO", "ENOMEM", "EAGAIN")


def behaviour(
    fmu: FmuFile,
    timeout: float,
    of_libraries: Callable[[], Sequence[Result]] = tuple,
    started: WorkerProcess | None = None,
) -> Iterator[Result]:
    """Yields one result for each behaviour rule, of all interfaces that the FMU has.

    timeout: seconds for one rule; started: a process that does not know an FMU yet
    of_libraries: the results of the rules of libraries, which LIEF reads meanwhile; asked for when a
    process of the FMU has ended
    """
    halves = {}
    for interface in fmu.interfaces or [CO_SIMULATION]:
        halves[interface] = _of_interface(fmu.judged_as(interface), timeout, of_libraries, started)
        started = None
    for rule in registered(Stage.BEHAVIOUR):
        yield _joined(rule, {interface: results[rule.name] for interface, results in halves.items()})


def _of_interface(
    fmu: FmuFile,
    timeout: float,
    of_libraries: Callable[[], Sequence[Result]],
    started: WorkerProcess | None,
) -> dict[str, Result]:
    """Returns rule name -> result for the interface of the FMU that is judged."""
    rules = registered(Stage.BEHAVIOUR)
    results: dict[str, Result] = {}
    reason = obstacle(fmu) or _unreadable_variable(fmu)
    if not reason:
        conditions = {rule: _other_interface(rule, fmu) or rule.condition(fmu) for rule in rules}
        results = {rule.name: Result(rule, not_applicable=text) for rule, text in conditions.items()}
        names = [name for name, result in results.items() if not result.not_applicable]
        results |= _judged(fmu, _needs_first(names), timeout, of_libraries, started)
        reason = _broken_library(fmu, of_libraries())
    return {rule.name: Result(rule, not_judged=reason) for rule in rules} if reason else results


def _other_interface(rule: Rule, fmu: FmuFile) -> str:
    """Returns the reason why a rule does not apply to the interface that is judged, if so."""
    if rule.interface in ("", fmu.interface):
        return ""
    return f"it has no interface for {_NAMES[rule.interface]}"


def _joined(rule: Rule, halves: Mapping[str, Result]) -> Result:
    """Returns one result on all interfaces, which messages name unless it is co-simulation alone."""
    if list(halves) == [CO_SIMULATION]:
        return halves[CO_SIMULATION]
    messages = [f"{_NAMES[kind]}: {m}" for kind, result in halves.items() for m in result.messages]
    reasons = dict.fromkeys(result.not_judged for result in halves.values() if result.not_judged)
    if messages or reasons:
        return Result(rule, tuple(messages), not_judged="" if messages else "; ".join(reasons))
    of_one = halves.get(rule.interface)
    return of_one or min(halves.values(), key=lambda result: bool(result.not_applicable))


def _needs_first(names: Sequence[str]) -> list[str]:
    """Returns the names in order, but each after those that its rule needs, and the last ones at the end."""
    rules = {rule.name: rule for rule in registered(Stage.BEHAVIOUR)}
    ordered: dict[str, None] = {}

    def add(name: str) -> None:
        for need in rules[name].needs:
            if need in names:
                add(need)
        ordered.setdefault(name)

    first = [name for name in (*FUNDAMENTAL, _AFTER_OTHERS) if name in names]
    for name in (*first, *sorted(names, key=lambda name: rules[name].last)):
        add(name)
    return list(ordered)


def obstacle(fmu: FmuFile) -> str:
    """Returns the reason why no behaviour can be judged, if there is one."""
    if fmu.archive_problem or fmu.too_large or fmu.description_problem:
        return "the FMU cannot be read"
    if fmu.other_version:
        return "it is no FMU of FMI 2.0"
    return "" if fmu.host_library else f"no library for {platform_name()}"


def _unreadable_variable(fmu: FmuFile) -> str:
    """Returns the variable that no function can read: rules of the description tell what is wrong with it."""
    broken = (v for v in fmu.variables if v.reference is None or v.base_kind not in KINDS)
    return next((f"{v.name or 'a variable'} has no legal value reference or type" for v in broken), "")


def _broken_library(fmu: FmuFile, results: Sequence[Result]) -> str:
    """Returns the rule of libraries that the library of this platform breaks, if any."""
    broken = (r.rule.name for r in results if any(m.startswith(f"{fmu.host_library} ") for m in r.messages))
    return next(
        (f"{name}{IS_BROKEN}" for name in broken if name in ("library-format", "library-exports")), ""
    )


def _judged(
    fmu: FmuFile,
    names: Sequence[str],
    timeout: float,
    of_libraries: Callable[[], Sequence[Result]],
    started: WorkerProcess | None,
) -> dict[str, Result]:
    """Returns rule name -> result, of the unpacked FMU."""
    rules = {rule.name: rule for rule in registered(Stage.BEHAVIOUR)}
    with host_errors(), _temporary_folder() as temporary:
        folder = Path(temporary, "unpacked")
        try:
            with host_errors():
                fmu.extract(folder)
        except HostError:
            raise
        except Exception as error:  # an archive that is damaged anywhere: `archive-is-zip` tells more
            return {name: Result(rules[name], not_judged=f"it cannot be unpacked: {error}") for name in names}
        return _judged_unpacked(fmu, folder, [rules[name] for name in names], timeout, of_libraries, started)


def _judged_unpacked(
    fmu: FmuFile,
    folder: Path,
    rules: Sequence[Rule],
    timeout: float,
    of_libraries: Callable[[], Sequence[Result]],
    started: WorkerProcess | None,
) -> dict[str, Result]:
    """Returns rule name -> result. After a crash or a hang a new process goes on with the next rule."""
    results: dict[str, Result] = {}
    shared: dict[str, Any] = {}
    shared_alone: dict[str, Any] = {}  # of instances that are alone in their processes
    is_alone = False  # whether each instance has a process of its own from now on
    while remaining := [rule for rule in rules if rule.name not in results]:
        if reason := _lack_of_time(results, timeout):
            return results | {rule.name: Result(rule, not_judged=reason) for rule in remaining}
        known = shared_alone if is_alone else shared
        probe = Probe(fmu, folder, time.monotonic() + START_S, known, started, is_alone)
        for result in judged_by_one_process(probe, remaining, results, timeout):
            if is_alone:
                results[result.rule.name] = result
                continue
            judge_alone = partial(_judged_alone, result.rule, fmu, folder, shared_alone, results, timeout)
            results |= _without_instances_before(result, results, fmu.claims(ONLY_ONCE), judge_alone)
            if _is_no_instance(result) and results[result.rule.name] != result:
                is_alone = True
                break
        started = None
        if _broken_library(fmu, of_libraries()):  # then no behaviour is judged
            break
        last = list(results.values())[-1]  # `library-loads` at least
        formats = next((rule for rule in remaining if rule.name == _FORMATS), None)
        if any(m.startswith(ENDED) for m in last.messages) and formats and _FORMATS not in results:
            probe = Probe(fmu, folder, time.monotonic() + START_S, {})
            results |= _crash_of_a_format(last.rule, probe, formats, timeout)
    return results


def _crash_of_a_format(rule: Rule, probe: Probe, formats: Rule, timeout: float) -> dict[str, Result]:
    """Returns results of a rule that ended with the process and of that of formats, if it is the cause."""
    (result,) = judged_by_one_process(probe, [formats], {}, timeout)
    if not result.messages or result.messages[0].startswith(ENDED):
        return {}
    return {rule.name: Result(rule, not_judged=f"{_FORMATS}{IS_BROKEN}"), _FORMATS: result}


def _lack_of_time(results: Mapping[str, Result], timeout: float) -> str:
    """Returns the reason why the rest is not judged: it would take too long."""
    slow = {name: r.not_judged for name, r in results.items() if r.not_judged.startswith(SLOW)}
    if sum(m.startswith(HUNG) for r in results.values() for m in r.messages) >= _MOST_HANGS:
        return f"{_MOST_HANGS} rules before took more than {timeout:g} s in one call"
    if len(slow) >= _MOST_SLOW:
        return f"{_MOST_SLOW} rules before took more than {timeout:g} s"
    return slow.get(_STEPS, "")


def _is_no_instance(result: Result) -> bool:
    """Whether a plain fmi2Instantiate gave nothing; a rule that passes other arguments says so before."""
    return any(message.startswith(NO_INSTANCE) for message in result.messages)


def _without_instances_before(
    result: Result, results: Mapping[str, Result], only_once: bool, judge_alone: Callable[[], Result]
) -> dict[str, Result]:
    """Returns results that follow from a rule's: a crash, or no instance, that instances before it cause is a
    finding of one rule.

    only_once: whether the FMU asks for a process for each instance
    judge_alone: judges the rule where no instance was before
    """
    rule, follow = result.rule, results.get(_AFTER_OTHERS)
    crashes = [m for m in result.messages if m.startswith((ENDED, NO_INSTANCE))]
    is_minor = rule.level is not Level.ERROR  # it may have made calls that FMI forbids
    if (only_once and result.messages) or (is_minor and _is_no_instance(result)):
        return {rule.name: judge_alone()}
    if only_once or not crashes or follow is None:
        return {rule.name: result}
    if len(follow.messages) >= (1 if is_minor else _MOST_CRASHES):
        return {rule.name: Result(rule, not_judged=f"{_AFTER_OTHERS}{IS_BROKEN}")}
    if is_minor:
        return {rule.name: result}
    alone = judge_alone()
    if any(message in alone.messages for message in crashes):
        return {rule.name: result}
    messages = (*follow.messages, f"{rule.name}, after other instances: {crashes[0]}")
    return {rule.name: alone, _AFTER_OTHERS: Result(follow.rule, messages)}


def _judged_alone(
    rule: Rule,
    fmu: FmuFile,
    folder: Path,
    shared: dict[str, Any],
    results: Mapping[str, Result],
    timeout: float,
) -> Result:
    """Returns the verdict where no instance was in the process before, as 4.3.1 lets an FMU ask for."""
    probe = Probe(fmu, folder, time.monotonic() + START_S, shared, one_instance=True)
    return next(judged_by_one_process(probe, [rule], results, timeout))


def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    try:
        return tempfile.TemporaryDirectory(prefix="fmu-check-", ignore_cleanup_errors=True)
    except OSError as error:  # also FileNotFoundError, where no folder takes a file
        raise HostError(f"{error}: expected a folder for temporary files") from error


@contextmanager
def host_errors() -> Iterator[None]:
    """Turns a full disk, or another lack of the machine, into a HostError while the context lasts."""
    try:
        yield
    except OSError as error:
        if errno.errorcode.get(error.errno or 0) in _OF_THE_HOST:
            raise HostError(f"{error}: expected disk space and a process for the check") from error
        raise
