"""The model description is complete, legal and derived."""

import math
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import pytest
from fmpy.validation import validate_fmu

from fmus.block import variable
from fmus.errors import ExportError
from fmus.generate import builder
from fmus.generate.archive import native_members, python_members
from fmus.generate.describe import model_description
from fmus.generate.trace import trace
from fmus.platforms import TARGETS, host_platform, library_name
from fmus.registry import Flavour
from tests.shared_builds import KINDS, Fmus, one_of_a_kind

NAMES = builder.block_names()


@pytest.fixture(params=one_of_a_kind(NAMES))
def fmu(request: pytest.FixtureRequest, either: dict[str, Path]) -> Path:
    """Each FMU of each flavour."""
    return either[request.param]


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_fmpy_finds_no_problem_in_the_python_flavour(python_built: Fmus, name: str) -> None:
    """Its model description is written by the same function."""
    assert validate_fmu(str(python_built[name])) == []


def test_everything_is_explicit(fmu: Path) -> None:
    description = fmpy.read_model_description(str(fmu))
    units = {unit.name for unit in description.unitDefinitions}
    for v in description.modelVariables:
        assert v.causality
        assert v.variability
        assert v.description
        assert len(v.name) <= 55, "Simulink truncates longer names"
        assert v.type != "Real" or v.unit in units
    has_states = description.numberOfContinuousStates > 0
    assert all(has_states or unknown.dependencies == [] for unknown in description.outputs)
    places = {id(v): i for i, v in enumerate(description.modelVariables)}
    indices = [places[id(unknown.variable)] for unknown in description.initialUnknowns]
    assert indices == sorted(indices)
    assert all(unknown.dependencies is not None for unknown in description.initialUnknowns)


def test_capabilities_and_enumerations(fmu: Path) -> None:
    description = fmpy.read_model_description(str(fmu))
    interface = description.coSimulation
    assert interface is not None
    assert not interface.needsExecutionTool
    assert interface.canGetAndSetFMUstate
    assert interface.canSerializeFMUstate
    assert interface.canHandleVariableCommunicationStepSize
    block = builder.load_block(fmu.stem)
    declared = {d.name: [i.name for i in d.items or []] for d in description.typeDefinitions}
    for v in block.variables:
        if v.enumeration:
            assert declared[v.enumeration.__name__] == [m.name.lower() for m in v.enumeration]


@pytest.mark.parametrize("name", one_of_a_kind(NAMES))
def test_both_flavours_have_the_same_variables(built: Fmus, python_built: Fmus, name: str) -> None:
    """But for continuous states and their derivatives, which the native flavour has for model exchange."""
    native, python = (fmpy.read_model_description(str(fmus[name])) for fmus in (built, python_built))
    of_block = [v for v in native.modelVariables if v.causality != "local"]
    for one, other in zip(of_block, python.modelVariables, strict=True):
        assert (one.name, one.valueReference, one.start) == (other.name, other.valueReference, other.start)
    assert native.guid != python.guid


