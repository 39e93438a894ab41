"""Steps go to threads where that is faster. That the results are equal is a claim of test_combinations.py."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orchestration.errors import OrchestrationError, SimulationError
from orchestration.run import Simulator
from orchestration.run.compiled_loop import StepThreads
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.orchestration.runs import interrupt_at

LIGHT_S, HEAVY_S, FIRST_S = 1e-6, 1e-3, 5e-3


class Loop:
    """A loop whose steps take a time on clocks of its own, which threads multiply, and the first one longer.

    shared: of each batch whether threads shared its steps
    """

    def __init__(
        self, step_s: float, with_threads: float, gauss_seidel: int = 0, independent: int = 1
    ) -> None:
        self.now, self.shared, self._costs = 0.0, list[bool](), (step_s, step_s * with_threads)
        members = {"team": np.zeros(6, np.int64), "instances": np.zeros(2)}
        self.wiring: Any = SimpleNamespace(**members, gauss_seidel=gauss_seidel, independent=independent)

    def run(self, first: int, last: int) -> int:
        self.shared.append(bool(self.wiring.team[0]))
        self.now += (last - first) * self._costs[self.shared[-1]] + (FIRST_S if not first else 0.0)
        return last

    def batches(self, count: int, threads: int | None = None) -> list[bool]:
        """Of so many batches whether threads shared the steps."""
        functions: Any = SimpleNamespace(run=self.run, help=lambda: None)
        steps = StepThreads(
            self.wiring, functions, threads, processors=2, clocks=(lambda: self.now, lambda: self.now)
        )
        for batch in range(count):
            first, last = 10 * batch - 9 if batch else 0, 10 * batch + 1
            assert steps.run(first, last) == last
        steps.close()
        return self.shared


@pytest.mark.parametrize(
    ("step_s", "with_threads", "expected"),
    [
        (LIGHT_S, 0.5, [False, False, False, False]),
        (HEAVY_S, 0.5, [False, False, True, True]),
        (HEAVY_S, 1.1, [False, False, True, False]),
    ],
    ids=["light FMUs", "heavy FMUs", "heavy FMUs on busy processors"],
)
def test_threads_share_steps_that_they_make_faster(
    step_s: float, with_threads: float, expected: list[bool]
) -> None:
    assert Loop(step_s, with_threads).batches(4) == expected


def test_components_of_gauss_seidel_wait_for_each_other() -> None:
    assert Loop(HEAVY_S, 0.5, gauss_seidel=1).batches(2, threads=2) == [False, False]


def test_fmus_that_may_share_memory_stay_on_one_thread_unless_threads_are_asked_for() -> None:
    assert Loop(HEAVY_S, 0.5, independent=0).batches(3) == [False, False, False]
    assert Loop(LIGHT_S, 2.0, independent=0).batches(2, threads=2) == [True, True]


def test_an_interrupt_ends_a_run_on_threads(built: Mapping[str, Path]) -> None:
    """The one of a progress is taken as one of the keyboard: between two batches."""
    system = System(dict.fromkeys(("one", "two"), built["ExamplePlant"]))
    experiment = Experiment(1.0, 1e-3, open_inputs="start")
    with Simulator(system, threads=2) as simulator:
        with pytest.raises(SimulationError, match=r"^interrupted$") as caught:
            simulator.run(experiment, interrupt_at(1))
        assert len(caught.value.recording.time) > 1
        assert len(simulator.run(replace(experiment, stop_time=0.1)).time) == 101


def test_less_than_one_thread_is_refused() -> None:
    with pytest.raises(OrchestrationError, match="threads: 0: expected at least 1"):
        Simulator(System({}), threads=0)
