"""The words that error messages share."""

import pytest

from fmus.errors import nearest


@pytest.mark.parametrize(
    ("name", "known", "suggestion"),
    [
        ("dpeth", ["mass", "depth"], "nearest is 'depth'"),
        ("DEPTH", ["mass", "depth"], "nearest is 'depth'"),
        ("voltage", ["mass", "depth"], "known: 'depth', 'mass'"),
        ("q", [f"x{i}" for i in range(7)], "known: 'x0', 'x1', 'x2', 'x3', 'x4' and 2 more"),
        ("q", [], "there are none"),
    ],
)
def test_a_name_is_suggested_only_if_it_is_near(name: str, known: list[str], suggestion: str) -> None:
    assert nearest(name, known) == suggestion
