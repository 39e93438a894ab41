"""Command design: gains by rules from the data of a vehicle, checked over their ranges."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.errors import listed
from orchestration.cli import shared
from orchestration.cli.changes import CONTROLLER, NO_CHANGES, Changes, takes_changes
from orchestration.errors import OrchestrationError

if TYPE_CHECKING:
    from orchestration.scenarios.scenario import Scenario
    from orchestration.studies.design.parameter_file import DesignCheck
    from orchestration.studies.design.rules import Conditions, Gain

PANEL = "Vehicles"
PID = "PidDepthController"
_RUNS = {"L1": ("nominal-l1", ""), "L1 with PI": ("nominal-extended", ""), "PID": ("nominal-extended", PID)}
"""Title of a controller -> the scenario of its runs, and the controller in the place of the scenario's."""


@takes_changes(
    plant="",
    settings="Set plant.variable=value: data of the vehicle.",
    mapped="Take this variable of the plant for plant.NAME.",
)
def design(
    plant: Annotated[
        str, typer.Option(metavar="FMU", help="Design for this vehicle, an .fmu, a block or its .py file.")
    ] = "RovDepthPlant",
    changes: Changes = NO_CHANGES,
    bandwidth: Annotated[
        float,
        typer.Option(
            metavar="RAD/S",
            help="Bandwidth of the reference model A_m of L1, and of PID; 0 takes the largest that fits.",
            min=0.0,
            max=1e6,
        ),
    ] = 0.0,
    phase_margin: Annotated[
        float, typer.Option(metavar="DEG", help="Least phase margin in every corner.", min=1.0, max=80.0)
    ] = 20.0,
    draws: Annotated[
        int, typer.Option(metavar="NUMBER", help="Further runs, at random values in the ranges.", min=0)
    ] = 20,
    seed: Annotated[int, typer.Option(metavar="NUMBER", help="Seed of the random values.", min=0)] = 1,
    out: shared.OutFolder = Path("results"),
) -> None:
    """Design L1, its PI extension and PID for a vehicle, and check them in every corner of its ranges.

    Writes two parameter files, PLANT-l1.toml and PLANT-pid.toml.
    For example, l1-depth design --plant RovDepthPlant writes results/RovDepthPlant-l1.toml and -pid.toml.
    """
    from orchestration.studies.design import parameter_file, rules, vehicle_data
    from orchestration.studies.vehicle import Vehicle

    changes.check_of_plant()
    vehicle = Vehicle.of_changes(changes)
    drawn = vehicle_data.draws_of(vehicle)
    for message in vehicle_data.overruled(vehicle, drawn):
        print(f"l1-depth: warning: {message}", file=sys.stderr)
    data = vehicle_data.data_of(vehicle, drawn)
    shared.check_writable(out)
    scenarios = {title: _scenario(changes, *run) for title, run in _RUNS.items()}
    conditions = replace(_conditions(scenarios["L1"]), phase_margin=phase_margin)
    l1 = rules.design_l1(data, conditions, bandwidth)
    pid = rules.design_pid(data, conditions, bandwidth)
    l1_gains = parameter_file.l1_gains(l1, data, conditions)
    pid_gains = parameter_file.pid_gains(pid, data)
    gains = {"L1": l1_gains, "L1 with PI": l1_gains, "PID": pid_gains}
    values = [*vehicle_data.corners(vehicle, drawn), *vehicle_data.drawn(drawn, seed, draws)]
    with shared.progress("design", len(scenarios) * (len(values) + 1), 0.5) as bar:
        checks = [
            parameter_file.check(title, scenario, gains[title], values, bar.advance)
            for title, scenario in scenarios.items()
        ]
    _print(l1_gains, pid_gains, checks, f"{data.name}: {len(values) - draws} corners, {draws} draws")
    if failures := [line for one in checks for line in one.failures()]:
        raise OrchestrationError(
            f"{listed(failures, 1)}: no file is written; expected a smaller --bandwidth, a larger "
            "--phase-margin or narrower ranges in [vary.*]"
        )
    files = (("l1", l1_gains, l1, checks[:2]), ("pid", pid_gains, pid, checks[2:]))
    for ending, own, made, of_design in files:
        path = out / f"{data.name}-{ending}.toml"
        parameter_file.write(path, own, made.phase, made.delay, of_design)
        print(path)


def _scenario(changes: Changes, name: str, controller: str) -> "Scenario":
    from orchestration.cli import chosen_scenario

    others = {CONTROLLER: controller} if controller else {}
    chosen = replace(changes, settings={**changes.settings, **others})
    return chosen_scenario.load(name, changes=chosen, names_actuators=False)  # gains are designed over them


def _conditions(scenario: "Scenario") -> "Conditions":
    """Returns the conditions that the trajectory and the step of a scenario set."""
    import numpy as np

    from orchestration.studies.design.rules import Conditions
    from orchestration.system.signals import values_at

    times = scenario.experiment.time_grid()
    reference = values_at(scenario.experiment.signals["controller.depth_reference"], times)
    speed = np.abs(np.diff(reference) / np.diff(times)).max()
    return Conditions(scenario.experiment.step_size, float(speed), float(np.abs(reference).max()))


def _print(l1: "Sequence[Gain]", pid: "Sequence[Gain]", checks: "Sequence[DesignCheck]", title: str) -> None:
    """Prints the gains with their reasons, and the results of the runs."""
    from rich.table import Table

    from orchestration.studies.design.parameter_file import TABLE

    for name, gains in (("L1DepthController", l1), (PID, pid)):
        table = Table("Parameter", "Value", "Unit", "Reason", title=name, title_justify="left")
        for gain in (gain for gain in gains if not gain.name.startswith(TABLE)):
            table.add_row(
                gain.name,
                str(gain.value) if gain.value is True else f"{gain.value:g}",
                gain.unit,
                gain.source.removeprefix("designed: "),
            )
        shared.print_table(table)
    headings = "Controller", "RMSE [cm]", "Worst RMSE [cm]", "Worst settling [s]", "Settled", "Worst at"
    table = Table(*headings, title=title, title_justify="left")
    for row in _rows(checks):
        table.add_row(*row)
    shared.print_table(table)


def _rows(checks: "Sequence[DesignCheck]") -> Iterator[tuple[str, ...]]:
    for one in checks:
        settled = f"{len(one.rmse) - len(one.failed)} of {len(one.rmse)}"
        numbers = one.rmse[0], one.rmse[one.worst], one.longest_settling
        yield one.title, *(f"{number:.3g}" for number in numbers), settled, one.values_text(one.worst)
