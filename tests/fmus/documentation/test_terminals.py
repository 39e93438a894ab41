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


@pytest.fixture(scope="module")
def described(built: Mapping[str, Path]) -> dict[str, Any]:
    """Root element of the file in each FMU, by name."""
    roots = {}
    for name, path in built.items():
        with zipfile.ZipFile(path) as archive:
            roots[name] = etree.fromstring(archive.read(PATH))
    return roots


def test_the_file_is_valid_against_the_schema_of_fmi_3(described: dict[str, Any]) -> None:
    schema = etree.XMLSchema(etree.parse(SCHEMA))
    for root in described.values():
        schema.assertValid(root)


def test_every_port_is_a_member_once_and_nothing_else_is(
    described: dict[str, Any], built: Mapping[str, Path]
) -> None:
    for name, root in described.items():
        variables = fmpy.read_model_description(str(built[name])).modelVariables
        for terminal, causality in (("inputs", "input"), ("outputs", "output")):
            members = [member.get("variableName") for member in root.iterfind(f".//*[@name='{terminal}']/*")]
            assert members == [v.name for v in variables if v.causality == causality]


def test_both_flavours_have_the_same_terminals(either: dict[str, Path]) -> None:
    for name, path in either.items():
        with zipfile.ZipFile(path) as archive:
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
