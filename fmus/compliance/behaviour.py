"""Judge rules of behaviour in a process of the FMU: its crash or hang is a finding."""

import errno
import re
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from fmus.compliance.findings import counted
from fmus.compliance.fmu_file import CO_SIMULATION, MODEL_EXCHANGE, ONLY_ONCE, BrokenMemberError, FmuFile
from fmus.compliance.fmu_process import START_S
from fmus.compliance.probe import NO_INSTANCE, Probe, Shared, lacks_licence
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
    messages_of,
    of_fmi3,
    of_version,
    registered,
)
from fmus.compliance.script import KINDS, CallError, DefectError
from fmus.compliance.texts import defect, without_folders
from fmus.compliance.traces.show import what_shows
from fmus.errors import HostError, MissingExtraError, listed
from fmus.files import extract_archive
from fmus.fmi.process import ProcessEndedError

FUNDAMENTAL = (
    "library-loads", "instantiates-and-frees", "steps-and-terminates", "frees-in-every-state",
    "runs-are-repeatable",
)  # fmt: skip
"""Rules without which no behaviour is judged: further findings would have the same cause."""
_UNREAD = "the FMU cannot be read"
ENDED = "the FMU ended the process with"
HUNG, SLOW = "the FMU took more than", "the FMU is slow: its calls took more than"
DEFAULT_TIMEOUT_S, DEFAULT_SEED = 30.0, 1
_STEPS = "steps-and-terminates"
_FORMATS = "formats-of-messages-are-legal"  # a wrong format crashes whatever logs
OF_INSTANCES = _AFTER_OTHERS, _SEVERAL = "instances-follow-each-other", "several-instances"
# what these find keeps later rules from reporting it again
_OF_CALLS = "allowed-calls-succeed", "statuses-are-legal", "wrong-references-are-refused"
_FIRST = *FUNDAMENTAL, _AFTER_OTHERS, *_OF_CALLS
_MOST_HANGS, _MOST_SLOW = 3, 20  # then the rest is not judged: it would take minutes
_NAMES = {CO_SIMULATION: "co-simulation", MODEL_EXCHANGE: "model exchange"}
_OF_THE_HOST = ("ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EMFILE", "ENFILE", "EIO", "ENOMEM", "EAGAIN")


def judged(rule: Rule, subject: FmuFile | Probe, is_random: bool = False) -> Result:
    """Returns the result of a rule on an FMU as a file, or in a process that calls it.

    is_random: whether the outputs of the FMU are random, so that only failed calls and crashes are findings
    """
    try:
        if isinstance(subject, FmuFile) and (reason := rule.condition(subject)):
            return Result(rule, not_applicable=reason)
        messages = rule.check(subject) or ()
        messages = messages_of(counted(messages) if isinstance(subject, Probe) else messages)
        return Result(rule, not_judged=RANDOM) if is_random else Result(rule, messages)
    except (TimeoutError, ProcessEndedError, MissingExtraError):
        raise
    except (NotJudgedError, DefectError) as reason:
        return Result(rule, not_judged=without_folders(str(reason)))
    except NotApplicableError as reason:
        return Result(rule, not_applicable=str(reason))
    except (CallError, BrokenMemberError) as error:
        # no answer of an FMU may stop the check: it is a finding
        if isinstance(subject, Probe) and isinstance(error, CallError):
            subject.shared.subjects[str(error)] = error.reply
        return Result(rule, messages_of([str(error)]))
    except Exception as error:
        return Result(rule, not_judged=defect(error))


