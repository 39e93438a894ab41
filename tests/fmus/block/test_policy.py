"""A policy class runs as a block does: sampling, parameters, refusals."""

import math
import sys
import types
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from controller_fmu.depth_interface import DepthInputs, DepthOutputs
from fmus.block import Block, variable
from fmus.block.instance import BlockError
from fmus.block.policy import INPUTS, OUTPUTS, PolicyInstance, policy_block
from fmus.errors import ExportError


class Counting:
    """Puts out the time of its last call; remembers all, with the input."""

    period = 0.04
    inputs = ("measured_depth",)
    gain = 2.0

    def reset(self) -> None:
        self.calls: list[tuple[float, float]] = []

    def step(self, time: float, inputs: dict[str, float]) -> dict[str, Any]:
        self.calls.append((time, inputs["measured_depth"]))
        return {"control_force": self.gain * time}


def begun(cls: type, start: float = 0.0, **values: Any) -> PolicyInstance:
    instance = PolicyInstance(policy_block(cls))
    for name, value in values.items():
        instance.set(reference(instance, name), value)
    instance.start(start)
    instance.exit_initialization_mode()
    return instance


def reference(instance: PolicyInstance, name: str) -> int:
    return [v.name for v in instance.block.variables].index(name)


def value(instance: PolicyInstance, name: str = "control_force") -> Any:
    return instance.get(reference(instance, name))


@pytest.mark.parametrize(
    ("step", "period", "held"),
    [
        (0.02, 0.04, [0, 2, 4, 6, 8]),  # every second point
        (0.02, 0.02, range(10)),
        (0.02, 0.03, [0, 1, 3, 4, 6, 7, 9]),  # a sample between two points takes the inputs of the first
        (0.1, 0.04, [0, 0, 0, 1, 1]),  # several in one step
        (0.1, 0.3, [0]),
    ],
)
def test_it_is_called_at_start_plus_k_periods_with_the_inputs_of_the_point_before(
    step: float, period: float, held: list[int]
) -> None:
    """The input at point i is i. The last point is at 0.2 s."""
    start, instance = 5.0, begun(Counting, 5.0, period=period)
    for i in range(round(0.2 / step)):
        instance.set(reference(instance, "measured_depth"), float(i))
        instance.do_step(start + i * step, step)
    times, depths = zip(*instance._policy.calls, strict=True)
    assert times == pytest.approx([start + k * period for k in range(len(held))], abs=1e-12)  # rounding
    assert depths == tuple(held)


def test_outputs_are_those_of_the_last_sample_and_at_the_start_of_one_that_leaves_no_trace() -> None:
    instance = begun(Counting, 1.0)
    seen = [value(instance)]
    for i in range(4):
        instance.do_step(1.0 + 0.02 * i, 0.02)
        seen.append(value(instance))
    assert seen == [2.0, 2.0, 2.0, 2.08, 2.08]
    assert [time for time, _ in instance._policy.calls] == [1.0, 1.04]


def test_a_new_run_begins_with_a_new_object() -> None:
    first, second = begun(Counting), begun(Counting)
    first.do_step(0.0, 0.02)
    assert second._policy.calls == []


def test_a_snapshot_is_the_whole_state() -> None:
    instance = begun(Counting)
    instance.do_step(0.0, 0.04)
    kept = instance.snapshot()
    instance.do_step(0.04, 0.04)
    instance.restore(kept)
    assert (instance.time, value(instance), len(instance._policy.calls)) == (0.04, 0.0, 1)
    instance.do_step(0.04, 0.04)
    assert value(instance) == 0.08


@dataclass(frozen=True)
class Declared(Counting):
    """A policy of NumPy, with parameters of all kinds."""

    period: ClassVar[float] = 0.1
    kp: float = variable(3.0, "Gain", unit="N/m", min=0.0)
    whole: float = 4
    later: "float" = 5  # as with `from __future__ import annotations`
    order: int = 2
    on: bool = True
    weights: tuple[float, ...] = (1.0, 0.5)
    name: str = "no number, so no parameter"
    limit: float = math.inf  # no parameter either: no description of an FMU can state it

    def __post_init__(self) -> None:
        object.__setattr__(self, "row", self.kp * np.array(self.weights))

    def reset(self) -> None:
        pass

    def step(self, time: float, inputs: dict[str, float]) -> dict[str, Any]:
        return {"control_force": vars(self)["row"] @ np.ones(2)}


