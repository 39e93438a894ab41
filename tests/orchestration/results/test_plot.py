"""Figures of recordings, alone and over each other: their lines, their legends, and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from orchestration.errors import OrchestrationError
from orchestration.results.recording import Recording


def recording(count: int = 2, points: int = 3) -> Recording:
    names = tuple(f"a.x[{i}]" for i in range(count))
    values = np.outer(np.arange(points) - 1.0, np.arange(count) + 1.0)
    return Recording(names, ("m/s",) * count, 0.25 * np.arange(points), values)


def test_chosen_signals_are_plotted_over_time() -> None:
    run = recording(3)
    (panel,) = run.plot("a.x[2]", "a.x[0]").axes
    assert {line.get_label() for line in panel.get_lines()} == {"a.x[0]", "a.x[2]"}
    for line in panel.get_lines():
        np.testing.assert_array_equal(
            line.get_xydata(), np.column_stack([run.time, run[str(line.get_label())]])
        )
    (everything,) = run.plot().axes
    assert len(everything.get_lines()) == 3


def test_recordings_are_drawn_over_each_other_with_their_labels_in_the_legend() -> None:
    """A signal that both have with equal values is one line; one that the other does not have stays alone."""
    names, units = ("a.depth", "a.depth_reference", "a.force"), ("m", "m", "N")
    time = np.linspace(0.0, 1.0, 11)
    run = Recording(names, units, time, np.column_stack([time**2, time, time]))
    other = Recording(names[:2], units[:2], 2.0 * time, np.column_stack([time**3, time]))
    same_reference = replace(other, time=time)
    depth, force = run.plot(beside={"slower": other, "cubic": same_reference}).axes
    drawn = {str(line.get_label()): line for line in depth.get_lines()}
    assert [*drawn] == [
        "a.depth",
        "a.depth, slower",
        "a.depth, cubic",
        "a.depth_reference",
        "a.depth_reference, slower",
    ]
    np.testing.assert_array_equal(drawn["a.depth, slower"].get_xydata(), np.c_[2.0 * time, time**3])
    assert drawn["a.depth"].get_linestyle() != drawn["a.depth, slower"].get_linestyle()
    assert [line.get_label() for line in force.get_lines()] == ["a.force"]
    (panel,) = run.plot("a.depth", beside=other).axes
    assert [line.get_label() for line in panel.get_lines()] == ["a.depth", "a.depth, beside"]


def test_what_cannot_be_plotted_is_refused() -> None:
    run = recording()
    with pytest.raises(OrchestrationError, match=r"nearest is 'a\.x\[1\]'"):
        run.plot("a.x[0]", "a.y[1]")
    with pytest.raises(OrchestrationError, match=r"a recording of 2 runs: expected one, such as run\(0\)"):
        replace(run, values=np.stack([run.values, run.values])).plot()
    with pytest.raises(OrchestrationError, match=r"a recording of 2 runs: expected one, such as run\(0\)"):
        run.plot(beside=replace(run, values=np.stack([run.values, run.values])))
    in_cm = replace(run, units=("cm", *run.units[1:]))
    with pytest.raises(OrchestrationError, match=r"unit of a\.x\[0\] in 'log': expected '.*', got 'cm'"):
        run.plot("a.x[0]", beside={"log": in_cm})
    with pytest.raises(OrchestrationError, match=r"a\.x\[0\] is a String"):
        replace(run, strings={"a.x[0]": ("off", "on", "no")}).plot("a.x[0]")