def behaviour(
    fmu: FmuFile, timeout: float = DEFAULT_TIMEOUT_S, of_libraries: Sequence[Result] = (),
    names: Collection[str] | None = None, seed: int = DEFAULT_SEED,
) -> Iterator[Result]:  # fmt: skip
    """Yields one result for each behaviour rule, of all interfaces that the FMU has.

    timeout: seconds for one rule
    of_libraries: the results of the rules of libraries
    names: of the rules that are judged, with those that they need; all by default. Broken ones of
    `OF_INSTANCES` are yielded too
    seed: of the random traces
    """
    every = of_version(registered(Stage.BEHAVIOUR), fmu.fmi)
    rules = [rule for rule in every if names is None or rule.name in names]
    halves = {
        interface: _of_interface(fmu.judged_as(interface), rules, timeout, of_libraries, seed)
        for interface in fmu.interfaces or [CO_SIMULATION]
    }
    for rule in every:
        of_rule = {kind: results.get(rule.name, Result(rule)) for kind, results in halves.items()}
        if rule in rules or (rule.name in OF_INSTANCES and any(half.messages for half in of_rule.values())):
            yield of_fmi3(_joined(rule, of_rule)) if fmu.fmi == 3 else _joined(rule, of_rule)


def _of_interface(
    fmu: FmuFile,
    chosen: Sequence[Rule],
    timeout: float,
    of_libraries: Sequence[Result],
    seed: int,
) -> dict[str, Result]:
    """Returns rule name -> result for the interface of the FMU that is judged."""
    reason = obstacle(fmu) or _unreadable_variable(fmu)
    results: dict[str, Result] = {}
    if chosen and not reason:
        judge = _Judge(fmu, timeout, of_libraries, seed)
        judge.judge(chosen)
        results, reason = judge.results, judge.broken_library()
    return {rule.name: Result(rule, not_judged=reason) for rule in chosen} if reason else results


def _other_interface(rule: Rule, fmu: FmuFile) -> str:
    """Returns the reason why a rule does not apply to the interface that is judged, if so."""
    if rule.interface in ("", fmu.interface):
        return ""
    return f"it has no interface for {_NAMES[rule.interface]}"


def _joined(rule: Rule, halves: Mapping[str, Result]) -> Result:
    """Returns one result on all interfaces, which messages name unless it is co-simulation alone."""
    if len(halves) == 1:
        (interface,) = halves
        rule = replace(rule, clause=_clause(rule, interface))
        halves = {interface: replace(halves[interface], rule=rule)}
    if list(halves) == [CO_SIMULATION]:
        return halves[CO_SIMULATION]
    pairs = [(f"{_NAMES[kind]}: {m}", r.shown.get(m)) for kind, r in halves.items() for m in r.messages]
    messages, shown = [message for message, _ in pairs], {message: one for message, one in pairs if one}
    reasons = dict.fromkeys(result.not_judged for result in halves.values() if result.not_judged)
    if messages or reasons:
        return Result(rule, tuple(messages), not_judged="" if messages else "; ".join(reasons), shown=shown)
    if rule.interface in halves:
        return halves[rule.interface]
    return min(halves.values(), key=lambda result: bool(result.not_applicable))


def _clause(rule: Rule, interface: str) -> str:
    """Returns the sections that a rule names, without the chapter of the other interface."""
    sections = re.split(r", (?=\d\.)", rule.clause)
    other = "4." if interface == MODEL_EXCHANGE else "3."
    return ", ".join(s for s in sections if not s.startswith(other)) or rule.clause


def _in_order(chosen: Sequence[Rule], applicable: Mapping[str, Rule]) -> list[Rule]:
    """Returns rules and those that they need, each after those, and the last ones at the end.

    A rule that is judged last looks at the calls of all others, and what others find may be a finding about
    instances.
    """
    names = [rule.name for rule in chosen if rule.name in applicable]
    if any(rule.last or rule.name in OF_INSTANCES for rule in chosen):
        names = list(applicable)
    ordered: dict[str, Rule] = {}

    def add(name: str) -> None:
        if name in applicable and name not in ordered:
            for need in applicable[name].needs:
                add(need)
            ordered[name] = applicable[name]

    for name in (*_FIRST, *sorted(names, key=lambda name: applicable[name].last)):
        add(name)
    return list(ordered.values())


