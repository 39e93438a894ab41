"""The calls that the state machine makes of a native FMU, legal and not."""

import sys
from typing import Any, ClassVar

from hypothesis import strategies as st
from hypothesis.stateful import rule

from fmus.block.variables import BlockVariable

from .beside import NAMES, SELDOM, TINY, Beside
from .model import ALL, INITIALIZATION, INSTANTIATED, STEPPING, TERMINATED, WRITABLE, Model, Model3
from .session import ERROR, GUID, OK

SLOT, SAVED = st.integers(0, 1), st.integers(0, 2)  # of instances, of saved states
NAN, INF, HUGE = float("nan"), float("inf"), 1e300
STARTS = st.sampled_from((0.0, 0.0, -HUGE, -HUGE, -1.0, NAN, INF))
STOPS = st.sampled_from((1.0, 1.0, 2.0, HUGE, 0.0, NAN, INF, -HUGE))
LATE = st.sampled_from((*8 * (0.0,), 1e-12, -1e-12, 1.0, NAN, INF, -INF))
WRONG_STEPS = st.sampled_from((*4 * (1e11, HUGE), 0.0, -0.0, -1.0, NAN, INF, sys.float_info.max))
CATEGORIES = st.lists(st.sampled_from((*ALL, *ALL, "logAll", "%n#", None)), max_size=3)
ALLOWED = {"enter": INSTANTIATED, "leave": INITIALIZATION, "terminate": STEPPING}


