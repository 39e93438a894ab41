"""A block that runs: values, modes, checks and snapshots, without any FMI library.

FMUs of the python flavour execute it, and tests step it directly. A method that fails raises `BlockError` and
leaves the instance as it was.
"""

import json
import math
import sys
from itertools import accumulate
from typing import Any

from fmus.block import Block
from fmus.block.scalars import flatten, unflatten
from fmus.block.variables import BlockVariable, Value

# version of the serialised snapshot
_FORMAT = 1
_MOST_INTERNAL_STEPS = 1e9


def internal_steps(h: float, longest: float) -> int:
    """Returns how many equal internal steps a step of h [s] has; longest: parameter `internal_step` [s].

    Raises BlockError for more than an FMU takes. `internal_steps` of fmus/native/instance.h is the same rule.
    """
    quotient = h / longest * (1.0 - 1e-9)
    if quotient > _MOST_INTERNAL_STEPS:
        raise BlockError(
            f"communication step size {h!r} s: expected at most {_MOST_INTERNAL_STEPS:.0e} internal steps"
        )
    return max(1, math.ceil(quotient))


def step_tolerance(t: float, h: float) -> float:
    """Returns the tolerance of a communication point [s]: far less than a step, more than rounding."""
    return min(1e-9 * max(1.0, abs(t)), 1e-3 * h) + 8.0 * sys.float_info.epsilon * abs(t)


def _typed_as(state: Any, scalars: list[float]) -> Any:
    """Returns the scalars in the shape of a state; whole numbers, Booleans and items where it has these."""
    # raises ValueError for another number of scalars
    unflatten(state, scalars)
    pairs = zip(flatten(state), scalars, strict=True)
    return unflatten(state, [type(x)(y) if isinstance(x, int) and y == int(y) else y for x, y in pairs])


class BlockError(ValueError):
    """A call that this instance refuses; the message names the value and the expected one."""


