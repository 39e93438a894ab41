"""Reference results: what the block computes, in files that other tools replay."""

import csv
import io
import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy.util import read_csv

from fmus.block import Block, variable
from fmus.block.guide import Experiment, Guide
from fmus.errors import ExportError
from fmus.generate import builder
from fmus.generate.documentation.reference_results import (
    LS_REF,
    RELATIVE_TOLERANCE,
    ReferenceRun,
    cross_check_files,
    reference_run,
)
from fmus.registry import Flavour
from tests.described_fmus import members
from tests.mutants.mutant import broken_rules
from tests.shared_builds import KINDS, one_of_a_kind

ROUNDING = 1e-10  # of an output's largest value: a thousand times what was ever seen
OF_EACH_KIND = [  # of an interpreter one alone: its build and its replay take long
    *((name, Flavour.NATIVE) for name in KINDS),
    ("ExamplePlant", Flavour.PYTHON),
]
OF_EACH_KIND += [
    pytest.param(*row, marks=pytest.mark.slow)
    for row in itertools.product(builder.block_names(), Flavour)
    if row not in OF_EACH_KIND
]
MOST_BYTES = 1_000_000  # of a table, by the rules of the cross-check


@cache
def run_of(name: str) -> ReferenceRun:
    return reference_run(builder.load_block(name))


@pytest.fixture(scope="module", params=one_of_a_kind(builder.block_names()))
def name(request: pytest.FixtureRequest) -> str:
    """Each block."""
    return request.param