class Calls(Beside):
    """Two instances and three saved states of one FMU, beside their models: what both standards have."""

    derivatives: ClassVar[tuple[str, ...]] = ("directional_derivative",)
    setup: ClassVar[str]  # the call that has the start time
    refusable: ClassVar[str] = "RIB"  # kinds of values that may be refused
    changes: ClassVar[tuple[str, ...]] = ("enter", "leave", "terminate", "reset")

    @rule(data=st.data(), slot=SLOT)
    def replace(self, data: Any, slot: int) -> None:
        assert self.send("free", slot=slot).status == OK
        name, logging = data.draw(st.sampled_from(NAMES)), data.draw(st.booleans())
        for wrong in self.refused_instantiations(slot, name):
            answer = self.send("instantiate", *wrong, logging, slot=slot)
            assert answer.status == ERROR
            assert [m.category for m in answer.messages] == ["logStatusError"] * self.is_told(logging)
        self.instantiate(slot, name, logging)
        assert self.send.live() == self.live + 2 + len(self.states)

    def refused_instantiations(self, slot: int, name: str) -> list[tuple[Any, ...]]:
        wrong = (None, GUID), ("", GUID), (name, "{%n}")
        return [self.instantiation(slot, *pair) for pair in wrong]

    def is_told(self, logging: bool) -> bool:
        """Whether an instantiation that fails has a message."""
        return logging

    @rule(data=st.data(), slot=SLOT)
    def change_mode(self, data: Any, slot: int) -> None:
        name = data.draw(st.sampled_from(self.changes))
        if name == "reset" or self.is_time(data, slot, ALLOWED.get(name, "")):
            self.call(slot, name) if name != "enter" else self.enter(slot)

    @rule(data=st.data(), slot=SLOT, start=STARTS, has_stop=st.booleans(), stop=STOPS)
    def set_up(self, data: Any, slot: int, start: float, has_stop: bool, stop: float) -> None:
        if self.is_time(data, slot, INSTANTIATED):
            self.call(slot, self.setup, start, has_stop, stop)

    # values

    @rule(data=st.data(), slot=SLOT, refused=st.integers(0, 3))
    def set_values(self, data: Any, slot: int, refused: int) -> None:
        if not self.is_time(data, slot, *WRITABLE):
            return
        kind = data.draw(st.sampled_from(self.kinds))
        references = self.some(data, self.settable(kind))
        mode = self.models[slot].data.mode
        if mode == STEPPING and not data.draw(SELDOM):
            fixed = self.references(v for v in self.variables if v.variability == "fixed")
            references = [r for r in references if r not in fixed]
        scalars = self.models[slot].scalars(references)
        values = [data.draw(st.sampled_from(_acceptable(self.block.variables[r]))) for r in scalars]
        if refused == 3 and scalars and kind in self.refusable:
            index = data.draw(st.integers(0, len(scalars) - 1))
            values[index] = data.draw(st.sampled_from(_refused(self.block.variables[scalars[index]])))
        asked = self.one_wrong(data, references)
        values += [1.0 if kind == "R" else 1] * (self.models[slot].count(asked) - len(values))
        self.call(slot, "set", kind, self.array(data, asked), self.array(data, values))
        self.call(slot, "get", kind, references, True)

    @rule(data=st.data(), slot=SLOT)
    def get_values(self, data: Any, slot: int) -> None:
        kind = data.draw(st.sampled_from(self.kinds))
        references = self.one_wrong(data, self.some(data, self.by_kind[kind]))
        self.call(slot, "get", kind, self.array(data, references), not data.draw(SELDOM))

    @rule(slot=SLOT)
    def read(self, slot: int) -> None:
        self.read_everything(slot)

    # steps and derivatives

    @rule(data=st.data(), slot=SLOT, late=LATE, h=WRONG_STEPS)
    def step_wrongly(self, data: Any, slot: int, late: float, h: float) -> None:
        """At another time, or by a length that is illegal or too long."""
        if self.is_time(data, slot, STEPPING):
            model = self.models[slot]
            self.call(slot, "step", model.data.time + late, model.internal_step if late else h)

    @rule(data=st.data(), slot=SLOT)
    def step_beyond_the_stop_time(self, data: Any, slot: int) -> None:
        """By one internal step; without a stop time the step is far too long."""
        if self.is_time(data, slot, STEPPING):
            model = self.models[slot]
            to_the_end = max(model.stop - model.data.time, 0.0)
            self.call(slot, "step", model.data.time, to_the_end + model.internal_step)

    @rule(data=st.data(), slot=SLOT, steps=st.sampled_from((1.0, 0.3, 2.0, 4.4, 1e-9)))
    def step(self, data: Any, slot: int, steps: float) -> None:
        if self.is_time(data, slot, STEPPING):
            self.take_step(slot, steps)

    @rule(data=st.data(), slot=SLOT)
    def get_output_derivatives(self, data: Any, slot: int) -> None:
        if not self.is_time(data, slot, STEPPING, TERMINATED):
            return
        outputs = [v for v in self.by_kind["R"] if v.causality == "output"]
        # seldom: each refusal ends what the instance can do until it is restored or reset
        references = self.some(data, outputs) if data.draw(SELDOM) else []
        orders, out = self.array(data, self.orders(data, len(references))), not data.draw(SELDOM)
        self.call(slot, "get_output_derivatives", self.array(data, references), orders, out)

    @rule(data=st.data(), slot=SLOT)
    def directional_derivative(self, data: Any, slot: int) -> None:
        if not self.is_time(data, slot, INITIALIZATION, STEPPING, TERMINATED):
            return
        reals = self.by_kind["R"]
        unknown = self.one_wrong(data, self.some(data, [v for v in reals if not v.settable]))
        known = self.some(data, self.settable("R"))
        known = self.one_wrong(data, [*known, *known[: data.draw(st.integers(0, 1))]])
        name = data.draw(st.sampled_from(self.derivatives))
        seeded = known if name == "directional_derivative" else unknown
        numbers = st.sampled_from((1.0, 0.5, -2.5, 1.0, 0.5, -2.5, 0.0, HUGE, NAN))
        seed = [data.draw(numbers) for _ in range(self.models[slot].count(seeded))]
        known, out = self.array(data, known), not data.draw(SELDOM)
        self.call(slot, name, self.array(data, unknown), known, self.array(data, seed), out)

    @rule(data=st.data(), slot=SLOT, value=st.sampled_from((1.0, -3.0, 2e155, 1e308)))
    def step_on(self, data: Any, slot: int, value: float) -> None:
        """Two steps with every unlimited input at a value or, in FMI 2.0, on its way there; some diverge."""
        if not self.is_time(data, slot, STEPPING):
            return
        free = (v for v in self.by_kind["R"] if v.causality == "input" and v.minimum is None)
        inputs = self.references(free)
        self.push(data, slot, inputs, [value] * self.models[slot].count(inputs))
        for steps in (2.0, 1.0):
            self.take_step(slot, steps)

    def push(self, data: Any, slot: int, inputs: list[int], values: list[float]) -> None:
        self.call(slot, "set", "R", inputs, values)

    # messages

    @rule(slot=SLOT, on=st.booleans(), categories=CATEGORIES)
    def set_debug_logging(self, slot: int, on: bool, categories: list[str | None]) -> None:
        self.call(slot, "set_debug_logging", on, categories)

    # saved states

    @rule(slot=SLOT, saved_slot=SAVED)
    def save(self, slot: int, saved_slot: int) -> None:
        self.state_call(slot, "get_state", (saved_slot,))
        self.states[saved_slot] = self.models[slot].saved()

    @rule(data=st.data(), slot=SLOT, saved_slot=SAVED)
    def restore(self, data: Any, slot: int, saved_slot: int) -> None:
        """Of whichever instance and mode; without a saved state there it is an error."""
        model = self.models[slot]
        if saved_slot not in self.states and not data.draw(SELDOM):
            return
        self.state_call(slot, "set_state", (saved_slot,), model.restore(self.states.get(saved_slot)))
        self.read_everything(slot)

    @rule(slot=SLOT, saved_slot=st.sampled_from((0, 1, 2, None)))
    def free(self, slot: int, saved_slot: int | None) -> None:
        self.state_call(slot, "free_state", (saved_slot,))
        if saved_slot is not None:
            self.states.pop(saved_slot, None)
        assert self.send.live() == self.live + 2 + len(self.states)

    @rule(data=st.data(), slot=SLOT, saved_slot=SAVED, change=st.sampled_from((*8 * (0,), 1, -1)))
    def serialize(self, data: Any, slot: int, saved_slot: int, change: int) -> None:
        model = self.models[slot]
        if saved_slot not in self.states and not data.draw(SELDOM):
            return
        saved = self.states.get(saved_slot)
        expected = (OK, None) if saved else model.refuse()
        answer = self.state_call(slot, "state_size", (saved_slot, "+"), expected)
        size = int(answer.values[0]) if saved else 9
        fits = saved and change >= 0
        expected = (OK, None) if fits else model.refuse()
        answer = self.state_call(slot, "serialize", (saved_slot, size + change, "+"), expected)
        if saved and fits:
            self.buffers.append(([int(v) for v in answer.values[:size]], saved))

    @rule(data=st.data(), slot=SLOT, saved_slot=SAVED)
    def deserialize(self, data: Any, slot: int, saved_slot: int) -> None:
        """Bytes as they were, or with one bit, the end or a piece wrong."""
        if not self.buffers:
            self.save(slot, saved_slot)
            self.serialize(data, slot, saved_slot, 0)
        content, saved = data.draw(st.sampled_from(self.buffers))
        changed = data.draw(_changes(content))
        intact = changed == content
        expected = (OK, None) if intact else self.models[slot].refuse()
        self.state_call(slot, "deserialize", (changed, saved_slot), expected)
        if intact:
            self.states[saved_slot] = saved