class BlockInstance:
    """One instance of a block between instantiation and termination."""

    def __init__(self, block: Block, fingerprint: str = "") -> None:
        self.block = block
        self.fingerprint = fingerprint
        self.time = 0.0
        self._stop_time = math.inf
        self._values: list[Any] = [v.start for v in block.variables]
        counts = (len(block.of_causality(c)) for c in ("parameter", "calculatedParameter", "input"))
        self._parameters_end, self._calculated_end, self._inputs_end = accumulate(counts)
        self._state: Any = None
        self._stepping = False
        self._parameters: Any = None
        self._calculated: Any = None
        self._inputs: Any = None
        self._parameters_are_stale = self._inputs_are_stale = self._outputs_are_stale = True

    # values

    def get(self, reference: int) -> Any:
        """Returns the value of a variable; an output follows the inputs until stepping begins."""
        if not self.variable(reference).settable:
            self._refresh()
        return self._values[reference]

    def variable(self, reference: int) -> BlockVariable:
        """Returns the variable with this value reference."""
        if not 0 <= reference < len(self.block.variables):
            last = len(self.block.variables) - 1
            raise BlockError(f"value reference {reference}: expected 0..{last} of {self.block.name}")
        return self.block.variables[reference]

    def set(self, reference: int, value: Value) -> None:
        """Sets a parameter or an input; refuses values out of range, not finite, or fixed by now."""
        variable = self.variable(reference)
        reason = self._refusal(variable, value)
        if reason:
            raise BlockError(reason)
        value, before = variable.cast(value), self._values[reference]
        # 0.0 equals -0.0, which atan2 and a quotient distinguish
        if (value, math.copysign(1.0, value)) != (before, math.copysign(1.0, before)):
            self._values[reference] = value
            if reference < self._parameters_end:
                self._parameters_are_stale = True
            else:
                self._inputs_are_stale = True
            self._outputs_are_stale = self._outputs_are_stale or not self._stepping

    def can_be_set(self, reference: int) -> bool:
        """Whether some value would be accepted now."""
        if not 0 <= reference < len(self.block.variables):
            return False
        variable = self.block.variables[reference]
        return self._refusal(variable, variable.start) is None

    def _refusal(self, variable: BlockVariable, value: Value) -> str | None:
        if not variable.settable:
            return f"{variable.name}: cannot be set, its causality is {variable.causality}"
        if self._stepping and variable.variability == "fixed":
            return f"{variable.name}: is fixed, set it before the initialisation ends"
        return variable.refuse(value)

    # modes

    def start(self, time: float, stop_time: float | None = None) -> None:
        """Begins the initialisation at this time [s]; no step goes beyond the stop time, if there is one."""
        if not math.isfinite(time):
            raise BlockError(f"start time {time!r}: expected a finite number of seconds")
        if stop_time is not None and not stop_time > time:
            raise BlockError(f"stop time {stop_time!r} s: expected more than the start time {time!r} s")
        self.time, self._stop_time = time, math.inf if stop_time is None else stop_time
        self._outputs_are_stale = True

    def exit_initialization_mode(self) -> None:
        """Ends the initialisation: the state follows from the parameters and inputs set."""
        self._refresh()
        self._stepping = True

    def do_step(self, t: float, h: float) -> None:
        """Advances from t to t + h [s] in equal internal steps, the inputs held."""
        self._check_step(t, h)
        before = {**self.__dict__, "_values": list(self._values)}
        try:
            self._prepare()
            self._become(t + h, self._advance(t, h))
        except BlockError:
            self.__dict__.update(before)
            raise

    def _check_step(self, t: float, h: float) -> None:
        if not self._stepping:
            raise BlockError(
                "a step before the initialisation has ended: expected exit_initialization_mode first"
            )
        if not (math.isfinite(h) and h > 0.0):
            raise BlockError(f"communication step size {h!r} s: expected more than 0")
        if not (math.isfinite(t) and abs(t - self.time) <= step_tolerance(t, h)):
            raise BlockError(f"communication point {t!r} s: expected {self.time!r}, the current time")
        if not t + h <= self._stop_time + step_tolerance(t, h):
            raise BlockError(f"step to {t + h!r} s: expected at most the stop time {self._stop_time!r} s")

    def _advance(self, t: float, h: float) -> Any:
        """Returns the state after h seconds."""
        count = internal_steps(h, self._parameters.internal_step)
        internal, state, step = h / count, self._state, self.block.advance
        held = self._inputs, self._parameters, self._calculated
        try:
            for i in range(count):
                state = step(t + i * internal, internal, state, *held)
        except (ArithmeticError, ValueError) as error:
            raise BlockError(f"step at {t!r} s: {error}; the state left the range of numbers") from error
        return state

    def _become(self, t: float, state: Any) -> None:
        """Takes over the state at time t with its outputs; BlockError if they are not finite."""
        try:
            outputs = flatten(self.block.output(t, state, self._parameters, self._calculated))
            is_number = all(map(math.isfinite, [*flatten(state), *outputs]))
            reason = None
        except (ArithmeticError, ValueError) as error:
            outputs, is_number, reason = [], False, error
        if not is_number:
            at = f"step to {t!r} s" if self._stepping else f"parameters and inputs of {self.block.name}"
            hint = "any more; take shorter steps" if self._stepping else "at the start"
            cause = f": {reason}" if reason else ""
            raise BlockError(f"{at}: state or outputs are not finite {hint}{cause}") from reason
        outputs = self._in_types(self._inputs_end, outputs)
        self.time, self._state = t, state
        self._values[self._inputs_end :] = outputs
        self._outputs_are_stale = False

    # snapshots

    def snapshot(self) -> str:
        """Returns the whole instance as text; floats survive exactly."""
        if not self._stepping:
            self._refresh()
        origin = {"format": _FORMAT, "fmu": self.fingerprint}
        content = {"time": self.time, "stepping": self._stepping, "values": self._values}
        return json.dumps(origin | content | {"state": flatten(self._state)})

    def restore(self, snapshot: str) -> None:
        """Restores a snapshot; refuses a damaged one and a snapshot of another FMU."""
        try:
            saved = json.loads(snapshot)
            format_and_origin = saved["format"], saved["fmu"]
            if format_and_origin != (_FORMAT, self.fingerprint):
                raise BlockError(f"state of {format_and_origin!r}: expected {(_FORMAT, self.fingerprint)!r}")
            values, time = list(saved["values"]), float(saved["time"])
            stepping, scalars = bool(saved["stepping"]), list(map(float, saved["state"]))
            if not all(map(math.isfinite, [time, *map(float, values)])):
                raise ValueError("a number that is not finite")
        except BlockError:
            raise
        except (ValueError, KeyError, TypeError) as error:
            raise BlockError(f"not a serialised state of {self.block.name}: {error}") from error
        got, expected = (len(values), len(scalars)), (len(self._values), len(self.block.state_variables))
        if got != expected:
            raise BlockError(f"state with {got} values and states: expected {expected}")
        variables = (*self.block.variables, *self.block.state_variables)
        for v, value in zip(variables, [*values, *scalars], strict=True):
            reason = v.refuse(value) if v.settable or v.causality == "local" else None
            if reason:
                raise BlockError(f"state of {self.block.name}: {reason}")
        restored = BlockInstance(self.block, self.fingerprint)
        restored._values = [v.cast(value) for v, value in zip(self.block.variables, values, strict=True)]
        restored.time, restored._stop_time = time, self._stop_time
        saved_values = list(restored._values)
        restored._prepare()
        try:
            restored._state = _typed_as(restored._initial_state(), scalars)
        except ValueError as error:
            raise BlockError(f"state of {self.block.name}: {error}") from error
        restored._values, restored._parameters_are_stale = saved_values, True
        restored._stepping, restored._outputs_are_stale = stepping, not stepping
        self.__dict__.update(restored.__dict__)

    # derived values, each calculated when it is needed and stale

    def _prepare(self) -> None:
        if self._parameters_are_stale:
            parameters = unflatten(self.block.parameters, self._values[: self._parameters_end])
            calculated = self._calculate(parameters)
            scalars = self._in_types(self._parameters_end, flatten(calculated))
            self._parameters, self._calculated = parameters, calculated
            self._values[self._parameters_end : self._calculated_end] = scalars
            self._parameters_are_stale = False
        if self._inputs_are_stale:
            scalars = self._values[self._calculated_end : self._inputs_end]
            self._inputs = unflatten(self.block.inputs, scalars)
            self._inputs_are_stale = False

    def _calculate(self, parameters: Any) -> Any:
        try:
            calculated = self.block.calculate(parameters)
        except (ArithmeticError, ValueError) as error:
            raise BlockError(f"parameters of {self.block.name} contradict each other: {error}") from error
        for holds, expected in self.block.requirements(parameters, calculated):
            if not holds:
                raise BlockError(f"parameters of {self.block.name}: expected {expected}")
        return calculated

    def _in_types(self, first_reference: int, scalars: list[Any]) -> list[Any]:
        """Returns results in the types that are declared, with Python's numbers in place of NumPy's."""
        typed = list(scalars)
        for i, x in enumerate(scalars):
            v = self.block.variables[first_reference + i]
            try:
                typed[i] = v.cast(x)
            except (ArithmeticError, ValueError) as error:
                raise BlockError(f"{v.name} = {x!r}: expected {v.expected}") from error
            if v.type == "Boolean" and typed[i] != x:
                raise BlockError(f"{v.name} = {x!r}: expected {v.expected}")
        return typed

    def _initial_state(self) -> Any:
        try:
            return self.block.initial_state(self.time, self._inputs, self._parameters, self._calculated)
        except (ArithmeticError, ValueError) as error:
            raise BlockError(f"parameters and inputs of {self.block.name}: {error}") from error

    def _refresh(self) -> None:
        """Calculates the outputs before stepping begins; later the last step gives them."""
        if self._outputs_are_stale:
            self._prepare()
            self._become(self.time, self._initial_state())
