"""Calls on one instance of an FMU, written down first and played in one message."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from fmus.compliance.rule import NotJudgedError
from fmus.compliance.texts import STEPS, VECTORS, unpacked
from fmus.compliance.variable import Variable
from fmus.errors import listed
from fmus.fmi.binding import WARNING, status_name

KINDS = ("Real", "Integer", "Boolean", "String")
SETTERS = tuple(f"fmi2Set{kind}" for kind in KINDS)
_LEAST_CPU_TIME = 1e-6  # s, finer than any clock of a process
STATES = {  # function -> state that it leads to; `actions` has the states of other calls
    "fmi2EnterInitializationMode": "initialization mode", "fmi2EnterEventMode": "event mode",
    "fmi2EnterContinuousTimeMode": "continuous-time mode", "fmi2Terminate": "terminated",
    "fmi2Reset": "instantiated",
}  # fmt: skip
_MODES = {  # function -> mode of model exchange that it leads to
    "fmi2ExitInitializationMode": "event mode", "fmi2EnterEventMode": "event mode",
    "fmi2EnterContinuousTimeMode": "continuous-time mode",
    "fmi2CompletedIntegratorStep": "continuous-time mode after a completed step",
}  # fmt: skip


class CallError(Exception):
    """A call that did not succeed; names the call, its status and the messages that the FMU logged."""

    def __init__(self, message: str, status: int | None = None, reply: "Reply | None" = None) -> None:
        super().__init__(message)
        self.status, self.reply = status, reply


class DefectError(Exception):
    """A call that this checker made wrongly, not the FMU."""


@dataclass(frozen=True)
class Message:
    """A message of the FMU.

    right_environment: whether it came with the environment of its instance; given_name: of its instance
    """

    status: int
    text: str
    instance: str | None
    category: str | None
    right_environment: bool = True
    given_name: str = ""


@dataclass(slots=True)
class Reply:
    """Reply to a call; `status` stays None until the call was made.

    function: of FMI, the latest that the call has called
    reason: why a step for model exchange is discarded although no call failed
    words: for the variables that it sets or reads, in messages; script: whose call it replies to
    """

    function: str
    state: str
    status: int | None = None
    value: Any = None
    messages: Sequence[Message] = ()
    changed: Sequence[Sequence[str]] = ()
    is_step: bool = False
    reason: str = ""
    words: str = ""
    script: Any = field(default=None, repr=False, compare=False)

    @property
    def ok(self) -> bool:
        return self.status is not None and 0 <= self.status <= WARNING

    @property
    def status_name(self) -> str:
        return "was not called" if self.status is None else f"returned {status_name(self.status)}"

    @property
    def logged(self) -> str:
        texts = dict.fromkeys(" ".join(m.text.split()) for m in self.messages)
        return "; ".join(texts) or "it logged nothing"

    @property
    def problem(self) -> str:
        """Problem of the call, or of a step of many calls none of which failed, in words."""
        pending = "fmi2DoStep returned pending, then " * (self.is_step and self.function == "fmi2GetStatus")
        what = f"{pending}{self.function}{self.words} {self.status_name}"
        return self.reason or f"{what}: expected ok; {self.logged}"


@cache
def _elements(function: str, count: int) -> list[Variable]:
    """Returns the elements of a vector of model exchange, with names for messages."""
    names = (f"element {i} of {function}" for i in range(1, count + 1))
    return [Variable(0, {"name": name}, "", {}, {}) for name in names]


Groups = dict[str, tuple[list[Variable], list[int], str]]


def grouped(variables: Iterable[Variable]) -> Groups:
    """Returns type -> variables that a function of this type reads, their references, and words for them."""
    groups: dict[str, list[Variable]] = {}
    for v in variables:
        if v.base_kind in KINDS and v.reference is not None:
            groups.setdefault(v.base_kind, []).append(v)
    return {
        kind: (some, [v.reference or 0 for v in some], f" of {listed([str(v.name) for v in some], 1)}")
        for kind, some in groups.items()
    }


class Reading:
    """Values of variables at a place of a script; `values` after it was played."""

    def __init__(self, groups: dict[str, list[Variable]], replies: dict[str, Reply]) -> None:
        self.groups, self.replies = groups, replies

    @property
    def ok(self) -> bool:
        return all(reply.ok for reply in self.replies.values())

    @property
    def values(self) -> dict[str, Any]:
        """Name -> value of each variable; Strings as bytes, None for NULL."""
        result = dict[str, Any]()
        for kind, members in self.groups.items():
            read = self.replies[kind].value
            if kind == "String":
                read = [bytes.fromhex(text) if isinstance(text, str) else text for text in read]
            result.update(zip([v.name for v in members], read, strict=True))
        return result

    def equals(self, other: "Expected") -> bool:
        """Whether another reading has the same variables and values, which is quicker than to name each."""
        if isinstance(other, dict) or self.groups != other.groups:
            return False
        return all(self.replies[kind].value == other.replies[kind].value for kind in self.groups)


Expected = Reading | dict[str, Any]
"""A reading, or the values that variables should have, by their names."""
Action = Callable[["Script"], object]


class Script:
    """Calls on a new instance, in the order in which they are written down.

    creation, end: of the instance
    is_forbidden: whether it makes calls that FMI forbids, or with arguments that it forbids
    expected, observed: readings to be compared; the latter with words for when and where
    ignored: calls whose failure is ignored
    errors: calls that return error, each with words for a finding if it does not, and what it may return
    lead: actions that lead `start` from the first communication point to where runs begin
    has_started: whether `start` was written
    next_step: start of the next step, in steps of the usual size; saved: slot -> that number and the state
    """

    def __init__(self, probe: Any, options: dict[str, Any]) -> None:
        self.probe, self.options = probe, options  # a `Probe`, whose module imports this one
        self.calls: list[tuple[Any, ...]] = []
        self.replies: list[Reply] = []
        self.creation = Reply("fmi2Instantiate", "", script=self)
        self.end = Reply("fmi2FreeInstance", "", script=self)
        self.is_forbidden = False
        self.state = "instantiated"
        self.parts = [0]
        self.next_step: float = 0
        self.saved: dict[int, tuple[float, str]] = {}
        self.expected: list[Expected] = []
        self.observed: list[tuple[str, str, Reading]] = []
        self.ignored: list[Reply] = []
        self.errors: list[tuple[Reply, str, Sequence[int]]] = []
        self.lead: Sequence[Action] = ()
        self.has_started = False
        self.answers: Sequence[Any] = ()  # to the calls of the last part

    # writing

    def write(self, actions: Iterable[Action]) -> list[Reply]:
        """Adds the calls of some actions; returns their replies to be."""
        first = len(self.replies)
        for action in actions:
            action(self)
        return self.replies[first:]

    def part(self, index: int) -> list[tuple[Any, ...]]:
        """Returns the calls of a part; none if there are fewer parts."""
        ends = [*self.parts[1:], len(self.calls)]
        return self.calls[self.parts[index] : ends[index]] if index < len(self.parts) else []

    def call(self, method: str, *arguments: Any) -> Reply:
        """Adds a call of a function of FMI, or of a method of `CalledInstance`; lists become arrays."""
        reply = Reply("", self.state, is_step=method in STEPS, script=self)
        self.calls.append((method, *arguments))
        self.replies.append(reply)
        self.state = STATES.get(method, self.state)
        return reply

    def set(self, variable: Variable, value: Any) -> Reply:
        content = value.encode().hex() if isinstance(value, str) else value
        reply = self.call(f"fmi2Set{variable.base_kind}", [variable.reference or 0], 1, [content])
        reply.words = f" of {variable.name}"
        return reply

    def read(self, variables: Iterable[Variable]) -> Reading:
        known = self.probe.grouped(variables)
        replies = {kind: self.call("get", kind, references) for kind, (_, references, _) in known.items()}
        for kind, (_, _, words) in known.items():
            replies[kind].words = words
        return Reading({kind: members for kind, (members, *_) in known.items()}, replies)

    def read_everything(self) -> Reading:
        """Adds a reading of all variables, and of the vectors that model exchange has."""
        reading = self.read(self.probe.fmu.variables)
        vectors = self.read_vectors(VECTORS if self.probe.fmu.is_model_exchange else ())
        return Reading(reading.groups | vectors.groups, reading.replies | vectors.replies)

    def read_vectors(self, functions: Iterable[str]) -> Reading:
        """Adds a reading of the vectors of model exchange that have elements."""
        reading = Reading({}, {})
        for function in functions:
            if count := self.probe.fmu.vector_length(function):
                reading.groups[function] = _elements(function, count)
                reading.replies[function] = self.call("vector", function)
        return reading

    @property
    def time(self) -> float:
        """Start time of the next step [s]."""
        return self.probe.point(self.next_step)

    # playing

    def play(self, keep_going: bool = False) -> "Script":
        """Plays it alone; raises as `Probe.play` does."""
        self.probe.play(self, keep_going=keep_going)
        return self

    def take(self, method: str, part: int, answers: Sequence[Any]) -> None:
        """Takes the observations while the instance was created, freed, or played a part of the calls."""
        if method != "play":
            reply = self.creation if method == "create" else self.end
            reply.value, messages, reply.changed = answers
            reply.messages = [Message(*message) for message in messages]
            return
        self.answers = answers
        first = self.parts[part]
        for call, reply, answer in zip(self.calls[first:], self.replies[first:], answers, strict=False):
            if not answer:
                continue
            try:
                if call[:2] == ("get", "Real") and isinstance(answer[1], str):
                    # another script with the same calls has the same numbers
                    answer[1] = unpacked(answer[1])
                status, reply.value, messages, changed, function, mode = answer
                reply.function = str(function)
                # a step for model exchange is many calls
                if status and self.probe.fmu.is_model_exchange:
                    reply.state = _MODES.get(mode, reply.state)
                if status and (self.probe.fmu.is_model_exchange or self.probe.fmu.fmi == 3):
                    reply.reason = reply.value if isinstance(reply.value, str) else ""
                reply.status, reply.changed = int(status), changed or ()
                reply.messages = tuple(Message(*message) for message in messages)
            except (TypeError, ValueError):
                # the FMU controls the process that answers
                raise CallError(f"the process of the FMU answers {str(answer)[:100]!r}") from None

    @property
    def everything(self) -> list[Reply]:
        """All replies, from the creation of the instance to its end."""
        return [self.creation, *self.replies, self.end]

    @property
    def readings(self) -> list[Reading]:
        """Readings to be compared."""
        return [reading for *_, reading in self.observed]

    @property
    def succeeded(self) -> bool:
        """Whether every call was made and none failed."""
        return all(reply.ok for reply in self.replies)

    @property
    def cpu_time(self) -> float:
        """CPU time of the FMU's process [s] from the first to the last call "cpu_time"."""
        asked = zip(self.calls, self.replies, strict=True)
        times = [reply.value for (method, *_), reply in asked if method == "cpu_time" and reply.ok]
        return max(times[-1] - times[0], _LEAST_CPU_TIME) if times else _LEAST_CPU_TIME

    @property
    def failure(self) -> Reply | None:
        """The first failed call, except ignored calls and calls that should return error."""
        excused = {id(reply) for reply in (*self.ignored, *(reply for reply, *_ in self.errors))}
        failed = (reply for reply in self.replies if reply.status is not None and not reply.ok)
        return next((reply for reply in failed if id(reply) not in excused), None)

    def replies_of(self, function: str) -> list[Reply]:
        """Returns the replies of a function. Raises NotJudgedError if any call has failed."""
        if not self.succeeded:
            raise NotJudgedError(f"a run with {function} fails")
        return [reply for reply in self.replies if reply.function == function]

    @property
    def content(self) -> str:
        """The bytes of the state that was serialised, as hexadecimal digits."""
        return self.replies_of("fmi2SerializeFMUstate")[-1].value[0]
