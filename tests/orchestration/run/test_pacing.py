"""Real time: what is waited for, and what is counted as late; by a clock that the test turns."""

import pytest

from orchestration.run import run_recording
from orchestration.run.run_recording import Pacing


class Clock:
    """Stands still unless somebody sleeps or works."""

    def __init__(self) -> None:
        self.now = 100.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(run_recording, "time", clock)
    return clock


def test_points_are_waited_for_and_late_ones_counted(clock: Clock) -> None:
    pace = Pacing(factor=2.0)
    work = {0.0: 0.1, 1.0: 0.2, 2.0: 0.8, 3.0: 0.3, 4.0: 0.1}  # t -> seconds of the wall clock until the next
    reached = []
    for t, seconds in work.items():
        pace.wait(t, lambda: None)
        reached.append(clock.now - 100.0)
        clock.now += seconds
    assert reached == pytest.approx([0.0, 0.5, 1.0, 1.8, 2.1])
    assert pace.report() == pytest.approx(
        {"factor": 2.0, "missed_deadlines": 2, "worst_lateness_s": 0.3, "worst_at_s": 3.0}
    )


def test_real_time_begins_with_the_run_whenever_that_starts(clock: Clock) -> None:
    """At t = 100 s there is nothing to wait for, and nothing is late."""
    pace, reached = Pacing(factor=2.0), []
    for t in (100.0, 100.5):
        pace.wait(t, lambda: None)
        reached.append(clock.now - 100.0)
    assert reached == pytest.approx([0.0, 0.25])
    assert pace.missed == 0
