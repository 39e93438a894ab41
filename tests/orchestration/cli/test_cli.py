"""The command line, as a user meets it: in a process of its own."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from orchestration.results.recording import Recording

SHORT = """
base = "{base}"
[experiment]
stop_time = {stop}
step_size = 0.02
[metrics.settling_time]
function = "settling_time"
signal = "plant.depth"
target = 0.8
band = 0.04
[metrics.overshoot]
function = "overshoot"
signal = "plant.depth"
target = 0.8
[metrics.holding_thrust]
function = "mean"
signal = "plant.total_force"
[metrics.lag]
function = "shift_lag"
signal = "plant.depth"
reference = "controller.depth_reference"
largest = 0.1
"""
SCENARIOS = Path(__file__).parents[3] / "orchestration" / "scenarios"


MAIN = "from orchestration.cli import main; main()"
INTERRUPTED_MAIN = """
from orchestration.cli import main
from orchestration.scenarios import reproduce
def interrupted(*arguments, **options):
    raise KeyboardInterrupt
reproduce.run = interrupted
main()
"""
LOADED_MAIN = """
import sys
from orchestration.cli import main
try:
    main()
finally:
    print(*sys.modules)
"""


def l1_depth(
    *arguments: object,
    folder: Path,
    expect: int = 0,
    main: str = MAIN,
    environment: Mapping[str, str] | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder whose temporary folder must be empty afterwards."""
    temporary = folder / "tmp"
    temporary.mkdir(exist_ok=True)
    done = subprocess.run(
        [sys.executable, "-c", main, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={
            **os.environ,
            "TMPDIR": str(temporary),
            "MPLCONFIGDIR": str(folder / "mpl"),
            **(environment or {}),
        },
    )
    assert done.returncode == expect, done.stderr
    assert not list(temporary.iterdir())
    return done


def short_scenario(folder: Path, stop: float = 0.2, more: str = "") -> Path:
    path = folder / "short.toml"
    path.write_text(SHORT.format(base=SCENARIOS / "nominal-extended.toml", stop=stop) + more)
    return path


def refused(*arguments: object, folder: Path) -> str:
    """The one line on standard error of a command that must fail."""
    done = l1_depth(*arguments, folder=folder, expect=1)
    assert done.stderr.startswith("l1-depth: ")
    assert done.stderr.count("\n") == 1
    return done.stderr


def test_help_names_every_command(tmp_path: Path) -> None:
    text = l1_depth("--help", folder=tmp_path).stdout
    for command in ("build", "check", "inspect", "run", "scenarios", "identify", "reproduce"):
        assert command in text


def test_build_check_inspect(tmp_path: Path) -> None:
    built = l1_depth("build", "ExamplePlant", "--flavour", "python", "--out", "out", folder=tmp_path)
    assert built.stdout == "out/ExamplePlant.fmu\n"
    table = l1_depth("inspect", "out/ExamplePlant.fmu", folder=tmp_path).stdout
    assert "disturbance" in table
    l1_depth("build", "L1Controller", "--out", "out", folder=tmp_path)
    judged = l1_depth("check", "out/L1Controller.fmu", folder=tmp_path).stdout
    assert " passed" in judged
    assert "error" not in judged
    lines = l1_depth("inspect", "out/L1Controller.fmu", folder=tmp_path).stdout.splitlines()
    (augmentation,) = [line for line in lines if "augmentation" in line]
    assert "1 (none), 2 (pi), 3 (nonlinear_p)" in augmentation
    assert "theta[1]" in table


def test_build_with_reference_writes_the_files_of_the_cross_check(tmp_path: Path) -> None:
    options = ("--flavour", "python", "--out", "out", "--with-reference")
    printed = l1_depth("build", "ExamplePlant", *options, folder=tmp_path).stdout.split()
    files = sorted(f"ExamplePlant{end}" for end in (".fmu", "_in.csv", "_ref.csv", "_ref.opt"))
    assert sorted(printed) == [str(Path("out") / file) for file in files]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == files


@pytest.mark.slow
def test_build_without_names_builds_all_five(tmp_path: Path) -> None:
    l1_depth("build", "--out", "out", folder=tmp_path)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "DepthReference.fmu", "ExamplePlant.fmu", "L1Controller.fmu", "L1DepthController.fmu",
        "RovDepthPlant.fmu",
    ]  # fmt: skip


