"""A factor and an offset of a connection in an SSP package."""

from pathlib import Path

from orchestration.exchange import ssp_read, ssp_write
from orchestration.scenarios import scenario
from orchestration.system.transformation import LinearTransformation
from tests.described_fmus import described

SCENARIO = """
connections = [["a.y", "b.u", { factor = 0.001, offset = -0.5 }], ["a.y", "b.v"]]
[components]
a = "a.fmu"
b = "b.fmu"
[experiment]
stop_time = 1.0
step_size = 0.1
"""


def test_a_package_holds_the_factor_and_the_offset(tmp_path: Path) -> None:
    described(tmp_path / "a.fmu", outputs=["y"])
    described(tmp_path / "b.fmu", inputs=["u", "v"])
    (tmp_path / "mine.toml").write_text(SCENARIO)
    written = scenario.load(tmp_path / "mine.toml")
    package = ssp_write.package(written, tmp_path / "mine.ssp", lambda source, folder: folder)
    with ssp_read.opened(package) as loaded:
        assert loaded.system.connections == written.system.connections
        assert loaded.system.connections[0] == ("a.y", "b.u", LinearTransformation(0.001, -0.5))
        assert loaded.resolved["connections"][0] == ["a.y", "b.u", {"factor": 0.001, "offset": -0.5}]
