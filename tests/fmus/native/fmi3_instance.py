"""An FMU of FMI 3.0 led through FMPy, its variables by name."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.simulation import instantiate_fmu

from fmus.block import Block
from fmus.generate.describe import arrays

STATUSES = ("ok", "warning", "discard", "error", "fatal")
_FUNCTIONS = {"Enumeration": "Int64"}


class Fmi3Instance:
    """An instance for co-simulation or model exchange; messages as (status, category, text)."""

    def __init__(
        self, path: Path, folder: Path, interface: str = "CoSimulation", logging: bool = True, **options: Any
    ) -> None:
        self.description: Any = fmpy.read_model_description(str(path))
        fmpy.extract(str(path), folder)
        self.variables: dict[str, Any] = {v.name: v for v in self.description.modelVariables}
        self.log: list[tuple[str, str, str]] = []
        self.fmu: Any = instantiate_fmu(
            str(folder), self.description, interface, debug_logging=logging, logger=self._message, **options
        )

    def _message(self, environment: Any, status: int, category: bytes, text: bytes) -> None:
        self.log.append((STATUSES[status], category.decode(), text.decode()))

    def begin(self, t: float = 0.0, stop_time: float | None = None) -> "Fmi3Instance":
        self.fmu.enterInitializationMode(startTime=t, stopTime=stop_time)
        self.fmu.exitInitializationMode()
        return self

    def reference(self, name: str) -> int:
        return self.variables[name].valueReference

    def size(self, name: str) -> int:
        return int(np.prod([int(d.start) for d in self.variables[name].dimensions]))

    def __getitem__(self, name: str) -> list[Any]:
        return self._function("get", name)([self.reference(name)], self.size(name))

    def __setitem__(self, name: str, values: Sequence[Any]) -> None:
        self._function("set", name)([self.reference(name)], values)

    def _function(self, verb: str, name: str) -> Callable[..., Any]:
        kind: str = self.variables[name].type
        return getattr(self.fmu, verb + _FUNCTIONS.get(kind, kind))

    def status(self, call: str, *arguments: Any) -> str:
        """Returns what a method of FMPy gives: ok, or the status that FMPy raises."""
        try:
            getattr(self.fmu, call)(*arguments)
        except FMICallException as error:
            return STATUSES[error.status]
        return "ok"

    def refused(self, call: str, *arguments: Any, status: str = "error") -> str:
        """Returns the only message of a call that is refused."""
        self.log.clear()
        assert self.status(call, *arguments) == status
        ((logged, category, text),) = self.log
        assert (logged, category) == (status, f"logStatus{status.capitalize()}")
        return text


def scalars(fmu: Fmi3Instance, block: Block, causality: str) -> list[Any]:
    names = [name for name, *_ in arrays(block.of_causality(causality))]
    return [value for name in names for value in fmu[name]]