class Calls2(Calls):
    """And those that FMI 2.0 alone has."""

    setup: ClassVar[str] = "setup"
    changes: ClassVar[tuple[str, ...]] = (*Calls.changes, "cancel")

    def instantiation(self, slot: int, name: str | None, guid: str) -> tuple[Any, ...]:
        return name, 1, guid, "all"

    def enter(self, slot: int, *setup: Any) -> None:
        if setup:
            self.call(slot, "setup", *setup)
        self.call(slot, "enter")

    def refused_instantiations(self, slot: int, name: str) -> list[tuple[Any, ...]]:
        return [*super().refused_instantiations(slot, name), (name, 2, GUID, "all")]

    def is_told(self, logging: bool) -> bool:
        return True

    @rule(data=st.data(), slot=SLOT)
    def set_input_derivatives(self, data: Any, slot: int) -> None:
        if not self.is_time(data, slot, *WRITABLE):
            return
        inputs = [v for v in self.block.of_causality("input") if v.type == "Real"]
        references = self.one_wrong(data, self.some(data, inputs))
        orders = self.array(data, self.orders(data, len(references)))
        numbers = st.sampled_from((0.0, 1.0, -20.0, 1e3, TINY) * 3 + (HUGE, NAN, -INF))
        rates = [data.draw(numbers) for _ in references]
        arguments = self.array(data, references), orders, self.array(data, rates)
        self.call(slot, "set_input_derivatives", *arguments)

    def push(self, data: Any, slot: int, inputs: list[int], values: list[float]) -> None:
        if data.draw(st.booleans()):
            self.call(slot, "set_input_derivatives", inputs, [1] * len(inputs), values)
        else:
            super().push(data, slot, inputs, values)

    @rule(data=st.data(), slot=SLOT, kind=st.sampled_from("RRBIN"), what=st.sampled_from((2, 3, 2, 0, -1, 4)))
    def get_status(self, data: Any, slot: int, kind: str, what: int) -> None:
        if self.is_time(data, slot, STEPPING, TERMINATED):
            self.call(slot, "get_status", kind, what, not data.draw(SELDOM))


