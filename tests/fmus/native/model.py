"""What a native FMU must answer: FMI 2.0.5 and the promises of its C layer, once more and independently.

Shares with the FMU only the traced equations of the block, which CasADi evaluates here. Every method is one
FMI call and returns (status, what was written or None); a refused call changes nothing but the mode.
"""

import copy
import math
import sys
from dataclasses import dataclass, field
from functools import cache
from typing import ClassVar

import casadi

from fmus.block import Block
from fmus.block.variables import BlockVariable
from fmus.fmi.variable_types import INTEGER_RANGE, TRANSFER_TYPE
from fmus.generate.derivatives import Sensitivities
from fmus.generate.describe import fmi3_variables
from fmus.generate.trace import Traced

from .session import DISCARD, ENDED, ERROR, LAST_TIME, OK, WARNING, Null

INSTANTIATED, INITIALIZATION, STEPPING = "instantiated", "initialization", "step"
TERMINATED, FAILED = "end", "error"
WRITABLE = (INSTANTIATED, INITIALIZATION, STEPPING)
ALL: tuple[str, ...] = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")
TYPES = {name: transferred[0] for name, transferred in TRANSFER_TYPE.items()}
NO_VARIABLE = 2**32 - 1
Result = tuple[int, list | None]  # status, and what was written
_HIGHEST = sys.float_info.max
_LEAST_WHOLE, _HIGHEST_WHOLE = INTEGER_RANGE  # of an Integer without limits


_traced = cache(Traced)


@cache
def _derivatives(block: Block) -> dict[str, casadi.Function]:
    """Of initialization and step mode; calculated parameters have derivatives in both."""
    modes, size = Sensitivities(_traced(block)), len(block.variables) + len(block.states) + 1
    calculated = {
        v.value_reference: modes.initial.unknown[v.value_reference]
        for v in block.of_causality("calculatedParameter")
    }
    step = modes.step._replace(unknown=calculated | modes.step.unknown)
    return {
        f"{name}_{kind}": mode.derivative(name, size, kind == "adjoint")
        for name, mode in (("initial", modes.initial), ("step", step))
        for kind in ("forward", "adjoint")
    }


@dataclass
class Data:
    """What a saved state holds. `is_held`: outputs are what the last step left, not what the inputs give."""

    values: list[float]
    rates: list[float]
    mode: str = INSTANTIATED
    time: float = 0.0
    is_held: bool = False
    state: list[float] = field(default_factory=list)


