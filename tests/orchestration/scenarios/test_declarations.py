"""Signals and faults that a scenario file declares, and what a mistake in a declaration is answered with."""

import math
from typing import Any

import pytest

from orchestration.errors import ScenarioError
from orchestration.scenarios.declarations import fault, signal
from orchestration.system.faults import DropOut, Fault, Stuck


def test_a_declaration_becomes_a_signal() -> None:
    declared = {"kind": "table", "times": [0.0, 2.0], "values": [1.0, 3.0], "hold": True}
    assert signal(declared, "here")(1.9) == 1.0


@pytest.mark.parametrize(
    ("declaration", "message"),
    [
        ({"kind": "ramp", "points": [[0.0, 0.0]]}, r"here: unknown kind 'ramp'; nearest is 'ramps'"),
        ({"kind": ["ramps"]}, r"here: unknown kind \['ramps'\]; nearest is 'ramps'"),
        ({"points": []}, r"here: kind is missing; expected one of ramps, cosine, sine, sum-of-sines"),
        (3, r"here: 3: expected a table"),
        ({"kind": "ramps"}, r"here: points is missing"),
        ({"kind": "cosine", "amplitud": 1.0}, r"here: unknown key 'amplitud'; nearest is 'amplitude'"),
        ({"kind": "cosine", "amplitude": "1"}, r"here: amplitude = '1': expected a number"),
        ({"kind": "constant", "value": math.nan}, r"here: value = nan: expected a finite number"),
        (
            {"kind": "constant", "value": True},
            r"here: value = True: expected a number; a Boolean input takes",
        ),
        ({"kind": "ramps", "points": [[0.0, "a"]]}, r"here: points\[0\]\[1\] = 'a': expected a number"),
        ({"kind": "ramps", "points": [[0.0, math.inf]]}, r"here: points\[0\]\[1\] = inf: expected a finite"),
        ({"kind": "ramps", "points": 3.0}, r"here: points = 3.0: expected a list"),
        ({"kind": "ramps", "points": [[1.0, 0.0], [1.0, 2.0]]}, r"here: ramps: .*ascending time"),
        ({"kind": "table", "times": [0.0, 1.0], "values": [0.0]}, r"here: table: .*\(2,\) and \(1,\)"),
    ],
)
def test_a_mistake_in_a_signal_is_one_line(declaration: object, message: str) -> None:
    with pytest.raises(ScenarioError, match=f"^{message}"):
        signal(declaration, "here")


def test_a_declaration_becomes_a_fault() -> None:
    declared = {"input": "a.u", "kind": "drop-out", "probability": 0.25, "seed": 3, "start": 1, "end": 2.5}
    assert fault(declared, "x") == Fault("a.u", DropOut(0.25, 3), 1.0, 2.5)
    for value in (True, -3, 2.0):
        stuck = fault({"input": "a.u", "kind": "stuck", "value": value}, "x")
        assert repr(stuck) == repr(Fault("a.u", Stuck(value)))  # 1, 1.0 and true are equal


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "frezze"}, r"x: unknown kind 'frezze'; nearest is 'freeze'"),
        ({"kind": None}, r"x: unknown kind None"),
        ({"input": 3}, r"x: input = 3: expected a text"),
        ({"valu": 1.0}, r"x: unknown key 'valu'; nearest is 'value'"),
        ({"strt": 1.0}, r"x: unknown key 'strt'; nearest is 'start'"),
        ({"kind": "noise"}, r"x: unknown key 'value'"),
        ({"value": "much"}, r"x: value = 'much': expected a number"),
        ({"value": True}, r"x: value = True: expected a number"),
        ({"value": math.nan}, r"x: value = nan: expected a finite number"),
        ({"start": "soon"}, r"x: start = 'soon': expected a number"),
        ({"start": 2.0, "end": 2.0}, r"x: fault on a.u: end = 2.0 s: expected more than its start, 2.0 s"),
    ],
)
def test_a_mistake_in_a_fault_is_one_line(change: dict[str, Any], message: str) -> None:
    declared = {"input": "a.u", "kind": "offset", "value": 1.0} | change
    with pytest.raises(ScenarioError, match=f"^{message}"):
        fault(declared, "x")


def test_a_missing_argument_of_a_fault_is_named() -> None:
    with pytest.raises(ScenarioError, match=r"^x: delay is missing"):
        fault({"input": "a.u", "kind": "delay"}, "x")
