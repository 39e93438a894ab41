"""A factor and an offset of a connection in an SSP package."""

from pathlib import Path

from fmus.files import write_archive
from orchestration.exchange import ssp_read, ssp_write
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.system import LinearTransformation
from tests.described_fmus import described, members

SCENARIO = """
connections = [["a.y", "b.u", { factor = 0.001, offset = -0.5 }], ["a.y", "b.v"]]
[components]
a = "a.fmu"
b = "b.fmu"
[experiment]
stop_time = 1.0
step_size = 0.1
"""


def packaged(folder: Path, unit: str, of_output: str = "mm") -> tuple[Scenario, Path]:
    """The scenario and its package; unit: of the input."""
    described(folder / "a.fmu", outputs=["y"], units={"y": of_output})
    described(folder / "b.fmu", inputs=["u", "v"], units={"u": unit})
    (folder / "mine.toml").write_text(SCENARIO)
    written = scenario.load(folder / "mine.toml")
    return written, ssp_write.package(written, folder / "mine.ssp", lambda source, folder: folder)


def test_a_package_holds_the_factor_and_the_offset(tmp_path: Path) -> None:
    written, package = packaged(tmp_path, "m")
    with ssp_read.opened(package) as loaded:
        assert loaded.system.connections == written.system.connections
        assert loaded.system.connections[0] == ("a.y", "b.u", LinearTransformation(0.001, -0.5))
        assert loaded.resolved["connections"][0] == ["a.y", "b.u", {"factor": 0.001, "offset": -0.5}]


def without_the_attribute(package: Path) -> Path:
    """The package as one whose importer converts units too."""
    attribute, content = b' suppressUnitConversion="true"', members(package)
    assert content["SystemStructure.ssd"].count(attribute) == 1
    changed = {name: data.replace(attribute, b"") for name, data in content.items()}
    return write_archive(package.with_stem("changed"), changed)


def test_a_transformation_acts_behind_the_conversion_of_units(tmp_path: Path) -> None:
    with ssp_read.opened(without_the_attribute(packaged(tmp_path, "m")[1])) as loaded:
        # 0.001 of a value in m, which is 1e-3 of the one in mm
        assert loaded.system.connections[0] == ("a.y", "b.u", LinearTransformation(1e-6, -0.5))
    with ssp_read.opened(without_the_attribute(packaged(tmp_path, "K", "degC")[1])) as loaded:
        expected = LinearTransformation(0.001, 0.001 * 273.15 - 0.5)
        assert loaded.system.connections[0] == ("a.y", "b.u", expected)


def test_a_transformation_between_equal_units_needs_no_attribute(tmp_path: Path) -> None:
    with ssp_read.opened(without_the_attribute(packaged(tmp_path, "mm")[1])) as loaded:
        assert loaded.system.connections[0] == ("a.y", "b.u", LinearTransformation(0.001, -0.5))
