"""A native FMU beside its model: what each rule of the state machine is made of."""

import math
from collections.abc import Iterable
from typing import Any, ClassVar

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize

from fmus.block.variables import BlockVariable

from .model import FAILED, INITIALIZATION, INSTANTIATED, STEPPING, Data, Model
from .session import CATEGORIES, GUID, OK, WARNING, Answer, Null, Session

TINY = 5e-324
SELDOM = st.integers(0, 24).map(lambda i: i == 13)
NAMES = ("it", "a%n%s#r1#%", "long" * 1300)
# what writes numbers as its last argument -> place of the references to what they belong to
_WRITES = {
    **{"get": 1, "get_output_derivatives": 0, "get_status": None},
    **{"directional_derivative": 0, "adjoint_derivative": 1},
}


class Beside(RuleBasedStateMachine):
    """Two instances and three saved states of one FMU, beside their models.

    send: the process of all examples; one that has ended is replaced
    """

    send: ClassVar[Session]
    model: ClassVar[type[Model]] = Model

    def __init__(self) -> None:
        super().__init__()
        type(self).send = self.send.running()
        self.block, self.live = self.send.block, self.send.live()
        self.models: dict[int, Model] = {}
        self.names: dict[int, str] = {}
        self.states: dict[int, Data] = {}
        self.buffers: list[tuple[list[int], Data]] = []
        model = self.model(self.block, False)
        self.variables = [v for v in self.block.variables if model.reference(v) is not None]
        self.by_kind = {k: [v for v in self.variables if model.kinds[v.type] == k] for k in "RIBE"}
        self.kinds = [k for k in "RIBE" if self.by_kind[k]]

    def enter(self, slot: int, *setup: Any) -> None:
        """Leads to initialization mode, with the arguments of a setup if there is one."""
        raise NotImplementedError

    def instantiation(self, slot: int, name: str | None, guid: str) -> tuple[Any, ...]:
        """Returns the arguments of the instantiation but whether messages are wanted."""
        raise NotImplementedError

    # both sides

    def call(self, slot: int, name: str, *arguments: Any) -> Answer:
        """The call on FMU and model: same status, same values, the right message, and nothing lost."""
        model = self.models[slot]
        enabled = set(model.log)
        expected = getattr(model, name)(*arguments)
        return self.compare(slot, enabled, name, arguments, expected)

    def compare(self, slot: int, enabled: set[str], name: str, arguments: Any, expected: Any) -> Answer:
        if name in _WRITES and not isinstance(arguments[-1], str):
            place = _WRITES[name]
            count = 1 if place is None else self.models[slot].count(arguments[place])
            arguments = (*arguments[:-1], f"+{count}" if arguments[-1] else Null(count))
        answer = self.send(name, *arguments, slot=slot)
        status, values = expected
        call = (name, slot, *arguments)
        assert answer.status == status, (call, answer, expected)
        if status != OK:
            assert set(answer.values) <= {"untouched"}, (call, answer)
        elif values is not None:
            assert [_exactly(v) for v in answer.values] == [_exactly(float(v)) for v in values], call
        self.check_messages(slot, enabled, answer)
        if status != OK:
            self.read_everything(slot)
        return answer

    def check_messages(self, slot: int, enabled: set[str], answer: Answer) -> None:
        due = answer.status != OK and CATEGORIES[answer.status] in enabled
        assert bool(answer.messages) == due, answer
        assert len(answer.messages) <= 1 or answer.status == WARNING, answer  # one for each part left out
        for message in answer.messages:
            assert (message.status, message.category) == (answer.status, CATEGORIES[answer.status])
            assert message.name == self.names[slot]
            assert message.text

    def read_everything(self, slot: int) -> None:
        """What was set can be read always, what is calculated unless the parameters contradict each other."""
        model = self.models[slot]
        for kind in self.kinds:
            for settable in (True, False):
                references = self.references(v for v in self.by_kind[kind] if v.settable == settable)
                expected = model.get(kind, references, True)
                answer = self.send("get", kind, references, f"+{model.count(references)}", slot=slot)
                assert answer.status == expected[0]
                answered = [_exactly(v) for v in answer.values] if answer.status == OK else []
                assert answered == [_exactly(float(v)) for v in expected[1] or ()], (kind, references)

    # life

    @initialize(data=st.data())
    def begin(self, data: Any) -> None:
        for slot in (0, 1):
            self.instantiate(slot, data.draw(st.sampled_from(NAMES)), data.draw(st.booleans()))
            for _ in range(data.draw(st.integers(0, 3))):
                self.go_on(data, slot)

    def is_time(self, data: Any, slot: int, *modes: str) -> bool:
        """Usually a call waits for a mode that allows it, and the instance goes on instead."""
        if self.models[slot].data.mode in modes or data.draw(SELDOM):
            return True
        self.go_on(data, slot)
        return False

    def instantiate(self, slot: int, name: str, logging: bool) -> None:
        arguments = *self.instantiation(slot, name, GUID), logging
        assert self.send("instantiate", *arguments, slot=slot) == (OK, [], [])
        self.models[slot], self.names[slot] = self.model(self.block, logging), name

    def teardown(self) -> None:
        if self.send.is_alive and self.models:
            for saved_slot in self.states:
                self.send("free_state", saved_slot)
            for slot in self.models:
                self.send("free", slot=slot)
            if self.send.live() != self.live:
                self.send.kill()  # the next example shall not find what this one has lost
                raise AssertionError("memory is lost")

    def go_on(self, data: Any, slot: int) -> None:
        """The next state of a usual life; at its end, and in error, a saved one or a new beginning."""
        mode, setup = self.models[slot].data.mode, ()
        if mode == FAILED and data.draw(st.integers(0, 3)) == 2:
            self.call(slot, data.draw(st.sampled_from(("leave", "terminate"))))
        if mode == INSTANTIATED and data.draw(st.booleans()):
            start = data.draw(st.sampled_from((0.0, -1.5, 1e6)))
            has_stop, length = data.draw(st.booleans()), data.draw(st.sampled_from((1.0, TINY + 9)))
            setup = start, has_stop, start + length
        following = {INSTANTIATED: "enter", INITIALIZATION: "leave", STEPPING: "step"}.get(mode, "reset")
        if following == "enter":
            self.enter(slot, *setup)
        elif following == "step":
            self.take_step(slot, data.draw(st.sampled_from((1.0, 0.3, 2.0, 4.4))))
        elif following == "reset" and self.states and data.draw(st.booleans()):
            saved_slot = data.draw(st.sampled_from(sorted(self.states)))
            expected = self.models[slot].restore(self.states[saved_slot])
            self.state_call(slot, "set_state", (saved_slot,), expected)
        else:
            self.call(slot, following)

    def take_step(self, slot: int, internal_steps: float) -> None:
        model = self.models[slot]
        self.call(slot, "step", model.data.time, internal_steps * model.internal_step)

    def state_call(self, slot: int, name: str, arguments: tuple, expected: Any = (OK, None)) -> Answer:
        return self.compare(slot, set(self.models[slot].log), name, arguments, expected)

    # arguments

    def some(self, data: Any, variables: list[BlockVariable]) -> list[int]:
        chosen = data.draw(st.lists(st.sampled_from(variables), max_size=4)) if variables else []
        return self.references(chosen)

    def references(self, variables: Iterable[BlockVariable]) -> list[int]:
        return [r for v in variables if (r := self.models[0].reference(v)) is not None]

    def settable(self, kind: str) -> list[BlockVariable]:
        return [v for v in self.by_kind[kind] if v.settable]

    def one_wrong(self, data: Any, references: list[int]) -> list[int]:
        """Now and then a value reference of any type or none among them."""
        if data.draw(st.integers(0, 9)) != 4:
            return references
        beyond = self.models[0].beyond()
        others = (0, len(self.variables) - 1, beyond, 2**31, 2**32 - 1)
        return [*references, data.draw(st.sampled_from(others))]

    def array(self, data: Any, items: list) -> list:
        """Now and then NULL."""
        return Null(len(items)) if data.draw(SELDOM) else items

    def orders(self, data: Any, count: int) -> list[int]:
        usual = [1] * count
        if count and data.draw(st.integers(0, 2)) == 1:
            usual[-1] = data.draw(st.sampled_from((0, 2, 2, -1, 2**31 - 1)))
        return usual


def _exactly(number: float | str) -> str:
    """All bits but the sign of zero, which a choice in compiled code does not keep."""
    if isinstance(number, str):
        number = float.fromhex(number)
    return "nan" if math.isnan(number) else (number + 0.0).hex()
