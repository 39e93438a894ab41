"""The FMU that behaviour rules examine: its instances are created and stepped, in a process of its own."""

import itertools
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fmus.binding import ELEMENTS
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.instance import CallError, call_fmu
from fmus.compliance.variable import Variable, number
from fmus.process import WorkerProcess

Call = tuple[Any, ...]  # a method and its arguments


class FmuProcess:
    """The process that calls the FMU.

    deadline: of its answers, in `time.monotonic`; TimeoutError after that, ProcessEndedError after its end
    """

    def __init__(self, library: Path, resources: Path, deadline: float) -> None:
        self.deadline = deadline
        self._numbers = itertools.count()
        self._process = WorkerProcess(call_fmu, trusted=False)
        self._process.send((self._process.folder, library, resources))

    def calls(self, calls: Sequence[Call]) -> list[Any]:
        """The results of calls of `LoadedFmu`. Raises CallError for the first that fails."""
        expected = next(self._numbers)
        self._process.send((expected, calls))
        answer = self._process.receive(max(0.0, self.deadline - time.monotonic()))
        match answer:
            case [int(got), [*results], None] if got == expected and len(results) == len(calls):
                return results
            case [int(got), [*_], str(error)] if got == expected:
                raise CallError(error)
        raise CallError(f"the process of the FMU sent {str(answer)[:100]!r}: expected results of the calls")

    def close(self) -> None:
        self._process.close()


class Instance:
    """An instance in the process of the FMU; a call that does not succeed raises CallError."""

    def __init__(self, process: FmuProcess, number: int) -> None:
        self._process, self._number = process, number

    def _ask(self, method: str, *arguments: Any) -> Any:
        return self._process.calls([("of", self._number, method, *arguments)])[0]

    def values_after(
        self, actions: Sequence[Sequence[Call]], variables: Iterable[Variable]
    ) -> list[dict[str, Any]]:
        """Name -> value of numbers and Booleans, after each of several sequences of calls."""
        groups = _grouped(variables)
        reads = [("get", kind, _references(members)) for kind, members in groups.items()]
        calls = [("of", self._number, *call) for action in actions for call in (*action, *reads)]
        results = iter(self._process.calls(calls))
        rows = []
        for action in actions:
            for _ in action:
                next(results)
            read = [(members, next(results)) for members in groups.values()]
            rows.append({v.name: x for members, values in read for v, x in zip(members, values, strict=True)})
        return rows

    def get(self, variables: Iterable[Variable]) -> dict[str, Any]:
        """Name -> value, of numbers and Booleans."""
        (row,) = self.values_after([()], variables)
        return row

    def set(self, variable: Variable, value: float) -> None:
        self._ask(*set_call(variable, value))

    def call(self, function: str) -> None:
        """Call a function of FMI that has no argument but the instance."""
        self._ask("call", function)

    def initialise(self, start: float = 0.0) -> None:
        """Set the experiment up and enter initialization mode."""
        self._ask("set_up_experiment", start)
        self._ask("enter_initialization_mode")

    def exit_initialization_mode(self) -> None:
        self._ask("exit_initialization_mode")

    def enter_step_mode(self, start: float = 0.0) -> None:
        """Initialise, up to where steps are allowed."""
        self.initialise(start)
        self.exit_initialization_mode()

    def do_step(self, t: float, h: float) -> None:
        """Advance from t to t + h seconds."""
        self._ask("do_step", t, h)

    def directional_derivatives(self, unknowns: Sequence[Variable], known: Variable) -> list[float]:
        """Derivatives of the unknowns with respect to one known."""
        return self._ask("directional_derivatives", _references(unknowns), known.reference or 0)

    def set_input_derivative(self, variable: Variable, order: int, value: float) -> None:
        self._ask("set_input_derivative", variable.reference or 0, order, value)

    def output_derivatives(self, variables: Sequence[Variable], order: int) -> list[float]:
        return self._ask("output_derivatives", _references(variables), order)

    def get_fmu_state(self, state: int | None = None) -> int:
        """The FMU's state as it is now; the saved state that is given, if any, is overwritten."""
        return self._ask("get_fmu_state", state)

    def set_fmu_state(self, state: int) -> None:
        self._ask("set_fmu_state", state)

    def free_fmu_state(self, state: int) -> int | None:
        """Free a saved state; returns the address that is left."""
        return self._ask("freed_fmu_state", state)

    def serialize_fmu_state(self, state: int) -> bytes:
        return bytes.fromhex(self._ask("serialize_fmu_state", state))

    def deserialize_fmu_state(self, content: bytes) -> int:
        return self._ask("deserialize_fmu_state", content)

    def free(self) -> None:
        self._ask("free")


class Probe:
    """An unpacked FMU in a process of its own.

    start_time, step_size: of the default experiment [s]
    """

    def __init__(self, fmu: FmuFile, folder: Path, deadline: float) -> None:
        self.fmu = fmu
        self.process = FmuProcess(folder / fmu.host_library, folder / "resources", deadline)
        self._instances = itertools.count(1)
        experiment = fmu.root.find("DefaultExperiment")
        get = experiment.get if experiment is not None else {}.get
        self.start_time = number(get("startTime")) or 0.0
        span = (number(get("stopTime")) or self.start_time + 1.0) - self.start_time
        self.step_size = number(get("stepSize")) or span / 1000

    def ask(self, method: str, *arguments: Any) -> Any:
        """The result of a method of `LoadedFmu`."""
        return self.process.calls([(method, *arguments)])[0]

    @contextmanager
    def instance(self) -> Iterator[Instance]:
        """An instance that is freed afterwards; CallError if the FMU returns none."""
        instance = Instance(self.process, number := next(self._instances))
        try:
            if not self.ask("create", number, self.fmu.guid):
                raise CallError("fmi2Instantiate returned NULL: expected an instance")
            yield instance
        finally:
            instance.free()

    def accepts(self, guid: str) -> bool:
        """Whether the FMU creates an instance for a GUID."""
        instance = Instance(self.process, number := next(self._instances))
        accepted = self.ask("create", number, guid)
        instance.free()
        return accepted

    def run(self, instance: Instance, steps: int, first: int = 0) -> list[dict[str, Any]]:
        """Outputs after each of some steps from communication point number `first`."""
        points = [self.start_time + i * self.step_size for i in range(first, first + steps)]
        return instance.values_after([[("do_step", t, self.step_size)] for t in points], self.outputs)

    @property
    def outputs(self) -> list[Variable]:
        return [v for v in self.fmu.variables if v.causality == "output"]

    def real(self, causality: str) -> list[Variable]:
        """The Real variables of a causality."""
        return [v for v in self.fmu.variables if v.causality == causality and v.kind == "Real"]


def set_call(variable: Variable, value: float) -> Call:
    """The call that sets a variable."""
    return "set", variable.base_kind, _references([variable]), [value]


def _references(variables: Sequence[Variable]) -> list[int]:
    return [v.reference or 0 for v in variables]


def _grouped(variables: Iterable[Variable]) -> dict[str, list[Variable]]:
    groups: dict[str, list[Variable]] = {}
    for v in variables:
        if v.base_kind in ELEMENTS and v.reference is not None:
            groups.setdefault(v.base_kind, []).append(v)
    return groups