def test_the_numbers_of_a_class_are_its_parameters_which_its_init_finds() -> None:
    block = policy_block(Declared)
    kinds = {v.name: (v.type, v.unit, v.minimum) for v in block.of_causality("parameter")}
    assert kinds == {
        "period": ("Real", "s", 1e-6),
        "gain": ("Real", None, None),
        "kp": ("Real", "N/m", 0.0),
        "whole": ("Real", None, None),
        "later": ("Real", None, None),
        "order": ("Integer", None, None),
        "on": ("Boolean", None, None),
        "weights[1]": ("Real", None, None),
        "weights[2]": ("Real", None, None),
    }
    assert {v.variability for v in block.of_causality("parameter")} == {"fixed"}
    instance = begun(Declared, kp=10.0, **{"weights[2]": 1.0}, period=0.5)
    instance.do_step(0.0, 0.1)
    assert value(instance) == 20.0
    assert instance._policy.period == 0.5
    with pytest.raises(BlockError, match=r"kp = -1.0: expected at least 0 N/m"):
        begun(Declared, kp=-1.0)


class Plain(Counting):
    def __init__(self) -> None:
        self.doubled = 2.0 * self.gain

    def step(self, time: float, inputs: dict[str, float]) -> dict[str, Any]:
        return {"control_force": self.doubled}


def test_the_init_of_a_plain_class_finds_its_parameters() -> None:
    instance = begun(Plain, gain=7.0)
    instance.do_step(0.0, 0.1)
    assert value(instance) == 14.0


def test_the_interface_is_that_of_the_depth_controllers() -> None:
    """`control_force` is what a controller without an allocation has in place of the voltages."""

    def block_of(inputs: type) -> Block:
        return Block("B", "b", inputs=inputs, outputs=DepthOutputs, output=lambda *_: DepthOutputs())

    interface = {v.name: v.unit for v in block_of(DepthInputs).variables}
    assert INPUTS.items() <= interface.items()
    assert {n: u for n, u in OUTPUTS.items() if n != "control_force"}.items() <= interface.items()
    assert {v.name for v in block_of(DepthInputs).of_causality("input")} == {*INPUTS}


def changed(**members: Any) -> type:
    return type("Policy", (Counting,), members)


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"period": None}, "Policy.period = None: expected the sampling period"),
        ({"period": -0.1}, "Policy.period = -0.1: expected"),
        ({"period": float("nan")}, "Policy.period = nan: expected"),
        ({"reset": None}, r"Policy: expected a method reset\(self\)"),
        ({"step": 3}, r"Policy: expected a method step\(self, time, inputs\)"),
        ({"inputs": "measured_depth"}, r"Policy.inputs = 'measured_depth': expected a tuple of names"),
        ({"inputs": ("measured_deph",)}, "'measured_deph' is not a name .* nearest is 'measured_depth'"),
        ({"outputs": ()}, "Policy.outputs: expected one output at least"),
        ({"outputs": {"a b": "V"}}, "'a b': expected a name of letters"),
        ({"inputs": ("roll",), "roll": 1.0}, "'roll' twice among"),
        ({"kp": variable(1.0, "Gain")}, "Policy.kp: expected @dataclass above"),
    ],
)
def test_a_class_that_is_no_policy_is_refused(members: dict[str, Any], message: str) -> None:
    with pytest.raises(ExportError, match=message):
        policy_block(changed(**members))


OWN = """class Own:
    period = 1.0
    def reset(self):
        pass

    def step(self, time, inputs):
        {}
"""


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ('return {"control_force": 1 / 0}', "y.py:7 at t = 0 s: ZeroDivisionError: division"),
        ('return inputs["measured_deph"]', "y.py:7 .*no input 'measured_deph'; nearest is"),
        ("raise SystemExit(3)", "y.py:7 at t = 0 s: SystemExit: 3"),
        ("return 3.0", r"returned 3.0: expected \{'control_force': number\}"),
        ('return {"controlforce": 1.0}', "'controlforce', which is no output; nearest is"),
        ("return {}", "returned no 'control_force': expected all outputs"),
        ('return {"control_force": float("nan")}', "control_force = nan: expected a finite number in N"),
        ('return {"control_force": "3"}', "control_force = '3': expected"),
        ('return {"control_force": [3.0]}', r"control_force = \[3.0\]: expected"),
    ],
)  # fmt: skip
def test_a_step_that_fails_is_named_with_its_line(tmp_path: Path, step: str, message: str) -> None:
    cls = written(tmp_path, OWN.format(step))
    with pytest.raises(BlockError, match=message):
        begun(cls)


@pytest.fixture(autouse=True)
def _forget() -> Any:
    yield
    sys.modules.pop("own_policy", None)


