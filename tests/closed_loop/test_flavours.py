"""Both flavours are one model: the same trajectories, and from them the same tables."""

from dataclasses import replace

import numpy as np
import pytest

from fmus.registry import Flavour
from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import run_files, scenario
from orchestration.scenarios.run_files import Result

# Python and C make the same double-precision operations in the same order, none contracted. A constant
# that CasADi inverted (x / 6 as x * (1 / 6)) or an elementary function may differ in its last bit, 1e-16;
# the fast adaptation loop of the example enlarges that to some 1e-12 of an estimate's amplitude. 1e-9 leaves
# room for other C libraries and is still far below everything that is measured.
AGREEMENT = 1e-9


def assert_same_trajectories(native: Recording, python: Recording) -> None:
    assert native.names == python.names
    assert np.array_equal(native.time, python.time)
    amplitude = np.abs(python.values).max(axis=0)
    assert np.all(np.abs(native.values - python.values) <= AGREEMENT * amplitude)
    assert native.provenance["fmus"] != python.provenance["fmus"]


ADDITIONS = {
    "controller.adaptation_law": "piecewise_constant", "controller.reference_feedforward": "inside",
}  # fmt: skip


# all others are the same blocks with other parameters, or the example, which takes a minute
WHOLE = "nominal-extended"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        *((name, {}) for name in run_files.reproduced() if name != WHOLE),
        ("example-extended", ADDITIONS),
    ],
)
def test_the_first_second_agrees(
    scenario_fmus: None, python_fmus: None, name: str, settings: dict[str, str]
) -> None:

    def first_second(flavour: Flavour) -> Recording:
        chosen = scenario.load(scenario.find(name), flavour=flavour, settings=settings)
        return simulate(chosen.system, replace(chosen.experiment, stop_time=1.0))

    assert_same_trajectories(first_second(Flavour.NATIVE), first_second(Flavour.PYTHON))


@pytest.mark.slow
def test_trajectories_and_metrics_agree(results: dict[str, Result], python_fmus: None) -> None:
    chosen = scenario.load(scenario.find(WHOLE), flavour=Flavour.PYTHON)
    recording = simulate(chosen.system, chosen.experiment)
    assert_same_trajectories(results[WHOLE].recording, recording)
    values = metrics.evaluate(recording, chosen.metrics)
    # a small overshoot, in percent, is the difference of two depths
    assert values == pytest.approx(results[WHOLE].metrics, rel=1e-6, abs=100.0 * AGREEMENT, nan_ok=True)