@pytest.fixture(scope="module")
def folder(name: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the cross-check for the block."""
    folder = tmp_path_factory.mktemp("cross check")
    for file, data in cross_check_files(run_of(name), name).items():
        (folder / file).write_bytes(data)
    return folder


def options(folder: Path, name: str) -> dict[str, str]:
    """What NAME_ref.opt says."""
    lines = (folder / f"{name}_ref.opt").read_text("utf-8").splitlines()
    return {key: value for key, _, value in (line.partition(", ") for line in lines)}


def table(path: Path) -> Any:
    """A table of the cross-check as FMPy wants its input and gives its result."""
    return np.genfromtxt(path, delimiter=",", names=True, deletechars="", replace_space=" ")


def replayed(folder: Path, name: str, fmu: Path) -> tuple[Any, Any]:
    """(reference, what FMPy gets from the FMU with the files alone)."""
    said, inputs = options(folder, name), folder / f"{name}_in.csv"
    reference = table(folder / f"{name}_ref.csv")
    result: Any = fmpy.simulate_fmu(
        str(fmu),
        start_time=float(said["StartTime"]),
        stop_time=float(said["StopTime"]),
        output_interval=float(said["StepSize"]),
        input=read_csv(str(inputs)) if inputs.exists() else None,  # type: ignore[arg-type]
        output=reference.dtype.names[1:],
    )
    every = round(float(said["OutputIntervalLength"]) / float(said["StepSize"]))
    return reference, result[::every]


@pytest.mark.parametrize(("name", "either"), OF_EACH_KIND, indirect=True)
def test_an_importer_that_replays_the_files_gets_the_same(
    folder: Path, either: dict[str, Path], name: str
) -> None:
    """Rounding alone differs: elementary functions and interpolation, 1e-16 each, which the loops amplify."""
    reference, result = replayed(folder, name, either[name])
    assert len(result) == len(reference) > 100
    for output in reference.dtype.names:
        scale = np.abs(reference[output]).max()
        assert np.abs(result[output] - reference[output]).max() <= ROUNDING * scale, output


def test_the_experiment_moves_what_it_can(name: str) -> None:
    """Constant at start values are: what is held (omega_hat), switched off (u_p, u_f, sigma_u), has no gain
    (u_m), or is the curvature of straight ramps."""
    run = run_of(name)
    columns = dict(zip(run.outputs, np.array(run.output_rows).T[1:], strict=True))
    constant = [output for output, values in columns.items() if np.ptp(values) == 0.0]
    still = {output.removeprefix("pitch_") for output in constant}
    switched_off = {"u_p", "u_f", "sigma_u", "theta_hat[2]", "sigma_hat"}
    assert still <= {"omega_hat", "u_m", "depth_reference_acceleration", *switched_off}
    assert len(columns) > 2 * len(still)


def test_the_tables_keep_the_rules_of_the_cross_check(folder: Path, name: str) -> None:
    names = {v.name for v in builder.load_block(name).variables}
    for path in folder.glob(f"{name}_*.csv"):
        assert path.stat().st_size < MOST_BYTES
        lines = path.read_text("utf-8").splitlines()
        header = next(csv.reader(io.StringIO(lines[0])))
        assert lines[0].startswith('"time",')
        assert set(header[1:]) <= names
        rows = [[float(cell) for cell in line.split(",")] for line in lines[1:]]
        assert {len(row) for row in rows} == {len(header)}
        times = [row[0] for row in rows]
        assert times == sorted(set(times))
        stop = float(options(folder, name)["StopTime"])
        assert (times[0], times[-1]) == (0.0, stop)


def test_the_options_are_those_that_the_cross_check_requires(folder: Path, name: str) -> None:
    said = options(folder, name)
    assert list(said)[:4] == ["StartTime", "StopTime", "StepSize", "RelTol"]
    assert float(said["RelTol"]) == RELATIVE_TOLERANCE > ROUNDING
    steps = float(said["StopTime"]) / float(said["StepSize"])
    assert steps == pytest.approx(round(steps), rel=1e-12)  # a product of the step size, rounded once


@pytest.mark.parametrize(("name", "either"), OF_EACH_KIND, indirect=True)
def test_the_manifest_describes_every_file_of_the_layered_standard(
    either: dict[str, Path], name: str
) -> None:
    content = members(either[name])
    files = {m.removeprefix(f"extra/{LS_REF}/") for m in content if m.startswith("extra/")}
    manifest = ElementTree.fromstring(content[f"extra/{LS_REF}/fmi-ls-manifest.xml"])
    related = {str(entry.get("source")): str(entry.get("role")) for entry in manifest}
    assert manifest.tag == "fmiReferences"
    assert set(related) | {"fmi-ls-manifest.xml"} == files
    assert sorted(related.values()) == sorted(["experiment", "result", "other"][: len(related)])
    keys = {key.rpartition("}")[2]: value for key, value in manifest.attrib.items()}
    assert keys["fmi-ls-name"] == LS_REF
    assert {key.partition("}")[0] for key in manifest.attrib} == {"{http://fmi-standard.org/fmi-ls-manifest"}


def test_the_experiment_inside_is_the_one_beside(built: Mapping[str, Path], folder: Path, name: str) -> None:
    prefix = f"extra/{LS_REF}/{name}"
    content = members(built[name])
    (experiment,) = ElementTree.fromstring(content[f"{prefix}.exp"])
    for file in {entry.get("source") for entry in experiment if entry.get("source")}:
        assert content[f"extra/{LS_REF}/{file}"] == (folder / str(file)).read_bytes()
    settings = experiment.find("TransientSimulation")
    assert settings is not None
    assert settings.get("stopTime") == options(folder, name)["StopTime"]
    assert settings.get("stepSize") == options(folder, name)["StepSize"]


def test_the_same_block_gives_the_same_files() -> None:
    again = reference_run(builder.load_block("RovDepthPlant"))
    assert again is not run_of("RovDepthPlant")
    one, other = (cross_check_files(run, "RovDepthPlant") for run in (run_of("RovDepthPlant"), again))
    assert one == other


def of(**experiment: Any) -> Block:
    guide = Guide(experiment=Experiment(**experiment))
    return replace(builder.load_block("ExamplePlant"), guide=guide)


@pytest.mark.parametrize(
    ("stimuli", "expected"),
    [
        ((("contrl", ((0.0, 1.0),)),), "no Real input 'contrl'; nearest is 'control'"),
        ((("control", ()),), "control: expected points at increasing times"),
        ((("control", ((1.0, 0.0), (1.0, 1.0))),), "control: expected points at increasing times"),
    ],
)
def test_a_stimulus_that_fits_nothing_is_refused(stimuli: Any, expected: str) -> None:
    with pytest.raises(ExportError, match=expected):
        reference_run(of(stimuli=stimuli))


@pytest.mark.parametrize(("stop_time", "steps"), [(1e300, "1e+303"), (1.7e308, "inf"), (10_001.0, "1e+07")])
def test_an_experiment_that_no_build_finishes_is_refused_until_the_guide_has_a_shorter_one(
    stop_time: float, steps: str
) -> None:
    block = replace(builder.load_block("ExamplePlant"), guide=Guide(), stop_time=stop_time, step_size=1e-3)
    with pytest.raises(ExportError) as refusal:
        reference_run(block)
    assert f"{steps} steps of 0.001 s to {stop_time!r} s: expected at most 1e+07" in str(refusal.value)
    (hint,) = re.findall(r"guide=(Guide\(.*\)) from", str(refusal.value))
    guide = eval(hint, {"Guide": Guide, "Experiment": Experiment})
    assert reference_run(replace(block, guide=guide)).stop_time == pytest.approx(1.0)


def test_a_stimulus_outside_the_experiment_is_cut_off() -> None:
    run = reference_run(of(stop_time=1.0, stimuli=(("control", ((-1.0, 0.0), (3.0, 4.0))),)))
    assert [(row[0], row[1]) for row in run.input_rows] == [(0.0, 1.0), (1.0, 2.0)]


def test_without_an_experiment_the_block_runs_its_own_with_inputs_at_rest() -> None:
    block = replace(builder.load_block("ExamplePlant"), guide=Guide(), stop_time=0.05)
    run = reference_run(block)
    assert (run.stop_time, run.step_size) == (0.05, block.step_size)
    assert all(value == 0.0 for row in run.input_rows for value in row[1:])


def test_every_step_of_the_experiment_has_the_length_that_its_files_state() -> None:
    """A timer that ends at a communication point ends there for whoever replays it, in spite of rounding."""

    @dataclass(frozen=True)
    class Timer:
        elapsed: float = 0.0

    @dataclass(frozen=True)
    class Outputs:
        elapsed: float = variable(0.0, "Sum of the steps", unit="s")

    block = Block(
        "Timer", "Adds up the steps", outputs=Outputs, state=Timer, stop_time=0.5,
        step=lambda t, h, s, u, p, c: Timer(s.elapsed + h), output=lambda t, s, p, c: Outputs(s.elapsed),
    )  # fmt: skip
    run = reference_run(block)
    assert run.output_rows[-1][1] == sum([run.step_size] * 50)


SCALE = np.float64(2.0)
ONE: Any = np.int64(1)
DRIVEN: Any = (("u", ((np.float64(0.0), np.float64(0.0)), (np.float32(0.5), ONE))),)


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(
        np.float64(0.01), "Step", unit="s", min=np.float64(1e-3), max=ONE, nominal=np.float64(0.1)
    )


@dataclass(frozen=True)
class Calculated:
    scale: float = variable(0.0, "Scale")


@dataclass(frozen=True)
class Inputs:
    u: float = variable(0.5 * SCALE, "Input", min=-SCALE, max=2 * ONE)


@dataclass(frozen=True)
class State:
    x: float = 0.0


@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "Output", nominal=np.float64(1.0))
    n: int = variable(0, "Number")
    positive: bool = variable(False, "Whether it is positive")


NUMPY = Block.of_module(
    __name__,
    "Numpy",
    "Constants and declarations of NumPy",
    calculate=lambda p: Calculated(SCALE * np.float64(1.5)),
    step=lambda t, h, s, u, p, c: State(s.x + h * SCALE * u.u),
    output=lambda t, s, p, c: Outputs(SCALE * s.x, 3 * ONE, s.x > np.float64(0.0)),
    stop_time=np.float64(1.0),
    step_size=np.float64(0.01),
    guide=Guide(experiment=Experiment(np.float64(0.8), np.float64(0.02), DRIVEN)),
)


@pytest.mark.slow
def test_no_file_of_an_fmu_has_a_number_in_the_words_of_numpy(tmp_path: Path) -> None:
    texts = members(builder.build_block(NUMPY, tmp_path)).items()
    assert [n for n, text in texts if b"np." in text and not n.startswith("binaries/")] == []
    assert broken_rules(tmp_path / "Numpy.fmu") == {}
