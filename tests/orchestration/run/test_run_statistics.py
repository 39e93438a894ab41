"""Statistics of a run: phases and steps of FMUs are counted and measured, and change no result."""

import time
from pathlib import Path
from typing import Any

import pytest

from orchestration.errors import SimulationError
from orchestration.run import Simulator, simulate
from orchestration.run.checkpoint import Checkpoints, read_checkpoint
from orchestration.system.experiment import AlgorithmName, Experiment
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import RESUMABLE, coupled
from tests.orchestration.rogue_systems import doing, pair
from tests.orchestration.runs import assert_same_bits, interrupt_at
from tests.shared_builds import Build, Fmus

EXPERIMENT = Experiment(1.0, 0.1)
PHASES = ["loading", "initialisation", "stepping"]
SLOW_S = 0.005
SLOW = f"""
import time
class Slow:
    period, inputs, outputs = 0.1, {{"u": "1"}}, {{"y": "1"}}
    def reset(self): pass
    def step(self, t, inputs):
        time.sleep({SLOW_S})
        return {{"y": inputs["u"]}}
"""


def steps(statistics: dict[str, Any]) -> dict[str, int]:
    return {name: fmu["steps"] for name, fmu in statistics["fmus"].items()}


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
def test_every_step_is_counted_and_all_times_lie_within_the_run(
    linear: Build, algorithm: AlgorithmName
) -> None:
    experiment = Experiment(1.0, 0.1, algorithm=algorithm, step_sizes={"two": 0.3})
    with Simulator(coupled(linear)) as simulator:
        plain = simulator.run(experiment)
        simulator.close()
        before = time.perf_counter()
        recording = simulator.run(experiment, statistics=True)
        whole = time.perf_counter() - before
        again = simulator.run(experiment, statistics=True).provenance["statistics"]
        unasked = simulator.run(experiment)
    assert_same_bits(recording, plain)
    assert "statistics" not in plain.provenance | unasked.provenance
    found = recording.provenance["statistics"]
    assert steps(found) == steps(again) == {"one": 10, "two": 4}  # of 0.3 s, the last of 0.1 s
    assert list(found["phases_s"]) == PHASES
    assert min(found["phases_s"].values()) > 0.0
    assert sum(found["phases_s"].values()) < whole
    within = [*(fmu["wall_s"] for fmu in found["fmus"].values()), found["rest_of_loop_s"]]
    assert min(within) > 0.0
    assert sum(within) == pytest.approx(found["phases_s"]["stepping"])
    assert found["simulated_s"] == 1.0
    assert found["real_time_factor"] == 1.0 / found["phases_s"]["stepping"]
    assert again["phases_s"]["loading"] < found["phases_s"]["loading"]  # FMUs that were loaded are reset


@pytest.mark.slow
def test_time_is_that_of_the_fmu_that_takes_it(linear: Build, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    fmus = {"quick": linear(), "slow": f"{tmp_path / 'slow.py'}:Slow"}
    system = System(fmus, [("quick.y[1]", "slow.u"), ("slow.y", "quick.u[1]")])
    with Simulator(system) as simulator:
        found = simulator.run(EXPERIMENT, statistics=True).provenance["statistics"]
    assert found["fmus"]["slow"]["wall_s"] >= 9 * SLOW_S  # the first sample may be in the initialisation
    quick = found["fmus"]["quick"]["wall_s"] + found["rest_of_loop_s"]
    assert quick == pytest.approx(found["phases_s"]["stepping"] - found["fmus"]["slow"]["wall_s"])
    assert found["fmus"]["quick"]["wall_s"] < found["fmus"]["slow"]["wall_s"]
    # it sleeps, which takes no processor
    assert 0.0 < found["fmus"]["slow"]["cpu_s"] < 0.5 * found["fmus"]["slow"]["wall_s"]


def test_steps_on_threads_are_counted_but_leave_no_rest(linear: Build) -> None:
    """Their times overlap."""
    with Simulator(coupled(linear), threads=2) as simulator:
        found = simulator.run(EXPERIMENT, statistics=True).provenance["statistics"]
    assert steps(found) == {"one": 10, "two": 10}
    assert "rest_of_loop_s" not in found


def test_a_run_in_a_process_of_its_own_is_measured_there(linear: Build) -> None:
    found = simulate(coupled(linear), EXPERIMENT, timeout=60.0, statistics=True).provenance["statistics"]
    assert steps(found) == {"one": 10, "two": 10}
    assert min(found["phases_s"].values()) > 0.0


def test_a_run_that_fails_has_the_statistics_of_its_part(linear: Build, rogue: Build) -> None:
    with pytest.raises(SimulationError) as failure:
        simulate(pair(linear, rogue), doing(Misdeed.ERROR, 0.55), statistics=True)
    found = failure.value.recording.provenance["statistics"]
    assert steps(found) == {"rogue": 6 + 1, "lag": 6}  # that failed
    assert found["simulated_s"] == pytest.approx(0.6)


def test_a_run_that_fails_before_its_first_step_has_no_factor(built: Fmus) -> None:
    """Its parameters contradict each other."""
    contradictory = {"plant.net_weight": 100.0}
    experiment = Experiment(6.0, 0.1, 5.0, parameters=contradictory, open_inputs="start")
    with pytest.raises(SimulationError, match="net_weight below weight") as failure:
        simulate(System({"plant": built["RovDepthPlant"]}, []), experiment, statistics=True)
    assert [*failure.value.recording.provenance["statistics"]] == ["phases_s"]


def test_a_resumed_run_counts_from_its_checkpoint(linear: Build, tmp_path: Path) -> None:
    system, file = coupled(linear, **RESUMABLE), tmp_path / "half"
    with pytest.raises(SimulationError, match="interrupted"):
        simulate(system, EXPERIMENT, interrupt_at(5), checkpoints=Checkpoints(file, every=0.1))
    found = simulate(system, EXPERIMENT, resume=read_checkpoint(file), statistics=True).provenance
    assert steps(found["statistics"]) == {"one": 5, "two": 5}
    assert found["statistics"]["simulated_s"] == pytest.approx(0.5)