def written(folder: Path, source: str) -> type:
    """The class `Own` of a file own_policy.py."""
    file = folder / "own_policy.py"
    file.write_text(source)
    module = sys.modules["own_policy"] = types.ModuleType("own_policy")
    module.__file__ = str(file)
    run: Callable[..., Any] = exec
    run(compile(source, str(file), "exec"), vars(module))
    return module.Own


class OfNumpy(Counting):
    period = np.float64(0.25)
    gain = np.float32(-1.5)  # type: ignore[assignment]
    order = np.int64(-3)


def test_numbers_of_numpy_are_parameters_and_a_period() -> None:
    block = policy_block(OfNumpy)
    starts = {v.name: (v.type, v.start) for v in block.of_causality("parameter")}
    assert starts == {"period": ("Real", 0.25), "gain": ("Real", -1.5), "order": ("Integer", -3)}
    assert {type(start) for _, start in starts.values()} == {float, int}
    assert block.step_size == 0.25


def test_runs_go_back_to_any_snapshot_in_any_order() -> None:
    """Also to one before a way that was left, and on from there with other inputs."""
    instance, saved, expected = begun(Counting, 2.0), [], []

    def step(depth: float) -> None:
        instance.set(reference(instance, "measured_depth"), depth)
        instance.do_step(instance.time, 0.04)

    for k in range(6):
        step(-1.0 - k)
        saved.append(instance.snapshot())
        expected.append((instance.time, value(instance), list(instance._policy.calls)))
    for k in (2, 5, 0, 5, 3):
        instance.restore(saved[k])
        assert (instance.time, value(instance), instance._policy.calls) == expected[k]
        assert instance.get(reference(instance, "measured_depth")) == -1.0 - k
        step(50.0 + k)
        instance.restore(instance.snapshot())
        assert instance._policy.calls == [*expected[k][2], (expected[k][0], 50.0 + k)]


class Clock:
    """The clock of `fmus.block.policy`: a sample takes 1 s, a copy of a call 1 s."""

    now = 0.0
    copied = 0

    def __call__(self) -> float:
        return self.now


class Growing(Counting):
    clock = Clock()

    def step(self, time: float, inputs: dict[str, float]) -> dict[str, Any]:
        self.clock.now += 1.0
        if inputs["measured_depth"] < 0.0:
            self.calls.append((math.nan, math.nan))
            raise ValueError("negative")
        return super().step(time, inputs)

    def __deepcopy__(self, memo: Any) -> "Growing":
        self.clock.now += len(self.calls)
        self.clock.copied += len(self.calls)
        other = Growing()
        other.calls = list(self.calls)
        return other


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(Growing, "clock", clock)
    monkeypatch.setattr("fmus.block.policy.perf_counter", clock)
    return clock


def test_an_object_that_grows_is_not_copied_at_each_point(clock: Clock) -> None:
    """Copies take no longer than samples, but for the last one."""
    instance = begun(Growing)
    for _ in range(1000):
        instance.snapshot()
        instance.do_step(instance.time, 0.04)
    saved = instance.snapshot()
    assert len(instance._policy.calls) == 1000
    assert 500 < clock.copied <= 2000
    instance.restore(saved)
    assert len(instance._policy.calls) == 1000


def test_a_snapshot_before_the_first_step_is_one_of_the_initialisation() -> None:
    instance = PolicyInstance(policy_block(Counting))
    instance.set(reference(instance, "gain"), -3.0)
    instance.start(1.5)
    initial = instance.snapshot()
    instance.exit_initialization_mode()
    begun = instance.snapshot()
    instance.do_step(1.5, 0.04)
    instance.restore(begun)
    assert instance._policy.calls == []
    instance.do_step(1.5, 0.04)
    instance.restore(initial)
    instance.set(reference(instance, "gain"), 2.0)
    assert value(instance) == 3.0


def test_samples_are_noted_after_a_snapshot_alone(clock: Clock) -> None:
    instance = begun(Growing)
    for _ in range(100):
        instance.do_step(instance.time, 0.04)
    assert instance._noted is None
    assert clock.copied == 0


def test_what_a_step_that_fails_leaves_in_the_object_is_saved(clock: Clock) -> None:
    instance = begun(Growing)
    for _ in range(10):
        instance.do_step(instance.time, 0.04)
    instance.snapshot()
    instance.do_step(instance.time, 0.04)
    instance.set(reference(instance, "measured_depth"), -1.0)
    with pytest.raises(BlockError):
        instance.do_step(instance.time, 0.04)
    saved = instance.snapshot()
    instance.restore(saved)
    assert len(instance._policy.calls) == 12