def obstacle(fmu: FmuFile) -> str:
    """Returns the reason why no behaviour can be judged, if there is one."""
    if fmu.fmi == 3 and not fmu.interfaces and fmu.root.find("ScheduledExecution") is not None:
        return "scheduled execution is not judged"
    if fmu.archive_problem or fmu.too_large or fmu.description_problem:
        return f"the description cannot be read: {fmu.description_problem}" if fmu.uses else _UNREAD
    return fmu.other_version or fmu.no_host_library


def _unreadable_variable(fmu: FmuFile) -> str:
    """Returns a variable that no function can read, for a reason that rules of the description report."""
    broken = (v for v in fmu.variables if v.reference is None or v.base_kind not in KINDS)
    return next((f"{v.name or 'a variable'} has no legal value reference or type" for v in broken), "")


class _Judge:
    """Judge of the behaviour of one interface of an FMU.

    results: rule name -> result
    """

    def __init__(self, fmu: FmuFile, timeout: float, of_libraries: Sequence[Result], seed: int) -> None:
        self._fmu, self._timeout, self._of_libraries = fmu, timeout, of_libraries
        self._folder = Path()
        self._is_alone = False  # whether each instance has its own process from now on
        self._shared = {
            is_alone: Shared(seed=seed) for is_alone in (False, True)
        }  # by whether instances are alone
        self._applicable = dict[str, Rule]()
        self._vanished = dict[str, list[Result]]()  # rule about instances -> errors that are its own
        self.results: dict[str, Result] = {}

    def judge(self, chosen: Sequence[Rule]) -> None:
        """Judges rules, and those that they need, on the unpacked FMU.

        After a crash or a hang a new process goes on with the next rule.
        """
        fmu, applicable = self._fmu, self._applicable
        for rule in of_version(registered(Stage.BEHAVIOUR), fmu.fmi):
            if reason := _other_interface(rule, fmu) or rule.condition(fmu):
                self.results[rule.name] = Result(rule, not_applicable=reason)
            else:
                applicable[rule.name] = rule
        rules = _in_order(chosen, applicable)
        self._judge_each(rules)
        for name, (first, *others) in self._vanished.items():
            found_by = listed([result.rule.name for result in (first, *others)], 1)
            words = f"only after other instances in the process, found by {found_by}"
            if name not in self.results or not self.results[name].messages:
                self.results[name] = Result(self._applicable[name], (f"{first.messages[0]}; {words}",))

    def _judge_each(self, rules: Sequence[Rule]) -> None:
        """Judges rules in as many processes as it takes."""
        with host_errors(), _temporary_folder() as temporary:
            self._folder = Path(temporary, "unpacked")
            reason = self._unpack()
            while remaining := [rule for rule in rules if rule.name not in self.results]:
                if reason := reason or self._lack_of_time():
                    self.results |= {rule.name: Result(rule, not_judged=reason) for rule in remaining}
                    return
                self._judge_in_one_process(remaining)
                if self.broken_library():
                    return
                self._judge_formats_after_a_crash(remaining)
            self._show_calls()

    def _unpack(self) -> str:
        """Unpacks the FMU; returns the reason why it cannot be unpacked. `archive-is-zip` reports more."""
        try:
            with host_errors():
                # zipfile keeps odd paths inside the folder
                extract_archive(self._fmu.path, self._folder)
        except HostError:
            raise
        except Exception as error:
            # zipfile raises many kinds of errors for a damaged archive
            return f"it cannot be unpacked: {without_folders(str(error))}"
        return ""

    def _judge_in_one_process(self, rules: Sequence[Rule]) -> None:
        """Judges rules up to the first that ends the process, or makes it unfit for others."""
        is_alone = self._is_alone
        for result in self._results(rules, is_alone, self._shared[is_alone]):
            self.results[result.rule.name] = result
            judge_again = self._judge_alone if self._fmu.claims(ONLY_ONCE) else self._confirm
            if not is_alone and judge_again(result):
                return

    def _results(self, rules: Sequence[Rule], is_alone: bool, shared: Shared) -> Iterator[Result]:
        """Yields results, up to the first rule that a new process does not survive, but one at least."""
        probe = Probe(self._fmu, self._folder, shared, is_alone)
        rule, limit = rules[0], START_S
        try:
            # the start of the interpreter does not count for the first rule
            probe.process.calls([])
            limit = self._timeout
            for rule in rules:
                probe.process.allow(limit)
                yield self._result(rule, probe)
        except TimeoutError:
            is_usual = probe.states_step_size or not probe.process.call_under_way.startswith("fmi2DoStep")
            # a step of a size that the FMU does not state may be long
            if is_usual and probe.process.hangs(limit):
                yield self._ended(rule, f"{HUNG} {limit:g} s in one call", probe)
            else:
                yield Result(rule, not_judged=f"{SLOW} {limit:g} s")
        except ProcessEndedError as ended:
            yield self._ended(rule, f"{ENDED} {ended}", probe)
        finally:
            probe.process.close()

    def _ended(self, rule: Rule, what: str, probe: Probe) -> Result:
        """Returns the finding of a call that ends the process or exceeds the time limit. The same call is a
        finding of the first rule alone, unless a later one is more severe.
        """
        call, severity = without_folders(probe.process.call_under_way), list(Level)
        message = f"{what}, in {call}" if call else what
        others = (r.rule for r in self.results.values() if message in r.messages and r.rule is not rule)
        severe = [o.name for o in others if severity.index(o.level) <= severity.index(rule.level)]
        if call and severe:
            return Result(rule, not_judged=f"{call} does not return, as {severe[0]} reports")
        probe.shared.crashes[message] = probe.under_way if what.startswith(ENDED) else ()
        return Result(rule, (message,))

    def _result(self, rule: Rule, probe: Probe) -> Result:
        needed = [self.results[name] for name in (*FUNDAMENTAL, *rule.needs) if name in self.results]
        reasons = {_breach(result) for result in needed if result.rule is not rule} - {""}
        if others := reasons - {RANDOM}:
            return Result(rule, not_judged=min(others))
        return judged(rule, probe, is_random=RANDOM in reasons)

    def _confirm(self, result: Result) -> bool:
        """Judges a broken rule again with none of the runs before, and keeps that result; returns whether
        another process goes on, as runs before have changed this one.
        """
        rule, refusal = result.rule, _refusal(result)
        # nothing was played before the first rules; the last ones look at what all others played
        is_kept = rule.last or rule.name in (*FUNDAMENTAL[:2], *OF_INSTANCES)
        if refusal:
            is_kept = rule.name == _AFTER_OTHERS or _AFTER_OTHERS not in self.results
            # an FMU that refuses even the first instance was asked in a new process already
            first = (self.results[name] for name in FUNDAMENTAL[:2] if name in self.results)
            is_kept |= any(refusal == _refusal(one) for one in first)
        if is_kept or not (result.messages or refusal):
            return False
        shared = self._shared[False].for_a_new_process(rule.name)
        again = next(self._results([rule], False, shared))
        if refusal and refusal == _refusal(again):
            again = next(self._results([rule], True, self._shared[True]))
        if result.messages and again.not_judged and not _refusal(again):
            # a call that another rule reports hinders the second judgement: it does not refute the first
            return False
        self.results[rule.name] = again
        has_vanished = refusal != _refusal(again) if refusal else not again.messages
        if has_vanished:
            self._shared[False] = shared
            if result.messages and rule.level is Level.ERROR:
                self._vanished.setdefault(_AFTER_OTHERS if refusal else _SEVERAL, []).append(result)
        return has_vanished

    def _judge_alone(self, result: Result) -> bool:
        """Judges a broken rule again with one instance per process, as 4.3.1 lets an FMU claim; returns
        whether all rules are judged so from now on, as the FMU refuses instances after others.
        """
        if result.messages:
            again = next(self._results([result.rule], True, self._shared[True]))
            self.results[result.rule.name] = again
            self._is_alone = _refusal(result) != _refusal(again)
        return self._is_alone

    def _judge_formats_after_a_crash(self, rules: Sequence[Rule]) -> None:
        """Judges the rule of formats if the last rule ended the process: a wrong format may be the cause."""
        last = list(self.results.values())[-1]
        formats = next((rule for rule in rules if rule.name == _FORMATS), None)
        if not formats or _FORMATS in self.results or not _has_ended(last):
            return
        del self.results[last.rule.name]
        result = next(self._results([formats], False, self._shared[False]))
        if result.messages and not _has_ended(result):
            self.results[_FORMATS] = result
            last = Result(last.rule, not_judged=f"{_FORMATS}{IS_BROKEN}")
        self.results[last.rule.name] = last

    def _show_calls(self) -> None:
        """Adds the shortest calls that show findings to their results."""
        shared = [*self._shared.values()]
        for name, result in self.results.items():
            if result.messages:
                first, *_ = result.messages
                calls = what_shows(self._fmu, first, shared, self._new_probe)
                self.results[name] = replace(result, shown={first: calls})

    @contextmanager
    def _new_probe(self) -> Iterator[Probe]:
        """Gives a probe with a process that shows one finding."""
        probe = Probe(self._fmu, self._folder, Shared(), self._is_alone)
        probe.process.allow(START_S + self._timeout)
        try:
            yield probe
        finally:
            probe.process.close()

    def _lack_of_time(self) -> str:
        """Returns the reason why the rest is not judged: it would take too long."""
        results = self.results.values()
        slow = {r.rule.name: r.not_judged for r in results if r.not_judged.startswith(SLOW)}
        if sum(m.startswith(HUNG) for r in results for m in r.messages) >= _MOST_HANGS:
            return f"{_MOST_HANGS} rules before took more than {self._timeout:g} s in one call"
        if len(slow) >= _MOST_SLOW:
            return f"{_MOST_SLOW} rules before took more than {self._timeout:g} s"
        return slow.get(_STEPS, "")

    def broken_library(self) -> str:
        """Returns the rule of libraries that the library of this platform breaks, if no behaviour is judged.

        It may lack functions that no importer calls.
        """
        library = f"{self._fmu.host_library} "
        broken = [r.rule.name for r in self._of_libraries if any(m.startswith(library) for m in r.messages)]
        loads = self.results.get("library-loads")
        gates = ["library-format", *(["library-exports"] if loads and loads.messages else [])]
        return next((f"{name}{IS_BROKEN}" for name in gates if name in broken), "")


def _refusal(result: Result) -> str:
    """Returns the reason why there was no instance, also for a licence; "" if there was one."""

    def is_refusal(text: str) -> bool:
        return text.startswith(NO_INSTANCE) or (text.startswith(ENDED) and ", in fmi2Instantiate(" in text)

    return next(filter(is_refusal, (*result.messages, result.not_judged)), "")


def _has_ended(result: Result) -> bool:
    return any(message.startswith(ENDED) for message in result.messages)


def _breach(result: Result) -> str:
    """Returns the reason why what needs a rule is not judged: it is broken, or is not judged itself."""
    if result.messages:
        return f"{result.rule.name}{IS_BROKEN}"
    reason = result.not_judged
    is_of_all = reason.startswith(CANNOT_LOAD) or reason.endswith((IS_BROKEN, RANDOM))
    return reason if is_of_all or lacks_licence(reason) else ""


def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    try:
        return tempfile.TemporaryDirectory(prefix="fmu-check-", ignore_cleanup_errors=True)
    except OSError as error:
        # also FileNotFoundError, if no folder for temporary files can be written
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
