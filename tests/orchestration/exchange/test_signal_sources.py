"""A scenario whose signals are components is the same experiment, whatever the units of its inputs."""

import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from fmus.files import write_archive
from fmus.fmi.description import describe, of_causality
from orchestration.cli.package_fmus import build_ramp_source
from orchestration.errors import ScenarioError
from orchestration.exchange import ssp_read, ssp_write
from orchestration.exchange.limits import RampSource, as_ramps, ramp_sources, with_sources
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.signals import Constant, Ramps, Signal, Table, sine
from orchestration.system.system import System
from tests.described_fmus import XML, members
from tests.shared_builds import Build

BuildSource = Callable[[RampSource, Path], Path]
STRAIGHT = Ramps(((1.0, 0.5), (2.0, 3.0), (2.5, 3.0), (4.0, -1.0)))
SMOOTH = Ramps(((0.0, 1.0), (1.0, 1.0), (2.0, 1.5), (4.0, 2.0)), smooth=True)  # as many points


UNITS = {
    "newton": ("N", '<BaseUnit kg="1" m="1" s="-2"/>'),
    "angular": ("rad/s", '<BaseUnit rad="1" s="-1"/>'),
    "furlong": ("furlong", '<BaseUnit m="1" factor="201.168"/>'),
    "unitless": ("", ""),
}