class Calls3(Calls):
    """And those that FMI 3.0 alone has.

    The second instance has intermediate updates, which change nothing.
    """

    model: ClassVar[type[Model]] = Model3
    setup: ClassVar[str] = "enter"
    refusable: ClassVar[str] = "RIE"
    derivatives: ClassVar[tuple[str, ...]] = (*Calls.derivatives, "adjoint_derivative")

    def instantiation(self, slot: int, name: str | None, guid: str) -> tuple[Any, ...]:
        return name, guid, "updates" if slot else "all"

    def enter(self, slot: int, *setup: Any) -> None:
        self.call(slot, "enter", *(setup or (0.0, False, 0.0)))

    @rule(data=st.data(), slot=SLOT, name=st.sampled_from(("get", "set")), more=st.sampled_from((1, -1)))
    def count_wrongly(self, data: Any, slot: int, name: str, more: int) -> None:
        """An array has a value too many or too few."""
        kind = data.draw(st.sampled_from(self.kinds))
        references = self.some(data, self.by_kind[kind] if name == "get" else self.settable(kind))
        count = self.models[slot].count(references) + more
        if count >= 0:
            values = [0.0 if kind == "R" else 0] * count
            arguments = kind, references, f"+{count}" if name == "get" else values
            self.state_call(slot, name, arguments, self.models[slot].refuse())

    @rule(slot=SLOT)
    def get_time(self, slot: int) -> None:
        model = self.models[slot]
        expected = model.refuse() if model.contradicts() else (OK, [model.data.time])
        scalar = len(self.block.variables) + len(self.block.states)
        (time,) = [r for r in range(1, model.beyond()) if model.scalars([r]) == [scalar]]
        self.state_call(slot, "get", ("R", [time], "+1"), expected)

    def instantiate(self, slot: int, name: str, logging: bool) -> None:
        super().instantiate(slot, name, logging)
        self.names[slot] = ""  # messages name no instance


CALLS: dict[int, type[Calls]] = {2: Calls2, 3: Calls3}  # by the version of FMI


def _acceptable(v: BlockVariable) -> list:
    if v.type == "Boolean":
        return [0, 1]
    if v.enumeration:
        return [int(item) for item in v.enumeration]
    numbers = [v.start, v.start, v.start * 1.25, v.minimum, v.maximum]
    if v.name == "internal_step":
        return [v.start, v.start / 2]
    if v.type == "Real":
        numbers += [0.5, 3.0, -1.0, 0.1, -0.0, TINY, HUGE, 1e308]
    return [type(v.start)(x) for x in numbers if x is not None and not v.refuse(type(v.start)(x))]


def _refused(v: BlockVariable) -> list:
    if v.type == "Boolean":
        return [2, -1]
    if v.type != "Real":
        return [-1, 0, 2**31 - 1, -(2**31), 40]
    beyond = [] if v.maximum is None else [v.maximum * (1 + 2e-16) or TINY]
    return [NAN, INF, -INF, *beyond]


def _changes(content: list[int]) -> st.SearchStrategy[list[int]]:
    bit = st.integers(0, 8 * len(content) - 1).map(
        lambda i: [b ^ (1 << i % 8) if k == i // 8 else b for k, b in enumerate(content)]
    )
    cut = st.integers(0, len(content) - 1).map(lambda n: content[:n])
    return st.one_of(*4 * (st.just(content),), bit, cut, st.just([*content, 0]))
