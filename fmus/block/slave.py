"""Slave that PythonFMU's binary calls in an FMU of the python flavour.

The binary turns any exception into fmi2Fatal and drops the instance, so no exception leaves this class. A
refused call is logged as an error and leaves the state as it was. The binary cannot return fmi2Error for it.
So every step is discarded until the value is corrected, and one step for a call that cannot be corrected
(setting an output, an unknown value reference).
"""

import math
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partialmethod
from typing import Any, ClassVar

from pythonfmu.enums import Fmi2Status
from pythonfmu.fmi2slave import Fmi2Slave

from fmus.block import Block
from fmus.block.instance import BlockError, BlockInstance
from fmus.fmi.variable_types import types_of_transfer


class BlockSlave(Fmi2Slave):
    """A block behind PythonFMU's interface; a subclass names the block, its fingerprint and how it runs."""

    block: Block
    instance_class: ClassVar[type[BlockInstance]] = BlockInstance
    fingerprint: ClassVar[str]

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        # The binary has put the resources first on the path, to find this module alone.
        with suppress(ValueError):
            sys.path.remove(str(self.resources))
        self._instance = self.instance_class(self.block, self.fingerprint)
        self._refused: dict[object, str] = {}

    def setup_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        self._attempt("start", self._instance.start, start_time, stop_time)

    def exit_initialization_mode(self) -> None:
        self._attempt("initialisation", self._instance.exit_initialization_mode)

    def do_step(self, current_time: float, step_size: float) -> bool:
        if self._refused:
            self._error("step refused until this is put right: " + "; ".join(self._refused.values()))
            self._refused = {
                what: why
                for what, why in self._refused.items()
                if not isinstance(what, int) or self._instance.can_be_set(what)
            }
            return False
        try:
            self._instance.do_step(current_time, step_size)
        except Exception as error:
            self._error(str(error))
            return False
        return True

    def _get(self, vrs: list[int], types: tuple[str, ...]) -> list[Any]:
        try:
            self._check_types(vrs, types)
            return [self._instance.get(reference) for reference in vrs]
        except Exception as error:
            self._error(str(error))
            return [math.nan if types == ("Real",) else 0] * len(vrs)

    def _set(self, vrs: list[int], values: list[Any], types: tuple[str, ...]) -> None:
        for reference, value in zip(vrs, values, strict=True):
            self._attempt(reference, self._set_one, reference, value, types)

    def _set_one(self, reference: int, value: Any, types: tuple[str, ...]) -> None:
        self._check_types([reference], types)
        self._instance.set(reference, value)

    def _check_types(self, vrs: list[int], types: tuple[str, ...]) -> None:
        for variable in map(self._instance.variable, vrs):
            if variable.type not in types:
                raise BlockError(f"{variable.name} is {variable.type}: expected {' or '.join(types)}")

    get_real: Any = partialmethod(_get, types=("Real",))
    get_integer: Any = partialmethod(_get, types=types_of_transfer("Integer"))
    get_boolean: Any = partialmethod(_get, types=("Boolean",))

    def get_string(self, vrs: list[int]) -> list[str]:
        return [str(value) for value in self._get(vrs, ("String",))]

    set_real: Any = partialmethod(_set, types=("Real",))
    set_integer: Any = partialmethod(_set, types=types_of_transfer("Integer"))
    set_boolean: Any = partialmethod(_set, types=("Boolean",))
    set_string: Any = partialmethod(_set, types=("String",))

    def _get_fmu_state(self) -> Any:
        try:
            return self._instance.snapshot()
        except Exception as error:
            self._error(str(error))
            return ""

    def _set_fmu_state(self, state: Any) -> None:
        if self._attempt("state", self._instance.restore, state):
            self._refused.clear()

    @staticmethod
    def _fmu_state_to_bytes(state: Any) -> bytes:
        return state.encode("utf-8")

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> Any:
        return state.decode("utf-8", errors="replace")

    def _attempt(self, what: object, action: Callable[..., Any], *arguments: Any) -> bool:
        try:
            action(*arguments)
        except Exception as error:
            self._refused[what] = str(error)
            self._error(str(error))
            return False
        self._refused.pop(what, None)
        return True

    def _error(self, message: str) -> None:
        # the binary hands the message to the importer's logger as a printf format
        self.log(message.replace("%", "%%"), Fmi2Status.error)
