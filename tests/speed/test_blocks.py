"""How long a step takes: `pytest --benchmark-enable tests/benchmarks`. Without it each runs once, untimed.

No time is a pass or a fail: machines differ and are noisy. What is asserted is that the work was done.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fmus import catalogue
from fmus.registry import Flavour
from orchestration.fmi.description import describe
from orchestration.fmi.instance import FmuInstance
from orchestration.master import simulate
from orchestration.scenarios import scenario


@pytest.mark.parametrize("flavour", list(Flavour))
@pytest.mark.parametrize("name", catalogue.block_names())
def test_one_step_of_an_fmu(
    built: dict[str, Path], python_built: dict[str, Path], benchmark: Any, name: str, flavour: Flavour
) -> None:
    path = (built if flavour is Flavour.NATIVE else python_built)[name]
    with FmuInstance("it", path, describe(path)) as it:
        it.initialise(0.0, None)
        it.exit_initialization_mode()
        taken = iter(range(10**9))

        def step() -> None:
            it.do_step(next(taken) * 0.01, 0.01)

        benchmark(step)
        assert next(taken) > 0


@pytest.mark.parametrize("flavour", list(Flavour))
def test_the_nominal_scenario_in_this_master(benchmark: Any, flavour: Flavour) -> None:
    chosen = scenario.load(scenario.find("nominal-extended"), flavour=flavour)
    catalogue.build_missing(chosen.system.components.values())
    recording = benchmark(simulate, chosen.system, replace(chosen.experiment, stop_time=20.0))
    assert recording.time[-1] == 20.0
