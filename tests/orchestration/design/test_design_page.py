"""The table of the page on design is that of the runs."""

import re
from pathlib import Path

import pytest

from orchestration.design.check import Checked, check
from orchestration.design.parameter_file import l1_gains, pid_gains
from orchestration.design.rules import Conditions, L1Design, PidDesign
from orchestration.design.vehicle_data import VehicleData, corners, drawn, draws_of
from orchestration.scenarios import scenario
from orchestration.score.vehicle import Vehicle

PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "design.md"


def rows(vehicle: str) -> dict[str, list[str]]:
    """Controller -> the numbers of the page."""
    pattern = rf"^\| {vehicle} \| ([\w ]+) \| ([\d.]+) \| ([\d.]+) \|$"
    found = re.findall(pattern, PAGE.read_text(encoding="utf-8"), re.M)
    return {controller: numbers for controller, *numbers in found}


@pytest.mark.parametrize("title", ["L1", "L1 with PI", "PID"])
def test_the_table_has_the_errors_of_the_check(
    title: str, l1: L1Design, pid: PidDesign, data: VehicleData, conditions: Conditions
) -> None:
    draws = draws_of(Vehicle.of_base("vehicle"))
    places = [*corners(Vehicle.of_base("vehicle"), draws), *drawn(draws, 1, 20)]
    name = "nominal-l1" if title == "L1" else "nominal-extended"
    settings = {"controller": "PidDepthController"} if title == "PID" else {}
    chosen = scenario.load(scenario.find(name), settings=settings)
    gains = pid_gains(pid, data) if title == "PID" else l1_gains(l1, data, conditions)
    checked: Checked = check(title, chosen, gains, places)
    assert not checked.failed
    shown = f"{checked.rmse[0]:.3g}", f"{checked.rmse[checked.worst]:.3g}"
    assert rows(data.name)[title] == list(shown)
