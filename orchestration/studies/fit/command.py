"""Command fit: parameters of a vehicle from logs of dives."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.files import write_text_atomically
from fmus.operating_system import usable_processors
from orchestration.cli import shared
from orchestration.cli.changes import NO_CHANGES, Changes, takes_changes

if TYPE_CHECKING:
    from orchestration.studies.fit.vehicle_fit import VehicleFit

PANEL = "Vehicles"


@takes_changes(
    plant="",
    settings="Set plant.variable=value; of a free parameter, its start.",
    mapped="Take this column of the data for data.NAME, or this variable of the plant for plant.NAME.",
)
def fit(
    plant: Annotated[str, typer.Argument(metavar="PLANT", help="An .fmu, a block or its .py file.")],
    data: Annotated[
        list[Path],
        typer.Option(metavar="FILE", help="Fit to this log of a dive (CSV), or to several at once."),
    ],
    free: Annotated[
        list[str],
        typer.Option(
            metavar="NAME,NAME=LOW:HIGH",
            help="Fit these parameters, within these limits; by default the limits of the FMU.",
        ),
    ],
    changes: Changes = NO_CHANGES,
    step_size: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Communication step; by default the step of the FMU."),
    ] = None,
    workers: Annotated[int, typer.Option(help="Dives that run at once.", min=1)] = usable_processors(),
    out: shared.OutFolder = Path("results"),
) -> None:
    """Fit parameters of a vehicle to measured depth and commands, with intervals.

    Writes a parameter file PLANT-fit.toml and the simulated dives (CSV and JSON), which report shows.
    For example, l1-depth fit RovDepthPlant --data dive.csv --free inertia fits one parameter.
    """
    import tomli_w

    from orchestration.studies.fit.dive import DATA, held_over, read_dive
    from orchestration.studies.fit.vehicle_fit import fit_vehicle, free_parameters
    from orchestration.studies.vehicle import Vehicle

    changes.check_of_plant(DATA)
    vehicle = Vehicle.of_changes(changes)
    shared.check_writable(out)
    parameters = free_parameters(free, vehicle)
    dives = [read_dive(path, vehicle, changes.mapping.get(DATA)) for path in data]
    for dive in dives:
        for message in held_over(dive):
            print(f"l1-depth: warning: {message}", file=sys.stderr)
    with shared.progress(f"fit {vehicle.name}, evaluations", 0) as bar:
        fitted = fit_vehicle(
            vehicle, dives, parameters, step_size, workers, lambda cost: bar.advance(note=f"{cost:.4g} m2")
        )
    print_fit(fitted)
    file = out / f"{vehicle.name}-fit.toml"
    out.mkdir(parents=True, exist_ok=True)
    write_text_atomically(file, tomli_w.dumps(fitted.parameters()))
    written = [file]
    for name in fitted.recordings:
        written += fitted.write(name, out / f"{vehicle.name}-fit-{name}.csv")
    print(*written, sep="\n")


def print_fit(fitted: "VehicleFit") -> None:
    """Prints the table of a fit, and the parameters that the data do not determine."""
    from rich.table import Table

    analysis = fitted.analysis
    table = Table("Parameter", "Value", "95 % interval", "Unit", "", title=f"Fit of {fitted.vehicle.name}")
    for one in analysis.estimates:
        interval = "" if one.note else f"{one.low:.5g} .. {one.high:.5g}"
        table.add_row(one.free.name, f"{one.value:.5g}", interval, one.free.unit, one.note)
    shared.print_table(table)
    for name, rmse in fitted.rmse.items():
        print(f"{name}: RMSE {1000.0 * rmse:.3g} mm of {len(fitted.recordings[name].time)} readings")
    count = f"{analysis.correlation_time:.3g}"
    is_one = "1 reading counts as one: residuals are not correlated"
    print(is_one if count == "1" else f"{count} readings count as one: residuals are correlated so long")
    for name in analysis.rough:
        print(f"rough interval: {name}: the depth is not linear in it over the interval")
    for kind, messages in (("not determined", analysis.undetermined), ("not to be trusted", analysis.doubts)):
        for message in messages:
            print(f"{kind}: {message}")
    if fitted.ended:
        print(f"l1-depth: warning: the search has not converged: {fitted.ended}", file=sys.stderr)
