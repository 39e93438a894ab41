"""Terminals are what FMI 3.0's schema says, and name what exists."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmu_manipulation_toolbox.terminals import Terminals
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]

from fmus import catalogue
from fmus.documentation.terminals import PATH, terminals

SCHEMA = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"


REFERENCE = {"depth_reference", "depth_reference_rate", "depth_reference_acceleration"}


NAMES = catalogue.block_names()


def root_of(path: Path) -> Any:
    with zipfile.ZipFile(path) as archive:
        return etree.fromstring(archive.read(PATH))


@pytest.mark.parametrize("name", NAMES)
def test_the_file_is_valid_against_the_schema_of_fmi_3(built: Mapping[str, Path], name: str) -> None:
    etree.XMLSchema(etree.parse(SCHEMA)).assertValid(root_of(built[name]))


@pytest.mark.parametrize("name", NAMES)
def test_every_port_is_a_member_once_and_nothing_else_is(built: Mapping[str, Path], name: str) -> None:
    variables = fmpy.read_model_description(str(built[name])).modelVariables
    for terminal, causality in (("inputs", "input"), ("outputs", "output")):
        members = root_of(built[name]).iterfind(f".//*[@name='{terminal}']/*")
        listed = [member.get("variableName") for member in members]
        assert listed == [v.name for v in variables if v.causality == causality]


@pytest.mark.parametrize("name", NAMES)
def test_both_flavours_have_the_same_terminals(either: dict[str, Path], name: str) -> None:
    with zipfile.ZipFile(either[name]) as archive:
        assert archive.read(PATH) == terminals(catalogue.load_block(name))[PATH]


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
    built: Mapping[str, Path], tmp_path: Path, source: str, target: str, links: set[str]
) -> None:
    ends = []
    for name in (source, target):
        fmpy.extract(str(built[name]), str(tmp_path / name))
        ends.append(Terminals(tmp_path / name))
    connected = ends[0]["outputs"].connect(ends[1]["inputs"])
    assert {a for a, b in connected if a == b} == links
    assert all(a == b for a, b in connected)
