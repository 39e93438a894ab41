"""Ranges of gains: where a gain stands in its range, and which ranges are refused."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from fmus.fmi.description import describe
from orchestration.errors import OrchestrationError
from orchestration.scenarios.free_parameter import FreeParameter, parse
from orchestration.score.tune import with_units


def test_a_positive_range_is_searched_in_its_logarithm_and_another_one_is_not() -> None:
    assert [FreeParameter("k", 0.01, 100.0).rounded(x) for x in (0.0, 0.5, 1.0)] == [0.01, 1.0, 100.0]
    assert [FreeParameter("k", 0.0, 100.0).rounded(x) for x in (0.0, 0.5, 1.0)] == [0.0, 50.0, 100.0]
    assert FreeParameter("k", 1.0, 3.0).rounded(0.7) == 2.158  # 3^0.7 = 2.15767, to four digits
    assert FreeParameter("k", 1.00049, 3.0).rounded(0.0) == 1.00049  # rounding leaves no range


def test_a_gain_at_the_end_of_its_range_is_marked() -> None:
    gain = FreeParameter("k", 1.0, 100.0)
    assert [gain.is_at_a_limit(k) for k in (1.0, 1.04, 1.06, 10.0, 95.0, 96.0, 100.0)] == [
        True, True, False, False, False, True, True,
    ]  # fmt: skip


def test_an_option_names_gains_and_their_ranges() -> None:
    expected = [FreeParameter("kp", 1.0, 20.0), FreeParameter("a[1,2]"), FreeParameter("ki", -1.0, 2.0)]
    assert parse(["kp=1:20, a[1,2]", "ki=-1:2"]) == expected


@pytest.mark.parametrize("text", ["kp=", "kp=1", "kp=1:", "kp=a:b"])
def test_an_option_without_both_ends_of_its_range_is_refused(text: str) -> None:
    with pytest.raises(
        OrchestrationError, match=rf"--free {text}: expected NAME or NAME=LOW:HIGH, .* kp=1:20"
    ):
        parse([text])


@pytest.mark.parametrize("text", ["kp=2:1", "kp=1:1", "kp=0:inf", "kp=nan:1"])
def test_a_range_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(OrchestrationError, match="expected finite limits, the lower one first"):
        parse([text])


def test_gains_have_the_units_of_the_fmu(built: Mapping[str, Path]) -> None:
    description = describe(built["L1DepthController"])
    gains = with_units(parse(["integral_gain=0.001:0.1,observer_period=0.02:0.1"]), description)
    assert [gain.unit for gain in gains] == ["N/(m.s)", "s"]  # a tunable one, and a fixed one


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["proportional_gian=1:2"], "nearest is 'proportional_gain'"),
        (["augmentation=1:2"], "expected a parameter of type Real"),
        (["integral_gain"], "--free integral_gain: expected NAME=LOW:HIGH, such as integral_gain=1:20"),
        (["integral_gain=-1:1"], r"expected limits within 0\.\."),
        (["observer_alpha=0.1:1.5"], r"expected limits within 0\.\.1"),
        (["integral_gain=1:2", "integral_gain=1:3"], "given twice"),
        ([], "tunable are .*proportional_gain"),
    ],
)
def test_a_gain_that_the_fmu_cannot_take_is_refused(
    built: Mapping[str, Path], options: list[str], message: str
) -> None:
    with pytest.raises(OrchestrationError, match=message):
        with_units(parse(options), describe(built["L1DepthController"]))
