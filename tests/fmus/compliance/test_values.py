"""Two readings differ by more than rounding, each variable at its own size."""

import math

import pytest

from fmus.compliance.script import Reading, Reply
from fmus.compliance.texts import packed, unpacked
from fmus.compliance.values import differing
from fmus.compliance.variable import Variable

LARGE = 1e6  # the variable beside the small one


def reading(small: float, nominal: str = "1") -> Reading:
    """Returns the values of a large and of a small variable, which has a nominal value."""
    variables = [
        Variable(i, {"name": name}, "Real", typed, {})
        for i, (name, typed) in enumerate((("large", {}), ("small", {"nominal": nominal})), 1)
    ]
    reply = Reply("fmi2GetReal", "step complete", 0, [LARGE, small])
    return Reading({"Real": variables}, {"Real": reply})


def found(before: Reading, after: Reading, tolerance: float) -> list[str]:
    return [one.text for one in differing([before], [after], "later", tolerance)]


@pytest.mark.parametrize("tolerance", [0.0, 1e-9, 1e-6, 1e-4])
def test_a_small_variable_that_differs_beside_a_large_one_is_found(tolerance: float) -> None:
    """Also with a tolerance that is more than the difference if it is taken of the large one."""
    (message,) = found(reading(0.5), reading(0.5 + 3e-4), tolerance)
    assert message == "small is 0.5003 later: expected 0.5 again"


@pytest.mark.parametrize(
    ("before", "after", "nominal"),
    [
        (0.5, 0.5 * (1.0 + 1e-15), "1"),
        (0.0, 1e-15, "1"),  # of terms of the size of the nominal value, which cancel
        (0.0, 1e-9, "1e6"),
    ],
)
def test_a_rounding_is_none_relative_to_the_value_or_its_nominal_value(
    before: float, after: float, nominal: str
) -> None:
    assert found(reading(before, nominal), reading(after, nominal), 1e-12) == []
    assert len(found(reading(before, nominal), reading(after, nominal), 0.0)) == 1


def test_a_nominal_value_says_which_differences_near_0_are_small() -> None:
    assert found(reading(0.0), reading(1e-9), 1e-6) == []
    assert len(found(reading(0.0, "1e-6"), reading(1e-9, "1e-6"), 1e-6)) == 1


@pytest.mark.parametrize(("tolerance", "most"), [(1e-6, LARGE), (1e-4, 0.01 * LARGE)])
def test_a_nominal_value_counts_up_to_the_largest_value_or_a_hundredth_of_it(
    tolerance: float, most: float
) -> None:
    """A nominal value far beyond all values hides nothing."""
    assert found(reading(0.0, "1e12"), reading(0.9 * tolerance * most, "1e12"), tolerance) == []
    assert len(found(reading(0.0, "1e12"), reading(1.1 * tolerance * most, "1e12"), tolerance)) == 1


def test_a_tolerance_is_relative_to_the_largest_value_of_a_variable_in_all_readings() -> None:
    before, after = ([reading(100.0, "1e-9"), reading(x, "1e-9")] for x in (0.0, 1e-11))
    assert list(differing(before, after, "later", 1e-12)) == []
    (one,) = differing(before, after, "later", 1e-14)
    assert one.text == "small is 1e-11 later, step 2: expected 0 again"


def test_a_reading_of_some_of_the_expected_variables_is_compared() -> None:
    whole, small = reading(0.5), reading(0.5).groups["Real"][1:]
    for value, count in ((0.5, 0), (0.6, 1)):
        reply = Reply("fmi2GetReal", "step complete", 0, [value])
        assert (
            len(list(differing([whole, whole], [Reading({"Real": small}, {"Real": reply})] * 2, ""))) == count
        )


def test_numbers_are_sent_with_all_their_bits() -> None:
    numbers = [0.1, -0.0, math.inf, 5e-324]
    assert list(map(str, unpacked(packed(numbers)))) == list(map(str, numbers))
    assert math.isnan(unpacked(packed([math.nan]))[0])
    for text in ("no digits", "00"):
        with pytest.raises(ValueError, match=r"bytes|hex"):
            unpacked(text)
