"""Free parameters and sliders of the options --free and --slider."""

import math

import pytest

from orchestration.errors import OrchestrationError
from orchestration.scenarios.free_parameter import parse


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("kp", [("kp", -math.inf, math.inf)]),
        (" kp = -2:0.5 , kd=1:20", [("kp", -2.0, 0.5), ("kd", 1.0, 20.0)]),
        ("plant.'a=b'=-1:3,m[1,2]", [("plant.'a=b'", -1.0, 3.0), ("m[1,2]", -math.inf, math.inf)]),
        ("a=b=c=1e-3:2", [("a=b=c", 1e-3, 2.0)]),
    ],
)
def test_a_name_may_have_an_equals_sign_before_that_of_its_limits(
    text: str, expected: list[tuple[str, float, float]]
) -> None:
    assert [(free.name, free.low, free.high) for free in parse([text])] == expected


@pytest.mark.parametrize("text", ["kp=", "kp=1", "kp=1-20", "a=b", "kp=low:high"])
def test_limits_that_are_no_numbers_are_refused(text: str) -> None:
    with pytest.raises(OrchestrationError, match=r"--slider .*: expected NAME or NAME=LOW:HIGH, such as"):
        parse([text], "--slider")
