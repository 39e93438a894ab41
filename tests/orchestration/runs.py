"""How tests end a run early, and what makes two recordings the same."""

from collections.abc import Callable

import numpy as np

from orchestration.results.recording import Recording


def interrupt_at(point: int) -> Callable[[int, int], None]:
    """A progress that interrupts a run which has reached this communication point."""

    def progress(done: int, total: int) -> None:
        if done >= point:
            raise KeyboardInterrupt

    return progress


def assert_same_bits(recording: Recording, expected: Recording, points: int | None = None) -> None:
    """Names, times and values are the same, up to so many communication points."""
    assert recording.names == expected.names
    assert np.array_equal(recording.time, expected.time[:points])
    assert np.array_equal(recording.values, expected.values[:points])