class Model:
    """One instance, as it must behave.

    kinds: by type of a variable the letter of the functions that get and set it
    """

    fmi: ClassVar[int] = 2
    kinds: ClassVar[dict[str, str]] = TYPES

    def __init__(self, block: Block, logging: bool) -> None:
        self.block, self._traced = block, _traced(block)
        self._derivatives = _derivatives(block)
        count = {c: len(block.of_causality(c)) for c in ("parameter", "calculatedParameter", "input")}
        self.calculated = slice(count["parameter"], count["parameter"] + count["calculatedParameter"])
        self.inputs = slice(self.calculated.stop, self.calculated.stop + count["input"])
        self.outputs = slice(self.inputs.stop, len(block.variables))
        self.log: set[str] = set(ALL) if logging else set(ALL) - {"logStatusDiscard"}
        self._n_states = self._traced.step.numel_out(0)
        self.reset()

    def reset(self) -> Result:
        starts = [float(v.start) for v in self.block.variables]
        rates = [0.0] * (self.inputs.stop - self.inputs.start)
        self.data = Data(starts, rates, state=[0.0] * self._n_states)
        self.stop = _HIGHEST  # of the setup, whichever state is restored
        return OK, None

    # variables and values

    def reference(self, v: BlockVariable) -> int | None:
        """Returns the value reference; None for an element of an array but the first."""
        return v.value_reference

    def beyond(self) -> int:
        """Returns a value reference after the last one."""
        return len(self.block.variables) + len(self.block.states)

    def scalars(self, references: list[int]) -> list[int]:
        """Returns the value references of the scalars that these variables have."""
        return references

    def count(self, references: list[int]) -> int:
        """Returns how many numbers these variables have."""
        return references.size if isinstance(references, Null) else len(references)

    def get(self, kind: str, references: list[int], out: bool) -> Result:
        if self._is_malformed(kind, references, out):
            return self.refuse()
        if any(not self.is_settable(r) for r in references) and not self._refresh():
            return self.refuse()
        return OK, [self.data.values[r] for r in references]

    def set(self, kind: str, references: list[int], values: list) -> Result:
        is_given = not isinstance(values, Null)
        if self.data.mode not in WRITABLE or self._is_malformed(kind, references, is_given):
            return self.refuse()
        pairs = list(zip(references, values, strict=True)) if references and is_given else []
        for reference, value in pairs:
            variable = self.block.variables[reference]
            late = variable.variability == "fixed" and self.data.mode == STEPPING
            if not self.is_settable(reference) or late:
                return self.refuse()
            if not self.is_acceptable(reference, value):
                is_parameter = reference < self.inputs.start
                is_start = self.data.mode == INSTANTIATED or (
                    is_parameter and self.data.mode == INITIALIZATION
                )
                return self.refuse() if is_start else (DISCARD, None)
        for reference, value in pairs:
            if self.data.values[reference] != value:
                self.data.values[reference] = float(value)
        return OK, None

    def is_settable(self, reference: int) -> bool:
        return reference < self.calculated.start or self.inputs.start <= reference < self.inputs.stop

    def is_acceptable(self, reference: int, value: float) -> bool:
        variable = self.block.variables[reference]
        if variable.type == "Boolean":
            return value in (0, 1)
        is_whole = variable.type == "Integer"
        return variable.refuse(value) is None and (not is_whole or _LEAST_WHOLE <= value <= _HIGHEST_WHOLE)

    def _is_malformed(self, kind: str, references: list[int], is_given: bool) -> bool:
        if isinstance(references, Null):
            return bool(references)
        known = all(r < len(self.block.variables) for r in references)
        typed = known and all(self.kinds[self.block.variables[r].type] == kind for r in references)
        return not typed or bool(references and not is_given)

    def refuse(self) -> Result:
        """An illegal call."""
        self.data.mode = FAILED
        return ERROR, None

    # what follows from parameters and inputs

    def _calculate(self, name: str, *arguments: list[float] | float) -> list[float]:
        columns = [a if isinstance(a, list) else [a] for a in arguments]
        return getattr(self._traced, name)(
            *(casadi.DM(a) if a else casadi.DM(0, 1) for a in columns)
        ).nonzeros()

    def _prepared(self) -> list[float] | None:
        """The calculated parameters, None if the parameters contradict each other."""
        parameters = self.data.values[: self.calculated.start]
        calculated = self._calculate("calculate", parameters)
        holds = self._calculate("requirements", parameters, calculated)
        return calculated if all(condition == 1 for condition in holds) else None

    def contradicts(self) -> bool:
        """Whether parameters contradict each other."""
        return self._prepared() is None

    def _refresh(self) -> bool:
        if self.data.is_held:
            return True
        calculated = self._prepared()
        if calculated is None:
            return False
        d, p = self.data, self.data.values[: self.calculated.start]
        state = self._calculate("initial_state", d.time, d.values[self.inputs], p, calculated)
        return self._become(d.time, state, p, calculated)

    def _become(self, t: float, state: list[float], p: list[float], calculated: list[float]) -> bool:
        outputs = self._calculate("output", t, state, p, calculated)
        pairs = zip(self.block.variables[self.outputs], outputs, strict=True)
        whole = [value for v, value in pairs if v.type != "Real"]
        if not all(map(math.isfinite, [*state, *outputs])):
            return False
        if not all(_LEAST_WHOLE <= value <= _HIGHEST_WHOLE for value in whole):
            return False
        d = self.data
        d.time, d.state, d.values[self.calculated], d.values[self.outputs] = t, state, calculated, outputs
        return True

    # modes

    def setup(self, start: float, has_stop: bool, stop: float) -> Result:
        good = math.isfinite(start) and (not has_stop or stop > start)
        if self.data.mode != INSTANTIATED or not good:
            return self.refuse()
        self.data.time, self.stop = start, min(stop, _HIGHEST) if has_stop else _HIGHEST
        return OK, None

    def enter(self) -> Result:
        return self._go(INSTANTIATED, INITIALIZATION)

    def leave(self) -> Result:
        if self.data.mode == INITIALIZATION and not self._refresh():
            return self.refuse()
        answer = self._go(INITIALIZATION, STEPPING)
        self.data.is_held = self.data.is_held or answer[0] == OK
        return answer

    def terminate(self) -> Result:
        return self._go(STEPPING, TERMINATED)

    def cancel(self) -> Result:
        return self.refuse()

    def _go(self, before: str, after: str) -> Result:
        if self.data.mode != before:
            return self.refuse()
        self.data.mode = after
        return OK, None

    # steps

    def step(self, t: float, h: float) -> Result:
        d = self.data
        tolerance = min(1e-9 * max(1.0, abs(t)), 1e-3 * h) + 8.0 * sys.float_info.epsilon * abs(t)
        legal = d.mode == STEPPING and math.isfinite(t) and math.isfinite(h) and h > 0
        if not (legal and abs(t - d.time) <= tolerance and t + h <= self.stop + tolerance):
            return self.refuse()
        calculated, ratio = self._prepared(), h / self.internal_step * (1 - 1e-9)
        if calculated is None or not ratio <= 1e9:
            return self.refuse()
        state, count = d.state, max(1, math.ceil(ratio))
        p, internal = d.values[: self.calculated.start], h / count
        for i in range(count):
            u = self._moving((i + 0.5) * internal)
            state = self._calculate("step", t + i * internal, internal, state, u, p, calculated)
        if not self._become(t + h, state, p, calculated):
            return DISCARD, None
        d.rates = [0.0] * len(d.rates)
        return OK, None

    @property
    def internal_step(self) -> float:
        (reference,) = [v.value_reference for v in self.block.variables if v.name == "internal_step"]
        return self.data.values[reference]

    def _moving(self, elapsed: float) -> list[float]:
        """Inputs so long after the communication point, within their ranges."""
        variables = self.block.variables[self.inputs]
        moving = []
        for v, u, rate in zip(variables, self.data.values[self.inputs], self.data.rates, strict=True):
            low = -_HIGHEST if v.minimum is None else v.minimum
            high = _HIGHEST if v.maximum is None else v.maximum
            moving.append(min(max(u + elapsed * rate, low), high) if rate else u)
        return moving

    # derivatives

    def set_input_derivatives(self, references: list[int], orders: list[int], values: list[float]) -> Result:
        given = not isinstance(values, Null)
        if self.data.mode not in WRITABLE or self._is_malformed("R", references, given):
            return self.refuse()
        if references and isinstance(orders, Null):
            return self.refuse()
        for reference, order, value in zip(references, orders, values, strict=False):
            is_input = self.inputs.start <= reference < self.inputs.stop
            if not is_input or order < 1 or not math.isfinite(value):
                return self.refuse()
        for reference, order, value in zip(references, orders, values, strict=False):
            if order == 1:
                self.data.rates[reference - self.inputs.start] = value
        return (WARNING if any(order > 1 for order in orders) else OK), None

    def get_output_derivatives(self, references: list[int], orders: list[int], out: bool) -> Result:
        if self.data.mode not in (STEPPING, TERMINATED, FAILED) or references:
            return self.refuse()
        return OK, []

    def directional_derivative(self, unknown: list[int], known: list[int], seed: list, out: bool) -> Result:
        return self._derive("forward", unknown, known, seed, out)

    def is_unknown(self, reference: int) -> bool:
        return not self.is_settable(reference)

    def _derive(self, kind: str, unknown: list[int], known: list[int], seed: list, out: bool) -> Result:
        to, of = (unknown, known) if kind == "forward" else (known, unknown)
        is_given = not isinstance(seed, Null)
        malformed = self._is_malformed("R", to, out) or self._is_malformed("R", of, is_given)
        if self.data.mode == INSTANTIATED or malformed:
            return self.refuse()
        if not all(map(self.is_unknown, unknown)) or not all(map(self.is_settable, known)):
            return self.refuse()
        d, p, u = self.data, self.data.values[: self.calculated.start], self.data.values[self.inputs]
        along = [0.0] * (len(self.block.variables) + len(self.block.states) + 1)
        for reference, value in zip(of, seed, strict=False):
            along[reference] += value
        if d.mode == INITIALIZATION and not self._refresh():
            return self.refuse()
        mode = "initial" if d.mode == INITIALIZATION else "step"
        derivatives = self._derivatives[f"{mode}_{kind}"](d.time, d.state, u, p, along)
        return OK, [float(derivatives[r]) for r in to]

    # the rest

    def get_status(self, kind: str, what: int, out: bool) -> Result:
        available = (kind, what) in (("R", LAST_TIME), ("B", ENDED))
        if self.data.mode not in (STEPPING, TERMINATED) or (available and not out):
            return self.refuse()
        if not available:
            return DISCARD, None
        return OK, [self.data.time if kind == "R" else 0]

    def set_debug_logging(self, on: bool, categories: list[str | None]) -> Result:
        if isinstance(categories, Null) and categories:
            return self.refuse()
        unknown = any(category not in (*ALL, "logAll") for category in categories)
        named: set[str] = set(ALL) if "logAll" in categories else set(ALL) & set(categories)
        usual: set[str] = set(ALL) if on else set(ALL) - {"logStatusDiscard"}
        self.log = usual if not categories else named if on else self.log - named
        return (WARNING if unknown else OK), None

    def saved(self) -> Data:
        return copy.deepcopy(self.data)

    def restore(self, saved: Data | None) -> Result:
        if saved is None:
            return self.refuse()
        self.data = copy.deepcopy(saved)
        return OK, None