@pytest.fixture(scope="module")
def lags(linear: Build, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """First-order lags whose input and output have a unit, by name."""
    folder, plain = tmp_path_factory.mktemp("lags"), linear()
    for name, (unit, definition) in UNITS.items():
        content = members(plain)
        if unit:
            content[XML] = with_unit(content[XML], unit, definition)
        write_archive(folder / f"{name}.fmu", content)
    return {name: folder / f"{name}.fmu" for name in UNITS}


def with_unit(description: bytes, unit: str, definition: str) -> bytes:
    root = ElementTree.fromstring(description)
    units = f'<UnitDefinitions><Unit name="{unit}">{definition}</Unit></UnitDefinitions>'
    root.insert(1, ElementTree.fromstring(units))
    for variable in root.iter("ScalarVariable"):
        if variable.get("causality") in ("input", "output"):
            variable[0].set("unit", unit)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


@pytest.fixture(scope="module")
def build_once(tmp_path_factory: pytest.TempPathFactory) -> BuildSource:
    """`build_ramp_source`, which compiles equal sources once."""
    folder = tmp_path_factory.mktemp("sources")

    @cache
    def built(source: RampSource) -> Path:
        return build_ramp_source(source, folder / f"{len(list(folder.iterdir()))}")

    return lambda source, folder: Path(shutil.copy(built(source), folder))


def packaged(mine: Scenario, folder: Path, build: BuildSource) -> Recording:
    """What our master records of a scenario's package."""
    package = ssp_write.package(mine, folder / "mine.ssp", build)
    with ssp_read.opened(package) as loop:
        return simulate(loop.system, loop.experiment)


@pytest.mark.parametrize(
    ("name", "rounding"), [("nominal-extended", 0.0), ("nominal-extended-smooth", 1e-11)]
)
def test_the_run_is_the_scenarios_own(
    name: str, rounding: float, tmp_path: Path, build_once: BuildSource
) -> None:
    """Bit by bit; a smooth ramp but for the rounding of s^3, a product in C and a power in Python."""
    chosen = scenario.load(scenario.find(name))
    sources = ramp_sources([chosen])
    fmus = {target: build_once(source, tmp_path) for target, source in sources.items()}
    system, experiment = with_sources(chosen, sources, fmus)
    own, driven = simulate(chosen.system, chosen.experiment), simulate(system, experiment)
    assert driven.names[0] == "depth_reference.depth_reference"
    np.testing.assert_allclose(driven.values, own.values, rtol=0.0, atol=rounding)


@pytest.mark.slow
def test_inputs_of_every_unit_are_packaged(
    lags: dict[str, Path], tmp_path: Path, build_once: BuildSource
) -> None:
    """In N, in rad/s, in a unit that only the driven FMU defines, and without a unit; ramps are straight."""
    signals = {f"{name}.u[1]": STRAIGHT for name in lags}
    experiment = Experiment(5.0, 0.125, signals=signals)
    mine = Scenario("mine", "Ramps in every unit", System(lags), experiment, {})
    own, read_back = simulate(mine.system, mine.experiment), packaged(mine, tmp_path, build_once)
    np.testing.assert_array_equal(read_back.time, own.time)
    for name in lags:
        np.testing.assert_array_equal(read_back[f"{name}.y[1]"], own[f"{name}.y[1]"], err_msg=name)


@pytest.mark.slow
def test_the_source_has_the_name_and_the_unit_of_the_input(
    lags: dict[str, Path], tmp_path: Path, build_once: BuildSource
) -> None:
    signals = {f"{name}.u[1]": SMOOTH for name in lags}
    mine = Scenario("mine", "", System(lags), Experiment(5.0, 0.125, signals=signals), {})
    sources = ramp_sources([mine])
    assert sources["newton.u[1]"] == RampSource("u_1", "N", 4, lags["newton"])
    names = ["u_1", "angular_u_1", "furlong_u_1", "unitless_u_1"]
    assert [sources[target].name for target in signals] == names
    for name, unit in (("angular", "rad/s"), ("furlong", None)):
        source = sources[f"{name}.u[1]"]
        (output,) = of_causality(describe(build_once(source, tmp_path)), "output")
        assert (output.name, output.unit) == (source.name, unit)


@pytest.mark.slow
def test_one_point_and_many_points_are_handed_on(
    linear: Build, tmp_path: Path, build_once: BuildSource
) -> None:
    through = linear()
    many = Ramps([[0.125 * i, 0.1 * (-1) ** i] for i in range(7)])  # as many as the signals below have
    for signal in (Ramps([[1.0, 0.7]]), many):
        experiment = Experiment(4.0, 0.125, signals={"a.u[1]": signal})
        mine = Scenario("mine", "", System({"a": through}), experiment, {})
        own = simulate(mine.system, mine.experiment)
        np.testing.assert_array_equal(packaged(mine, tmp_path, build_once)["a.y[1]"], own["a.y[1]"])


@pytest.mark.parametrize(
    ("signal", "start"),
    [
        (Constant(0.7), 0.0),
        (Table([1.0, 2.0, 3.0, 3.5, 3.6, 3.7, 3.8], [0.0, 1.0, -1.0, 0.0, 0.1, 0.2, 0.3]), 0.0),
        (Table([0.0, 1.0, 1.125, 2.3], [0.0, 1.0, -1.0, 0.5], hold=True), 0.0),
        (Table([0.0, 1.0, 1.125, 2.3], [0.0, 1.0, -1.0, 0.5], hold=True), -0.05),
    ],
)
def test_a_constant_and_a_table_are_handed_on_as_ramps(
    linear: Build, tmp_path: Path, build_once: BuildSource, signal: Signal, start: float
) -> None:
    experiment = Experiment(start + 4.0, 0.125, start, signals={"a.u[1]": signal})
    mine = Scenario("mine", "", System({"a": linear()}), experiment, {})
    own, handed_on = simulate(mine.system, mine.experiment), packaged(mine, tmp_path, build_once)
    np.testing.assert_allclose(handed_on["a.y[1]"], own["a.y[1]"], atol=1e-14)  # rounding of values below 1


@pytest.mark.parametrize("start", [0.0, -3.0, 0.6])  # of 0.6 s the quotients round up
def test_the_ramps_of_a_jump_have_the_values_of_the_table_at_every_communication_point(start: float) -> None:
    """Of a jump at a point, two between points, and one at the first row."""
    times = start + np.array([0.25, 0.25, 0.5, 0.5, 0.8, 0.8, 0.85, 0.85, 1.5])
    table = Table(times, [7.0, 1.0, 2.0, -3.0, 4.0, 9.0, 9.5, -1.0, 0.0])
    experiment = Experiment(start + 2.0, 0.125, start)
    points = experiment.time_grid()
    assert as_ramps("a.u", table, experiment).at(points) == pytest.approx(table.at(points), abs=1e-12)
    before = points[3:5]  # a ramp of one communication step
    assert as_ramps("a.u", table, experiment)(float(before.mean())) == pytest.approx(-0.75, abs=0.01)


def test_another_signal_is_refused(linear: Build) -> None:
    experiment = Experiment(1.0, 0.125, signals={"a.u[1]": sine(1.0, 0.2)})
    mine = Scenario("mine", "", System({"a": linear()}), experiment, {})
    with pytest.raises(ScenarioError, match=r"signal a\.u\[1\]: expected ramps, .*; got sines"):
        ramp_sources([mine])
