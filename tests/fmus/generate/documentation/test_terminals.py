"""Terminals are what FMI 3.0's schema says, name what exists, and are written on request."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmu_manipulation_toolbox.terminals import Terminals
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]
from typer.testing import CliRunner

from fmus.generate import builder
from fmus.generate.documentation.terminals_and_icon import PATH, terminals
from orchestration.cli.app import app

SCHEMA = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"
REFERENCE = {"depth_reference", "depth_reference_rate", "depth_reference_acceleration"}
NAMES = builder.block_names()


def written(name: str) -> bytes:
    return terminals(builder.load_block(name))[PATH]


@pytest.mark.parametrize("name", NAMES)
def test_the_file_is_valid_against_the_schema_of_fmi_3(name: str) -> None:
    etree.XMLSchema(etree.parse(SCHEMA)).assertValid(etree.fromstring(written(name)))


@pytest.mark.parametrize("name", NAMES)
def test_every_port_is_a_member_once_and_nothing_else_is(name: str) -> None:
    root: Any = etree.fromstring(written(name))
    for terminal, causality in (("inputs", "input"), ("outputs", "output")):
        listed = [member.get("variableName") for member in root.iterfind(f".//*[@name='{terminal}']/*")]
        assert listed == [v.name for v in builder.load_block(name).of_causality(causality)]


def test_an_fmu_has_terminals_only_on_request(tmp_path: Path, built: Mapping[str, Path]) -> None:
    """FMI Library takes them for a mistake in an FMU of FMI 2.0."""
    command = ["build", "ExamplePlant", "--flavour", "python", "--out", str(tmp_path), "--terminals"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    with (
        zipfile.ZipFile(tmp_path / "ExamplePlant.fmu") as requested,
        zipfile.ZipFile(built["L1Controller"]) as plain,
    ):
        assert requested.read(PATH) == written("ExamplePlant")
        assert not [name for name in plain.namelist() if name.startswith("terminals")]


@pytest.mark.parametrize(
    ("source", "target", "links"),
    [
        ("DepthReference", "L1DepthController", REFERENCE),
        ("L1DepthController", "RovDepthPlant", {"voltage[1]", "voltage[2]"}),
        ("RovDepthPlant", "L1DepthController", {"measured_depth"}),
        ("L1Controller", "ExamplePlant", {"control"}),
    ],
)
def test_outputs_plug_into_inputs_in_another_tool(
    tmp_path: Path, source: str, target: str, links: set[str]
) -> None:
    ends = []
    for name in (source, target):
        file = tmp_path / name / PATH
        file.parent.mkdir(parents=True)
        file.write_bytes(written(name))
        ends.append(Terminals(tmp_path / name))
    connected = ends[0]["outputs"].connect(ends[1]["inputs"])
    assert {a for a, b in connected if a == b} == links
    assert all(a == b for a, b in connected)