@pytest.mark.parametrize("content", [native_members, python_members])
def test_the_guid_follows_the_content(content: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    block = builder.load_block("ExamplePlant")
    guid, _ = content(trace(block))
    assert content(trace(block))[0] == guid
    other = replace(block, description="another")
    monkeypatch.setattr("plant_fmu.example_plant.BLOCK", other)
    assert content(trace(other))[0] != guid


@pytest.mark.slow
@pytest.mark.parametrize("flavour", list(Flavour))
def test_builds_are_reproducible_byte_for_byte(
    built: Fmus, python_built: Fmus, tmp_path: Path, flavour: Flavour
) -> None:
    before = built if flavour is Flavour.NATIVE else python_built
    for name in KINDS:
        assert builder.build_block(name, tmp_path, flavour).read_bytes() == before[name].read_bytes()


def test_a_stale_fmu_is_rebuilt_and_a_fresh_one_kept(tmp_path: Path) -> None:
    path = tmp_path / "ExamplePlant.fmu"
    path.write_bytes(b"stale")
    builder.build_if_stale("ExamplePlant", tmp_path)
    assert zipfile.is_zipfile(path)
    assert [*tmp_path.iterdir()] == [path]
    before = path.stat().st_mtime_ns
    builder.build_if_stale("ExamplePlant", tmp_path)
    assert path.stat().st_mtime_ns == before


def test_a_native_fmu_of_another_platform_only_is_rebuilt_for_this_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = next(name for name in ("linux64", "aarch64-linux") if name != host_platform())
    # the C library of another platform takes ten seconds to compile
    monkeypatch.setitem(TARGETS, other, TARGETS[host_platform()])
    path = builder.build_block("ExamplePlant", tmp_path, platforms=[other])
    builder.build_if_stale("ExamplePlant", tmp_path)
    assert library_name("ExamplePlant", host_platform()) in zipfile.ZipFile(path).namelist()


def test_the_generation_date_is_utc_and_only_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    block = builder.load_block("ExamplePlant")
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    assert b"generationDateAndTime" not in model_description(block, "", {}, {})
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert b'generationDateAndTime="1970-01-01T00:00:00Z"' in model_description(block, "", {}, {})


def test_author_version_and_licence_are_those_of_the_block() -> None:
    """Somebody else's block is neither by us nor under our licence."""
    ours = builder.load_block("ExamplePlant")
    theirs = replace(ours, author="An author", version="2.1", license=None)
    described = [ElementTree.fromstring(model_description(block, "", {}, {})) for block in (ours, theirs)]
    given = [[root.get(name) for name in ("author", "version", "license")] for root in described]
    assert given == [[None, None, "MIT"], ["An author", "2.1", None]]


def test_an_unknown_unit_is_refused_with_the_nearest() -> None:
    @dataclass(frozen=True)
    class Outputs:
        state: float = variable(0.0, "A state", unit="N/Volt")

    block = replace(builder.load_block("ExamplePlant"), outputs=Outputs)
    block = replace(block, output=lambda t, state, p, c: Outputs(state.x[0]))
    with pytest.raises(ExportError, match="unknown unit 'N/Volt': no unit 'Volt'; nearest is 'volt'"):
        model_description(block, "", {}, {})


def test_units_are_defined_with_factor_and_offset_and_display_units_with_their_inverse() -> None:
    """FMI 2.0.5, 2.2.2: base = factor unit + offset, display unit = factor unit + offset."""

    @dataclass(frozen=True)
    class Outputs:
        angle: tuple = variable((0.0, 0.0), "Angle", unit="rad", display_unit=("deg", None))
        bath: float = variable(0.0, "Temperature", unit="degC", display_unit="K")
        length: float = variable(0.0, "Length", unit="mm")

    block = replace(builder.load_block("ExamplePlant"), outputs=Outputs)
    block = replace(block, output=lambda t, state, p, c: Outputs((state.x[0], 0.0)))
    root = ElementTree.fromstring(model_description(block, "", {}, {}))
    units = {unit.get("name"): [dict(part.attrib) for part in unit] for unit in root.iter("Unit")}
    assert units["rad"] == [{"rad": "1"}, {"name": "deg", "factor": repr(180.0 / math.pi)}]
    assert units["degC"] == [{"K": "1", "offset": "273.15"}, {"name": "K", "offset": "273.15"}]
    assert units["mm"] == [{"m": "1", "factor": "0.001"}]
    shown = {v.get("name"): v[0].get("displayUnit") for v in root.iter("ScalarVariable")}
    assert (shown["angle[1]"], shown["angle[2]"], shown["bath"]) == ("deg", None, "K")


def test_a_text_that_xml_cannot_hold_is_refused() -> None:
    block = replace(builder.load_block("ExamplePlant"), description="a bell \a")
    with pytest.raises(ExportError, match="ExamplePlant: expected texts that XML can hold"):
        model_description(block, "", {}, {})
