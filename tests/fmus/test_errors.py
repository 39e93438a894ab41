"""The words that error messages share."""

import math

import pytest

from fmus.errors import listed, nearest, number_text, range_text
from fmus.fmi.instance import _shortened


@pytest.mark.parametrize(
    ("name", "known", "suggestion"),
    [
        ("dpeth", ["mass", "depth"], "nearest is 'depth'"),
        ("DEPTH", ["mass", "depth"], "nearest is 'depth'"),
        ("voltage", ["mass", "depth"], "known: 'depth', 'mass'"),
        ("q", [f"x{i}" for i in range(7)], "known: 'x0', 'x1', 'x2', 'x3', 'x4' and 2 more"),
        ("q", [f"x{i}" for i in range(6)], "known: 'x0', 'x1', 'x2', 'x3', 'x4', 'x5'"),
        ("q", [], "known: none"),
    ],
)
def test_a_name_is_suggested_only_if_it_is_near(name: str, known: list[str], suggestion: str) -> None:
    assert nearest(name, known) == suggestion


@pytest.mark.parametrize(
    ("count", "expected"), [(0, ""), (1, "0"), (3, "0, 1, 2"), (4, "0, 1, 2, 3"), (5, "0, 1, 2 and 2 more")]
)
def test_a_list_never_hides_one_word_alone(count: int, expected: str) -> None:
    assert listed([str(i) for i in range(count)], 3) == expected


@pytest.mark.parametrize(
    ("value", "text"),
    [(1e6, "1e6"), (1e-6, "1e-6"), (-1000.0, "-1000"), (0.0, "0"), (0.1, "0.1"), (0.1234567, "0.1234567"),
     (2147483647, "2147483647"), (2.5e-10, "2.5e-10")],
)  # fmt: skip
def test_a_number_is_written_as_a_reader_writes_it(value: float, text: str) -> None:
    assert number_text(value) == text
    assert float(text) == value


@pytest.mark.parametrize(
    ("low", "high", "unit", "text"),
    [
        (1e-6, 1e6, "rad/s", "1e-6 to 1e6 rad/s"),
        (-1.0, 1.0, "1", "-1 to 1"),
        (0.0, math.inf, "N", "at least 0 N"),
        (-math.inf, 0.4, None, "at most 0.4"),
        (-math.inf, math.inf, "m", "a finite number in m"),
    ],
)
def test_a_range_is_in_words(low: float, high: float, unit: str | None, text: str) -> None:
    assert range_text(low, high, unit) == text


@pytest.mark.parametrize(("count", "shown"), [(10, 10), (11, 11), (12, 11)])
def test_a_log_never_hides_one_message_alone(count: int, shown: int) -> None:
    lines = _shortened([f"message {i}" for i in (*range(count), 0)])
    assert len(lines) == shown
    assert lines[-1] == ("and 2 more" if count == 12 else f"message {count - 1}")