def test_run_writes_recording_metrics_provenance_and_figure(tmp_path: Path) -> None:
    done = l1_depth("run", short_scenario(tmp_path), "--out", "out", folder=tmp_path)
    assert done.stderr == ""  # no bar where nobody looks
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "short.csv", "short.json", "short.png",
    ]  # fmt: skip
    recording = Recording.read(tmp_path / "out" / "short.csv")
    assert recording.time[-1] == 0.2
    assert recording.unit("plant.depth") == "m"
    document = json.loads((tmp_path / "out" / "short.json").read_text())
    assert document["scenario"]["parameters"]["controller.augmentation"] == "pi"
    assert len(document["run"]["fmus"]["plant"]["guid"]) == 36
    assert set(document["metrics"]) >= {"rmse", "holding_thrust"}


def test_run_writes_parquet_with_the_provenance_inside(tmp_path: Path) -> None:
    scenario = short_scenario(tmp_path)
    l1_depth("run", scenario, "--out", "csv", folder=tmp_path)
    l1_depth("run", scenario, "--out", "out", "--format", "parquet", folder=tmp_path)
    assert not (tmp_path / "out" / "short.csv").exists()
    recording, as_csv = (
        Recording.read(tmp_path / "out" / "short.parquet"),
        Recording.read(tmp_path / "csv" / "short.csv"),
    )
    assert (recording.names, recording.units) == (as_csv.names, as_csv.units)
    np.testing.assert_array_equal(recording.values, as_csv.values)
    assert recording.provenance["algorithm"] == "jacobi"


@pytest.mark.slow
def test_report_writes_one_page_of_what_run_wrote(tmp_path: Path) -> None:
    l1_depth("run", short_scenario(tmp_path), "--out", "out", folder=tmp_path)
    done = l1_depth("report", "out", "--out", "pages/report.html", "--title", "Mine", folder=tmp_path)
    assert (done.stdout, done.stderr) == ("pages/report.html\n", "")
    assert [path.name for path in (tmp_path / "pages").iterdir()] == ["report.html"]
    text = (tmp_path / "pages" / "report.html").read_text()
    assert "<title>Mine</title>" in text
    assert "&#34;plant.internal_step&#34; = 0.02" in text  # the resolved scenario
    assert "nearest is 'short.json'" in refused("report", "out/short.jsn", folder=tmp_path)


def test_a_run_that_fails_keeps_what_was_recorded(tmp_path: Path) -> None:
    failing = '\n[[events]]\ntime = 0.1\nset = { "plant.sensor_noise" = 1e3, "plant.inertia" = 0.1 }\n'
    failing += '\n[[events]]\ntime = 0.12\nset = { "plant.external_force" = 1e300 }\n'
    message = refused("run", short_scenario(tmp_path, more=failing), "--out", "out", folder=tmp_path)
    assert "plant at t = 0.12 s: fmi2DoStep returned" in message
    partial = Recording.read(tmp_path / "out" / "short.partial.csv")
    assert partial.time[-1] == pytest.approx(0.12)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["short.partial.csv"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nominal-l2"], "no scenario 'nominal-l2'; nearest is 'nominal-l1'"),
        (["run", "none.toml"], "no file none.toml"),
        (["build", "Benchmarkplan"], "no block named 'Benchmarkplan'; nearest is 'ExamplePlant'"),
        (["package", "nominal-l1.ssp"], "no scenario 'nominal-l1.ssp'; nearest is 'nominal-l1'"),
        (["run", "none.ssp", "--flavour", "python"], "a package: expected none, it holds its own FMUs"),
        (["build", "--platform", "linux46"], "no platform 'linux46'; nearest is 'linux64'"),
        (["build", "--platform", "linux64,"], "no platform ''"),
        (["build", "--platform", "win64", "--all-platforms"], "--all-platforms: expected one of them"),
        (["build", "--flavour", "python", "--platform", "win64"], "python flavour: expected none"),
        (["check", "none.fmu"], "no FMU at none.fmu"),
        (["inspect", "broken.fmu"], "broken.fmu is not an FMU: expected a zip"),
        (["check", "broken.fmu"], "1 error found: expected none"),
        (
            ["identify", "--evaluations", "5", "--starts", "9"],
            "evaluations 5: expected more than the 9 starts",
        ),
        (["build", "ExamplePlant", "--out", "broken.fmu"], "broken.fmu"),
    ],
)
def test_a_failure_is_one_line_and_exit_status_1(tmp_path: Path, arguments: list[str], message: str) -> None:
    (tmp_path / "broken.fmu").write_text("not a zip")
    assert message in refused(*arguments, folder=tmp_path)


