"""The FMU that behaviour rules examine, by scripts of calls on its instances."""

import itertools
import marshal
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.fmu_process import Call, FmuProcess
from fmus.compliance.rule import NotApplicableError, NotJudgedError
from fmus.compliance.script import Action, CallError, Groups, Message, Reply, Script, grouped
from fmus.compliance.texts import USUAL_NAME
from fmus.compliance.variable import Variable, number
from fmus.fmi import binding
from fmus.fmi.binding import DISCARD

T = TypeVar("T")
_LICENCE = re.compile("licen[cs]e", re.IGNORECASE)
_MOST_MESSAGES = 10_000
_TOLERANCE, _MOST_TOLERANCE = 1e-4, 1e-3
_OF_CAPABILITIES = {  # capability -> functions that no importer calls without it
    "canGetAndSetFMUstate": "GetFMUstate SetFMUstate FreeFMUstate",
    "canSerializeFMUstate": "SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate",
    "providesDirectionalDerivative": "GetDirectionalDerivative",
    "canInterpolateInputs": "SetRealInputDerivatives",
}
NO_INSTANCE = "fmi2Instantiate returned NULL"


@dataclass
class Shared:
    """Observations that the rules share.

    results: of `Probe.once`; played: scripts by their calls; failing: (function, state) -> reporting rule
    refusals: replies that were not ok to calls with logging, one of each function and status, with and
      without messages; not of scripts with forbidden calls, nor after fmi2SetDebugLogging
    log: messages of all instances with logging, each with the first reply that has it, but of calls or
      arguments that FMI forbids
    seed: of the random traces; cases: message -> `Case`, which shows it
    crashes: message -> scripts by groups, some of which end the process
    failed: problem -> first failed call that has it
    subjects: message -> what it is about: a reply, a message of the FMU, or a change with its `reply`
    refused_steps: reason why the FMU refuses steps of the usual size, if so
    discards: reason why it discards one of them
    """

    results: dict[str, Any] = field(default_factory=dict[str, Any])
    played: dict[bytes, Script] = field(default_factory=dict[bytes, Script])
    failing: dict[tuple[str, str], str] = field(default_factory=dict[tuple[str, str], str])
    refusals: dict[tuple[str, int, bool], Reply] = field(default_factory=dict[tuple[str, int, bool], Reply])
    log: dict[Message, Reply] = field(default_factory=dict[Message, Reply])
    seed: int = 1
    crashes: dict[str, Sequence[Sequence[Script]]] = field(default_factory=dict[str, Any])
    cases: dict[str, Any] = field(default_factory=dict[str, Any])
    failed: dict[str, Reply] = field(default_factory=dict[str, Reply])
    subjects: dict[str, Any] = field(default_factory=dict[str, Any])
    refused_steps: str = ""
    discards: str = ""

    def for_a_new_process(self, rule: str) -> "Shared":
        """Returns these without played scripts and their results, and without the failing calls of a rule."""
        failing = {call: name for call, name in self.failing.items() if name != rule}
        return replace(self, results={}, played={}, failing=failing)


class DiscardedStepError(NotJudgedError):
    """A step that the FMU discards, which 4.2.2 allows."""


