"""The command fit: from a log to a parameter file that a scenario takes, and a page."""

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from orchestration import Experiment, simulate
from orchestration.cli import chosen_scenario
from orchestration.cli.changes import Changes
from orchestration.report.find import found_results
from orchestration.report.render import render
from orchestration.results.recording import Recording
from orchestration.studies.fit.command import print_fit
from orchestration.studies.fit.least_squares import Analysis
from orchestration.system.signals import Ramps
from orchestration.system.system import System

Command = Callable[..., Any]
COLUMNS = ("--map", "data.time=t", "--map", "data.depth=z", "--map", "data.control_force=F")


@pytest.fixture
def log(command: Command, tmp_path: Path) -> Path:
    """A dive of the vehicle that `l1-depth new` writes, with 12 kg; semicolons, decimal commas."""
    command("new", "rover", "--vehicle")
    (fmu,) = (
        Path(line) for line in command("build", "rover.py").stdout.splitlines() if line.endswith(".fmu")
    )
    run = simulate(
        System({"plant": fmu}),
        Experiment(
            stop_time=20.0,
            step_size=0.02,
            parameters={"plant.mass": 12.0, "plant.initial_depth": 2.0},
            signals={"plant.control_force": Ramps([[0.0, 0.0], [5.0, 4.0], [10.0, -1.0], [20.0, 2.0]])},
            record=["plant.measured_depth", "plant.control_force"],
            open_inputs="start",
        ),
    )
    rows = zip(run.time[::2], run["plant.measured_depth"][::2], run["plant.control_force"][::2], strict=True)
    lines = ["t;z [m];F [N]", *(";".join(f"{x:.6g}".replace(".", ",") for x in row) for row in rows)]
    path = tmp_path / "dive.csv"
    path.write_text("\n".join(lines))
    return path


def test_a_vehicle_of_ones_own_is_fitted_and_a_scenario_takes_the_values(
    command: Command, tmp_path: Path, log: Path
) -> None:
    done = command("fit", "rover.py", "--data", log, "--free", "mass,linear_drag", *COLUMNS)
    files = [f"results/rover-fit{end}" for end in (".toml", "-dive.csv", "-dive.json")]
    assert done.stdout.replace("\\", "/").splitlines()[-3:] == files
    written = tomllib.loads((tmp_path / files[0]).read_text())["parameters"]
    values = {name: entry["value"] for name, entry in written.items()}
    assert values.keys() == {"plant.mass", "plant.linear_drag"}
    # the ramps are sampled every 40 ms and held: as if they were 20 ms late, of some seconds
    assert values["plant.mass"] == pytest.approx(12.0, rel=0.02)
    recording = Recording.read(tmp_path / files[1])
    assert recording.names == (
        "plant.depth", "data.measured_depth", "data.residual", "plant.control_force",
    )  # fmt: skip
    assert recording.units == ("m", "m", "m", "N")
    depth, measured, residual, _ = recording.values.T
    assert depth - measured == pytest.approx(residual, abs=1e-12)  # of rounding
    assert 0.0 < max(abs(residual)) < 0.02  # m: some cm/s for the 20 ms by which held ramps are late
    page = render(found_results([tmp_path / files[2]]))
    assert "data.measured_depth" in page
    assert "rover fitted to dive" in page
    (tmp_path / "mine.toml").write_text(f'base = "nominal-extended"\nparameter_files = ["{files[0]}"]\n')
    chosen = chosen_scenario.load("mine.toml", changes=Changes({"plant": "rover.py"}))
    assert chosen.experiment.parameters["plant.mass"] == values["plant.mass"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "columns"),
    [
        pytest.param("rover.py", ("control_force",), marks=pytest.mark.slow),
        ("RovDepthPlant", ("voltage[1]", "voltage[2]")),
    ],
)
def test_the_how_to_compares_with_the_sensor_of_a_vehicle_that_has_noise_and_of_one_that_has_none(
    command: Command, log: Path, vehicle: str, columns: tuple[str, ...]
) -> None:
    page = (Path(__file__).parents[4] / "docs" / "how-to" / "fit-a-vehicle.md").read_text(encoding="utf-8")
    mapped, settings = re.findall(r"`(--map plant\.depth=\S+|--set plant\.\S+ --set \S+)`", page)
    options = [*mapped.split(), *(settings.split() if vehicle == "RovDepthPlant" else ())]
    columns_of = [part for name in columns for part in ("--map", f"data.{name}=F")]
    free = "mass" if vehicle == "rover.py" else "inertia"
    log.write_text(log.read_text().replace("F [N]", "F"))  # which stands for volts, too
    command("fit", vehicle, "--data", log, "--free", free, *COLUMNS[:4], *columns_of, *options)


@pytest.mark.parametrize(
    ("correlated", "line"),
    [
        (1.0, "1 reading counts as one: residuals are not correlated"),
        (3.0, "3 readings count as one: residuals are correlated so long"),
    ],
)
def test_one_reading_is_spoken_of_as_one(
    capsys: pytest.CaptureFixture[str], correlated: float, line: str
) -> None:
    fitted: Any = SimpleNamespace(
        vehicle=SimpleNamespace(name="rover"),
        analysis=Analysis((), 0.0, correlated, (), (), ("few readings",)),
        rmse={},
        ended="",
    )
    print_fit(fitted)
    lines = capsys.readouterr().out.splitlines()
    assert lines == [*lines[:-2], line, "not to be trusted: few readings"]


def test_a_mistake_is_one_line(refused: Command, log: Path) -> None:
    for options, message in (
        (["--free", "mas"], "--free mas: expected a parameter of type Real; nearest is 'mass'"),
        (["--free", "mass", "--set", "controller.kp=1"], "controller.kp: expected plant.NAME"),
        (["--free", "mass", *COLUMNS[4:], "--step-size", "nan"], "step size nan s: expected a finite number"),
        (["--free", "mass", "--map", "depth=z"], "controller.depth: expected plant.NAME or data.NAME"),
        (["--free", "mass", "--map", "data.time=zeit"], "no column 'zeit'"),
        (["--free", "mass", "--map", "data.control_force=nothing"], "no column 'nothing'"),
    ):
        assert message in refused("fit", "rover.py", "--data", log, *COLUMNS[:4], *options)
