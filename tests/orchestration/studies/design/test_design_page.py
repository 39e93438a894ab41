"""The tables of the page on design are those of the runs."""

import itertools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from orchestration.scenarios import scenario
from orchestration.studies.design.parameter_file import check, l1_gains, pid_gains
from orchestration.studies.design.rules import Conditions
from orchestration.studies.design.vehicle_data import corners, drawn

TITLES = "L1", "L1 with PI", "PID"
PAGE = Path(__file__).parents[4] / "docs" / "explanation" / "design.md"


def rows(vehicle: str) -> dict[str, list[str]]:
    """Controller -> the numbers of the page."""
    pattern = rf"^\| {vehicle} \| ([\w ]+) \| ([\d.]+) \| ([\d.]+) \|$"
    listed = re.findall(pattern, PAGE.read_text(encoding="utf-8"), re.M)
    return {controller: numbers for controller, *numbers in listed}


@pytest.mark.slow
@pytest.mark.parametrize(("vehicle", "title"), itertools.product(["RovDepthPlant", "BlueRov2Plant"], TITLES))
def test_the_table_has_the_errors_of_the_check(
    vehicle: str, title: str, designed: Callable[[str], Any], conditions: Conditions
) -> None:
    """Every corner settles, and the extended law stays below 2 cm in each."""
    made = designed(vehicle)
    values = [*corners(made.vehicle, made.draws), *drawn(made.draws, 1, 20)]
    name = "nominal-l1" if title == "L1" else "nominal-extended"
    settings = {"plant": vehicle} | ({"controller": "PidDepthController"} if title == "PID" else {})
    chosen = scenario.load(scenario.find(name), settings=settings)
    gains = pid_gains(made.pid, made.data) if title == "PID" else l1_gains(made.l1, made.data, conditions)
    checked = check(title, chosen, gains, values)
    assert not checked.failed
    assert rows(vehicle).keys() == {*TITLES}
    assert rows(vehicle)[title] == [f"{checked.rmse[0]:.3g}", f"{checked.rmse[checked.worst]:.3g}"]
    assert title != "L1 with PI" or checked.rmse[checked.worst] < 2.0


@pytest.mark.slow
def test_noise_beyond_the_ranges_costs_what_the_page_states(
    designed: Callable[[str], Any], conditions: Conditions
) -> None:
    made = designed("BlueRov2Plant")
    chosen = scenario.load(scenario.find("nominal-extended"), settings={"plant": "BlueRov2Plant"})
    noisy = [{"plant.sensor_noise": 0.02}]
    rmse = check("L1 with PI", chosen, l1_gains(made.l1, made.data, conditions), noisy).rmse
    assert f"has {rmse[1]:.1f} cm on `BlueRov2Plant` in place of {rmse[0]:.2f} cm" in PAGE.read_text("utf-8")
