"""What a prompt and a notebook show of a recording."""

import numpy as np
import pytest

from orchestration.errors import OrchestrationError
from orchestration.results.recording import Recording


def recording(count: int = 2, points: int = 3) -> Recording:
    names = tuple(f"a.x[{i}]" for i in range(count))
    values = np.outer(np.arange(points) - 1.0, np.arange(count) + 1.0)
    return Recording(names, ("m/s",) * count, 0.25 * np.arange(points), values)


def test_text_tells_the_span_and_each_signal() -> None:
    assert repr(recording()).splitlines() == [
        "Recording of 2 signals at 3 points, 0..0.5 s",
        "  signal  unit  least  largest  last",
        "  a.x[0]  m/s   -1     1        1",
        "  a.x[1]  m/s   -2     2        2",
    ]


def test_values_that_are_not_finite_are_seen() -> None:
    run = recording(1)
    run.values[1, 0] = np.nan
    assert repr(run).splitlines()[-1].split() == ["a.x[0]", "m/s", "nan", "nan", "1"]


def test_many_signals_are_counted_and_few_points_are_no_problem() -> None:
    assert repr(recording(31)).splitlines()[-1] == "and 1 more signal"
    assert "more" not in repr(recording(30))
    assert repr(recording(1, 0)).splitlines()[0] == "Recording of 1 signal at 0 points"
    assert recording(1, 0)._repr_html_()


def test_a_notebook_shows_the_same() -> None:
    run = Recording(("a.<b>",), ("m",), np.array([0.0]), np.array([[7.5]]))
    shown = run._repr_html_()
    assert shown.startswith("<pre>Recording of 1 signal at 1 point")
    assert "a.&lt;b&gt;" in shown


def test_the_unit_of_an_unknown_signal_offers_the_nearest() -> None:
    assert recording().unit("a.x[1]") == "m/s"
    with pytest.raises(OrchestrationError, match=r"nearest is 'a\.x\[1\]'"):
        recording().unit("a.y[1]")
