"""Delay margins through the FMUs against the second program of the loop, with the noise of its sensor."""

from dataclasses import replace

import numpy as np
import pytest

from orchestration.scenarios import scenario
from orchestration.studies.margins.fmu_margins import DELAYS, scan
from orchestration.studies.margins.hold import HoldRuns, LoopSignal
from tests.closed_loop.second_program import L1Case, LawStep, sampled
from tests.closed_loop.shipped_case import noisy_case

STEP, END = 0.02, 140.0  # s: of communication; when the reference leaves 0.8 m
JUDGED = 100.0  # s: since when the hold is judged
QUIET, MOVED = 3e-3, 0.04  # m
UNROUNDED = {"plant.sensor_resolution": 0.0}


def is_quiet(case: L1Case, signal: LoopSignal, delay: float, limit: float = QUIET) -> bool:
    late = {"control_delay" if signal is LoopSignal.CONTROL else "measurement_delay": delay}
    run = sampled(replace(case, **late), STEP, LawStep.BETWEEN_MEASUREMENTS)
    held = run["depth"][run["time"] >= JUDGED - 1e-9]
    return bool(np.std(held) < limit and abs(np.mean(held) - 0.8) < MOVED)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "settings"), [("nominal-l1", {}), ("nominal-extended", {}), ("nominal-extended", UNROUNDED)]
)
@pytest.mark.parametrize("signal", list(LoopSignal))
def test_a_second_program_loses_its_quietness_at_the_delay_that_was_measured(
    scenario_fmus: None, name: str, settings: dict[str, float], signal: LoopSignal
) -> None:
    """Within the resolution of 1 ms that the margin states; where the sensor rounds to 2 mm, in 2 ms and a
    tenth of the deviation that counts as quiet.

    Depths that differ by micrometres are rounded differently now and then, and are different realisations
    of the noise from then on; the deviation in the hold changes by a tenth with them.
    """
    loaded = scenario.load(scenario.find(name), {"parameters": settings})
    with HoldRuns(loaded) as runs:
        measured = scan(runs, signal, only_first_loss=True)
    case = noisy_case(replace(loaded, experiment=replace(loaded.experiment, stop_time=END)))
    apart, share = (DELAYS.resolution, 0.0) if settings else (2.0 * DELAYS.resolution, 0.1)
    assert is_quiet(case, signal, measured.margin - apart, (1.0 + share) * QUIET)
    assert not is_quiet(case, signal, measured.lost + apart, (1.0 - share) * QUIET)