class Model3(Model):
    """One instance of FMI 3.0.2, where it is not as in 2.0: value references are places of whole arrays."""

    fmi: ClassVar[int] = 3
    kinds: ClassVar[dict[str, str]] = {name: name[0] for name in TYPES}

    def __init__(self, block: Block, logging: bool) -> None:
        super().__init__(block, logging)
        groups = [[v.value_reference for v in members] for *_, members in fmi3_variables(self._traced)]
        self.members = dict(enumerate(groups, 1))
        self.log = set(ALL) if logging else set()

    def scalars(self, references: list[int]) -> list[int]:
        if isinstance(references, Null):
            return references
        found: list[int] = []
        for r in references:
            found += self.members.get(r, [NO_VARIABLE])
        return found

    def reference(self, v: BlockVariable) -> int | None:
        places = {members[0]: place for place, members in self.members.items()}
        return places.get(v.value_reference)

    def beyond(self) -> int:
        return len(self.members) + 1

    def count(self, references: list[int]) -> int:
        """Without numbers for what is no variable."""
        if isinstance(references, Null):
            return references.size
        return sum(scalar < len(self.block.variables) for scalar in self.scalars(references))

    def get(self, kind: str, references: list[int], out: bool) -> Result:
        return super().get(kind, self.scalars(references), out)

    def set(self, kind: str, references: list[int], values: list) -> Result:
        scalars = self.scalars(references)
        if not isinstance(references, Null) and not isinstance(values, Null) and len(values) != len(scalars):
            return self.refuse()
        return super().set(kind, scalars, values)

    # modes and messages

    def enter(self, start: float = 0.0, has_stop: bool = False, stop: float = 0.0) -> Result:
        return super().enter() if self.setup(start, has_stop, stop)[0] == OK else (ERROR, None)

    def set_debug_logging(self, on: bool, categories: list[str | None]) -> Result:
        if isinstance(categories, Null) and categories:
            return self.refuse()
        if any(category not in (*ALL, "logAll") for category in categories):
            return self.refuse()
        named = set(ALL) if not categories or "logAll" in categories else set(ALL) & set(categories)
        self.log = self.log | named if on else self.log - named
        return OK, None

    def step(self, t: float, h: float) -> Result:
        """With the last successful time."""
        status, _ = super().step(t, h)
        return status, [self.data.time] if status == OK else None

    # derivatives

    def directional_derivative(self, unknown: list[int], known: list[int], seed: list, out: bool) -> Result:
        return self._derive("forward", self.scalars(unknown), self.scalars(known), seed, out)

    def adjoint_derivative(self, unknown: list[int], known: list[int], seed: list, out: bool) -> Result:
        return self._derive("adjoint", self.scalars(unknown), self.scalars(known), seed, out)

    def is_unknown(self, reference: int) -> bool:
        """After the initialization calculated parameters rest."""
        is_initial = self.data.mode == INITIALIZATION
        return super().is_unknown(reference) and (is_initial or reference >= self.outputs.start)