def test_a_value_out_of_range_is_refused_before_the_run(tmp_path: Path) -> None:
    path = short_scenario(tmp_path, more='\n[parameters]\n"plant.inertia" = -1.0\n')
    assert "plant.inertia = -1.0: expected 0.1..1e+06 kg" in refused("run", path, folder=tmp_path)


def test_a_mistyped_name_offers_the_nearest(tmp_path: Path) -> None:
    assert "'build'" in l1_depth("buidl", folder=tmp_path, expect=2).stderr
    assert "--out" in l1_depth("run", "nominal-l1", "--oot", "x", folder=tmp_path, expect=2).stderr
    assert "nearest is 'pdf'" in refused("run", "nominal-l1", "--formats", "png,pfd", folder=tmp_path)


def test_bad_usage_is_exit_status_2(tmp_path: Path) -> None:
    done = l1_depth("run", folder=tmp_path, expect=2)
    assert "SCENARIO" in done.stderr
    done = l1_depth("build", "--flavour", "wasm", folder=tmp_path, expect=2)
    assert "'wasm' is not one of 'native', 'python'" in done.stderr


def test_an_interrupt_is_exit_status_130(tmp_path: Path) -> None:
    done = l1_depth("run", short_scenario(tmp_path), folder=tmp_path, expect=130, main=INTERRUPTED_MAIN)
    assert done.stderr == "l1-depth: interrupted\n"


@pytest.mark.parametrize("arguments", [["--help"], ["run", "-h"], ["buidl"], ["--version"]])
def test_help_and_bad_usage_load_nothing_heavy(tmp_path: Path, arguments: list[str]) -> None:
    """Nothing of these is what takes the time of a command that runs nothing."""
    done = l1_depth(*arguments, folder=tmp_path, expect=2 if "buidl" in arguments else 0, main=LOADED_MAIN)
    loaded = {name.partition(".")[0] for name in done.stdout.splitlines()[-1].split()}
    assert "typer" in loaded
    assert not loaded & {"numpy", "scipy", "matplotlib", "fmpy", "casadi", "pandas", "pyarrow", "dask"}


def test_sweep_help_names_the_table_of_the_file(tmp_path: Path) -> None:
    assert "[sweep]" in l1_depth("sweep", "--help", folder=tmp_path).stdout


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("run nominal-extended-", "nominal-extended-smooth"),
        ("build Rov", "RovDepthPlant"),
        ("rep", "reproduce"),
    ],
)
def test_shells_complete_commands_scenarios_and_blocks(tmp_path: Path, words: str, offered: str) -> None:
    asked = {
        "_L1_DEPTH_COMPLETE": "complete_bash",
        "COMP_WORDS": f"l1-depth {words}",
        "COMP_CWORD": str(len(words.split())),
    }
    done = l1_depth(folder=tmp_path, environment=asked)
    assert offered in done.stdout.split()
