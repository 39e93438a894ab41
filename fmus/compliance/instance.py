"""The instance that behaviour rules call: each status is checked, memory is counted."""

import ctypes
import time
from collections.abc import Iterable, Sequence
from typing import Any

from fmpy.fmi2 import fmi2DoStepStatus, fmi2Integer, fmi2Real, fmi2Status

from fmus.binding import ELEMENTS, PENDING, WARNING, BoundInstance, reference_array, status_name
from fmus.compliance.variable import Variable


class CallError(Exception):
    """A call that did not succeed; names the call, its status and the messages that the FMU logged."""


class CheckedInstance(BoundInstance):
    """An instance between `instantiate` and `free`; a call that does not succeed raises CallError."""

    def check_status(self, function: str, status: int) -> None:
        messages = "; ".join(message for _, message in self.log) or "it logged nothing"
        self.log.clear()
        if status == PENDING and function == "fmi2DoStep":
            self._wait()
        elif status > WARNING:
            raise CallError(f"{function} returned {status_name(status)}: expected ok; {messages}")

    def _wait(self) -> None:
        """Wait until a pending step has ended; the time limit of the rule ends a wait without end."""
        status = fmi2Status(PENDING)
        while status.value == PENDING:
            time.sleep(0.001)
            self.call("fmi2GetStatus", fmi2DoStepStatus, ctypes.byref(status))
        if status.value > WARNING:
            raise CallError(f"the pending step ended with {status_name(status.value)}: expected ok")

    def get(self, variables: Iterable[Variable]) -> dict[str, Any]:
        """Name -> value, of numbers and Booleans."""
        values = {}
        for kind, members in _grouped(variables).items():
            read = self.get_values(kind, [v.reference or 0 for v in members])
            values.update({v.name: value for v, value in zip(members, read, strict=True)})
        return values

    def set(self, variable: Variable, value: float) -> None:
        self.set_values(variable.base_kind, [variable.reference or 0], [value])

    def initialise(self, start: float = 0.0) -> None:
        """Set the experiment up and enter initialization mode."""
        self.set_up_experiment(start)
        self.enter_initialization_mode()

    def enter_step_mode(self, start: float = 0.0) -> None:
        """Initialise, up to where steps are allowed."""
        self.initialise(start)
        self.exit_initialization_mode()

    def do_step(self, t: float, h: float) -> None:
        """Advance from t to t + h seconds."""
        self.call("fmi2DoStep", t, h, 0)

    def directional_derivatives(self, unknowns: Sequence[Variable], known: Variable) -> list[float]:
        """Derivatives of the unknowns with respect to one known."""
        result = (fmi2Real * len(unknowns))()
        seed = (fmi2Real * 1)(1.0)
        arguments = (_references(unknowns), len(unknowns), _references([known]), 1, seed, result)
        self.call("fmi2GetDirectionalDerivative", *arguments)
        return list(result)

    def set_input_derivative(self, variable: Variable, order: int, value: float) -> None:
        arguments = (_references([variable]), 1, (fmi2Integer * 1)(order), (fmi2Real * 1)(value))
        self.call("fmi2SetRealInputDerivatives", *arguments)

    def output_derivatives(self, variables: Sequence[Variable], order: int) -> list[float]:
        count = len(variables)
        result = (fmi2Real * count)()
        orders = (fmi2Integer * count)(*[order] * count)
        self.call("fmi2GetRealOutputDerivatives", _references(variables), count, orders, result)
        return list(result)

    def free(self) -> None:
        if self.handle is not None:
            self.status("fmi2FreeInstance")
            self.handle = None
        self.callbacks.close()


def _references(variables: Sequence[Variable]) -> Any:
    return reference_array([v.reference or 0 for v in variables])


def _grouped(variables: Iterable[Variable]) -> dict[str, list[Variable]]:
    groups: dict[str, list[Variable]] = {}
    for v in variables:
        if v.base_kind in ELEMENTS and v.reference is not None:
            groups.setdefault(v.base_kind, []).append(v)
    return groups
