"""What is read of a model description: what FMPy reads, and a sentence about what cannot be read."""

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import pytest

from fmus.fmi.description import describe
from fmus.fmi.model_description import model_description
from fmus.units import BASES, UnitDefinition
from orchestration.errors import FmuLoadError
from tests.described_fmus import members

TEXT = """
<fmiModelDescription fmiVersion="2.0" modelName="Everything" guid="{g}" generationTool="a hand">
<CoSimulation modelIdentifier="everything" canInterpolateInputs="1" canGetAndSetFMUstate="false">
  <SourceFiles><File name="a.c"/></SourceFiles></CoSimulation>
<UnitDefinitions>
  <Unit name="cm/s"><BaseUnit m="1" s="-1" factor="0.01"/></Unit>
  <Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit> <Unit name="unknown"/>
</UnitDefinitions>
<TypeDefinitions>
  <SimpleType name="Speed"><Real unit="cm/s" min="-1" max="1" nominal="0.5"/></SimpleType>
  <SimpleType name="Mode"><Enumeration><Item name="off" value="1"/><Item name="on" value="7"/></Enumeration>
  </SimpleType>
</TypeDefinitions>
<DefaultExperiment stopTime="3" stepSize="1e-2"/>
<ModelVariables>
  <!-- no variable -->
  <ScalarVariable name="speed" valueReference="9" causality="output" description="how fast">
    <Real declaredType="Speed" max="2" start="0"/></ScalarVariable>
  <ScalarVariable name="mode" valueReference="9" causality="input" variability="discrete">
    <Annotations/><Enumeration declaredType="Mode" start="7"/></ScalarVariable>
  <ScalarVariable name="gain" valueReference="0" causality="parameter" variability="tunable">
    <Real unit="degC" start="1"/></ScalarVariable>
  <ScalarVariable name="count" valueReference="1" variability="fixed" initial="approx"><Integer min="0"/>
    </ScalarVariable>
  <ScalarVariable name="is on" valueReference="2" causality="output" variability="constant">
    <Boolean start="1"/></ScalarVariable>
  <ScalarVariable name="text" valueReference="3" causality="calculatedParameter" variability="fixed"><String/>
    </ScalarVariable>
  <ScalarVariable name="time" valueReference="4" causality="independent"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure>
  <Outputs><Unknown index="1" dependencies="2 3"/><Unknown index="5"/></Outputs>
  <InitialUnknowns><Unknown index="1" dependencies=""/></InitialUnknowns>
</ModelStructure>
</fmiModelDescription>
"""


def plain(value: Any, like: Any) -> Any:
    """The attributes that `like`, of ours, has; a variable among dependencies by its name."""
    if isinstance(like, list):
        assert len(value) == len(like)
        return [plain(item, other) for item, other in zip(value, like, strict=True)]
    if not hasattr(like, "__dataclass_fields__"):
        return value
    if isinstance(like, UnitDefinition):
        exponents = {base: n for base in BASES if (n := getattr(value, base, 0))}
        return value if value is like else UnitDefinition(exponents, value.factor, value.offset)
    of_ours = {"elements", "left_out", "units"}  # which FMPy does not tell, nor what begins with is_
    names = [name for name in vars(like) if not (name.startswith("is_") or name in of_ours)]
    if {"variable", "dependencies"} == {*names}:
        dependencies = value.dependencies
        return value.variable.name, None if dependencies is None else [v.name for v in dependencies]
    return {name: plain(getattr(value, name), getattr(like, name)) for name in names}


def assert_read_as_by_fmpy(xml: bytes, path: Path) -> None:
    ours = model_description(ElementTree.fromstring(xml))
    assert plain(ours, ours) == plain(fmpy.read_model_description(str(path), validate=False), ours)


def test_everything_that_fmpy_reads_is_read(tmp_path: Path) -> None:
    (tmp_path / "modelDescription.xml").write_text(TEXT)
    assert_read_as_by_fmpy(TEXT.encode(), tmp_path / "modelDescription.xml")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('"parameter" variability="tunable"', '"parameter" initial="exact"'),
        ('"parameter" variability="tunable"', '"parameter" variability="constant" initial="exact"'),
        ('"output" variability="constant"', '"output" variability="fixed" initial="exact"'),
    ],
)
def test_a_stated_initial_needs_no_default(before: str, after: str, tmp_path: Path) -> None:
    """The variability is one that the causality cannot have: to judge that is for `l1-depth check`."""
    assert before in TEXT
    (tmp_path / "modelDescription.xml").write_text(text := TEXT.replace(before, after, 1))
    assert_read_as_by_fmpy(text.encode(), tmp_path / "modelDescription.xml")


@pytest.mark.parametrize("name", ["L1DepthController", "RovDepthPlant"])
def test_the_shipped_fmus_are_read_as_by_fmpy(built: Mapping[str, Path], name: str) -> None:
    assert_read_as_by_fmpy(members(built[name])["modelDescription.xml"], built[name])


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('name="gain" ', "", "ScalarVariable has no name"),
        ('name="gain" valueReference="0"', 'name="gain"', "ScalarVariable gain has no valueReference"),
        ('valueReference="0"', 'valueReference="zero"', "invalid literal"),
        (
            'valueReference="0"',
            'valueReference="4294967296"',
            "gain: valueReference 4294967296: expected 0..",
        ),
        ('valueReference="0"', 'valueReference="-1"', "gain: valueReference -1: expected 0..4294967295"),
        ('<Integer min="0"/>', '<Integer start="2147483648"/>', "count: start 2147483648: expected -21474"),
        ('start="7"', 'start="-2147483649"', "mode: start -2147483649: expected -2147483648..2147483647"),
        ("<String/>", "<Text/>", "variable text has no type: expected one of Real, Integer"),
        ('declaredType="Speed"', 'declaredType="Spede"', "speed: declaredType 'Spede' is not defined"),
        ('variability="tunable"', 'variability="constant"', "causality 'parameter' of variability 'cons"),
        ('dependencies="2 3"', 'dependencies="2 8"', "Outputs: no variable 8: expected 1 to 7"),
        ('index="5"', 'index="0"', "Outputs: no variable 0: expected 1 to 7"),
        ('<Real unit="cm/s" min="-1" max="1" nominal="0.5"/>', "", "SimpleType Speed has no type"),
        (' value="7"', "", "Item on has no value"),
    ],
)
def test_what_cannot_be_read_is_named(before: str, after: str, message: str) -> None:
    assert before in TEXT
    with pytest.raises(ValueError, match=re.escape(message)):
        model_description(ElementTree.fromstring(TEXT.replace(before, after, 1)))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (
            "\n",
            '<?xml version="1.0" encoding="gb2312"?>\n',
            "multi-byte encodings are not supported: expected",
        ),
        ("\n", '<?xml version="1.0" encoding="unknown"?>\n', "expected XML in UTF-8"),
        ('name="gain" ', "", "ScalarVariable has no name"),
        ('name="gain" ', 'name="text" ', "2 variables are called 'text': expected one"),
    ],
)
def test_the_file_that_cannot_be_read_is_named(before: str, after: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "other.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", TEXT.replace(before, after, 1))
    with pytest.raises(FmuLoadError, match=re.escape(f"{path}: ") + ".*" + re.escape(message)):
        describe(path)