class Probe:
    """An unpacked FMU in its own process.

    one_instance: of `FmuProcess`; under_way: the scripts that are played, or were the last, by groups
    start_time, stop_time, step_size: of the default experiment [s], infinite if it states no stop time;
    states_step_size: whether it states one; tolerance: relative, stated or the usual one
    """

    def __init__(self, fmu: FmuFile, folder: Path, shared: Shared, one_instance: bool = False) -> None:
        self.fmu = fmu
        library, resources = folder / fmu.host_library, folder / "resources"
        interface = binding.MODEL_EXCHANGE if fmu.is_model_exchange else binding.CO_SIMULATION
        optional = " ".join(names for flag, names in _OF_CAPABILITIES.items() if not fmu.claims(flag)).split()
        self.process = FmuProcess((library, resources, interface, optional, fmu.elements), one_instance)
        self._instances = itertools.count(1)
        self._groups: dict[tuple[Variable, ...], Groups] = {}
        self.under_way: Sequence[Sequence[Script]] = ()
        self.shared = shared
        self._options: dict[str, Any] = {"guid": fmu.root.get("guid", "")}
        self._options |= {"uses": fmu.uses} if fmu.uses else {}
        if fmu.is_model_exchange:
            self._options |= {
                "states": fmu.vector_length("fmi2GetContinuousStates"),
                "indicators": fmu.vector_length("fmi2GetEventIndicators"),
                "needs_completed": not fmu.claims("completedIntegratorStepNotNeeded"),
            }
        experiment = fmu.root.find("DefaultExperiment")
        get = experiment.get if experiment is not None else {}.get
        self.start_time = number(get("startTime")) or 0.0
        stop_time = number(get("stopTime"))
        self.stop_time = math.inf if stop_time is None else stop_time
        span = (stop_time or self.start_time + 1.0) - self.start_time
        self.states_step_size = bool(number(get("stepSize")))
        self.step_size = number(get("stepSize")) or span / 1000
        self.tolerance = min(number(get("tolerance")) or _TOLERANCE, _MOST_TOLERANCE)

    def ask(self, method: str, *arguments: Any) -> Any:
        """Returns the result of a method of `LoadedFmu`."""
        return self.process.calls([(method, *arguments)])[0]

    def script(self, *actions: Action, lead: Sequence[Action] = (), **options: Any) -> Script:
        """Returns a script for a new instance, which begins with the calls of some actions.

        lead: see `Script`; options: of `CalledInstance`, but for the GUID of the description
        """
        script = Script(self, {**self._options, **options})
        script.lead = lead
        script.write(actions)
        return script

    def play(self, *scripts: Script, keep_going: bool = False) -> None:
        """Creates an instance for each script, plays the scripts in turn by parts, then frees the instances.

        Raises CallError for a call that fails, unless `keep_going`, and where the FMU returns no instance;
        NotJudgedError where it discards a step.
        """
        self._play([scripts], keep_going)
        failure = next(filter(None, (script.failure for script in scripts)), None)
        if failure is None or keep_going:
            return
        if failure.reason or (failure.is_step and failure.status == DISCARD):
            raise DiscardedStepError(failure.reason or f"the FMU discards {failure.function}")
        raise CallError(failure.problem, failure.status, failure)

    def play_each(self, scripts: Sequence[Script]) -> None:
        """Plays scripts one after the other; an instance is freed before the next is created.

        A call that fails ends nothing. Raises CallError where the FMU returns no instance.
        """
        self._play([[script] for script in scripts], keep_going=True)

    def _play(self, groups: Sequence[Sequence[Script]], keep_going: bool) -> None:
        """Plays groups of scripts one after the other in one message, scripts of one group side by side."""
        self.under_way = groups
        turns = list[tuple[Script, int, Call]]()  # with the part of a script
        answers = list[Any]()
        for scripts in groups:
            pairs = [(script, next(self._instances)) for script in scripts]
            turns += [(script, 0, ("create", number, script.options)) for script, number in pairs]
            turns += [
                (script, part, ("play", number, script.part(part), keep_going))
                for part in range(max(len(script.parts) for script in scripts))
                for script, number in pairs
                if script.part(part)
            ]
            turns += [(script, 0, ("free", number)) for script, number in pairs]
            if self.process.one_instance or scripts is groups[-1]:
                answers += self.process.calls([call for *_, call in turns[len(answers) :]])
        for (script, part, (method, *_)), answer in zip(turns, answers, strict=True):
            if method == "create" and not answer[0]:
                raise refusal([Message(*message) for message in answer[1]])
            script.take(method, part, answer)
        all_scripts = [script for scripts in groups for script in scripts]
        for script in all_scripts:
            self._note(script)
        for script in all_scripts:
            if failure := script.failure:
                self.shared.failed.setdefault(failure.problem, failure)
                self._judge_failure(script, failure)

    def _judge_failure(self, script: Script, failure: Reply) -> None:
        """Raises NotJudgedError for a call that fails for a licence or is known to fail, and for a step that
        the FMU may refuse: it refuses the usual size, discards one of them, or is used beyond the
        stop time of its default experiment.
        """
        if lacks_licence(failure.logged):
            raise NotJudgedError(failure.problem)
        if rule := self.shared.failing.get((failure.function, failure.state)):
            raise NotJudgedError(f"{failure.function} fails, as {rule} reports")
        if failure.is_step:
            _, t, h, *_ = script.calls[script.replies.index(failure)]
            is_beyond = t + h > self.stop_time + 1e-9 * max(abs(t), h)
            reasons = (
                self.shared.refused_steps,
                self.shared.discards if failure.status == DISCARD else "",
                "the FMU refuses steps beyond the stop time of its DefaultExperiment" if is_beyond else "",
            )
            for reason in filter(None, reasons):
                raise NotJudgedError(reason)

    def _note(self, script: Script) -> None:
        """Notes messages and refusals of a script with logging."""
        if script.is_forbidden or not script.options.get("logging"):
            return
        for reply in script.replies:
            if reply.status and not reply.reason:
                key = reply.function, reply.status, bool(reply.messages)
                self.shared.refusals.setdefault(key, reply)
            # logging may be off after it
            if reply.function == "fmi2SetDebugLogging":
                break
        log, name = self.shared.log, script.options.get("name", USUAL_NAME)
        is_usual = not {"callbacks", "overwritten"} & {*script.options}
        heard = ((reply, m) for reply in script.everything for m in reply.messages)
        for reply, message in heard if is_usual else ():
            if len(log) < _MOST_MESSAGES:
                log.setdefault(replace(message, given_name=name), reply)

    def play_once(self, scripts: Sequence[Script]) -> None:
        """Plays scripts as `play_each`; those with the calls of one that was played so have its answers."""
        known = self.shared.played
        # version 2 has the same bytes for equal data, and writes numbers faster than `repr`
        keys = [marshal.dumps((script.options, script.calls), 2) for script in scripts]
        new = {key: script for key, script in zip(keys, scripts, strict=True) if key not in known}
        if new:
            self.play_each(list(new.values()))
            known |= new
        for key, script in zip(keys, scripts, strict=True):
            if script is not known[key]:
                script.take("play", 0, known[key].answers)

    def creates(self, **options: Any) -> tuple[bool, list[Message]]:
        """Whether the FMU creates an instance, which is freed again, and its messages."""
        number = next(self._instances)
        (created, messages, *_), _ = self.process.calls(
            [("create", number, {**self._options, **options}), ("free", number)]
        )
        return created, [Message(*message) for message in messages]

    def once(self, name: str, make: Callable[[], T], *of: object) -> T:
        """Returns the result of `make`, made once for all rules; NotJudgedError for the next if it failed.

        NotApplicableError and NotJudgedError are raised again for every rule. of: distinguishes results of
        one name.
        """
        results, key = self.shared.results, f"{name} {of}"
        if key not in results:
            results[key] = NotJudgedError(f"no {name}: a rule before did not finish that")
            try:
                results[key] = make()
            except (NotApplicableError, NotJudgedError) as reason:
                results[key] = reason
        if isinstance(results[key], NotApplicableError | NotJudgedError):
            raise results[key]
        return results[key]

    def point(self, i: float) -> float:
        """Returns the time of communication point number i [s]."""
        return self.start_time + i * self.step_size

    def grouped(self, variables: Iterable[Variable]) -> Groups:
        """Returns variables as `script.grouped` does; the same ones are grouped once for all rules."""
        key = tuple(variables)
        if key not in self._groups:
            self._groups[key] = grouped(key)
        return self._groups[key]

    @cached_property
    def outputs(self) -> list[Variable]:
        return [v for v in self.fmu.variables if v.causality == "output"]


def lacks_licence(text: str) -> bool:
    """Whether a text speaks of a licence: a call that fails for one says nothing about the FMU's code."""
    return _LICENCE.search(text) is not None


def refusal(messages: Sequence[Message]) -> Exception:
    """Returns the error of fmi2Instantiate that returned NULL, with the FMU's messages; NotJudgedError if it
    lacks a licence.
    """
    text = "; ".join(filter(None, (message.text.strip() for message in messages)))
    cause = "the GUID of the library is another one" if "guid" in text.lower() else ""
    logged = f"the FMU logged: {text}" if text else "it logged nothing"
    reason = "; ".join(filter(None, [f"{NO_INSTANCE}: expected an instance", cause, logged]))
    return NotJudgedError(reason) if lacks_licence(text) else CallError(reason)
