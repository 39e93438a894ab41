"""What is read of a model description of FMI 3.0: what FMPy reads, by scalars; and what cannot be loaded."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any

import fmpy
import pytest

from fmus.errors import ExportError, FmuLoadError
from fmus.files import write_archive
from fmus.fmi import fmi3
from fmus.fmi.description import describe
from fmus.fmi.instance import FmuInstance
from fmus.fmi.model_description import ModelDescription
from fmus.platforms import SHARED_LIBRARY_SUFFIX, host_platform, platform_folder
from tests.described_fmus import XML, members
from tests.shared_builds import Build

TEXT = """
<fmiModelDescription fmiVersion="3.0" modelName="Everything" instantiationToken="{g}" generationTool="a hand">
<CoSimulation modelIdentifier="everything" canGetAndSetFMUState="1" canSerializeFMUState="true"
  canHandleVariableCommunicationStepSize="true" providesDirectionalDerivatives="true"/>
<UnitDefinitions><Unit name="cm/s"><BaseUnit m="1" s="-1" factor="0.01"/></Unit></UnitDefinitions>
<TypeDefinitions>
  <Float64Type name="Speed" unit="cm/s" relativeQuantity="true" min="-1" max="1" nominal="0.5"/>
  <UInt8Type name="Small" max="9"/>
  <EnumerationType name="Mode"><Item name="off" value="-1"/><Item name="on" value="7"/></EnumerationType>
</TypeDefinitions>
<DefaultExperiment stopTime="3" stepSize="1e-2"/>
<ModelVariables>
  <Float64 name="time" valueReference="0" causality="independent"/>
  <Float64 name="speed" valueReference="9" causality="output" declaredType="Speed" description="how fast">
    <Dimension start="2"/><Dimension valueReference="7"/></Float64>
  <Float64 name="der(speed)" valueReference="8" derivative="9"><Dimension start="2"/></Float64>
  <UInt64 name="rows" valueReference="7" causality="structuralParameter" start="3"/>
  <Enumeration name="mode" valueReference="6" causality="input" declaredType="Mode" start="7"/>
  <Float64 name="gain" valueReference="5" causality="parameter" variability="tunable" start="1 2 3">
    <Dimension valueReference="7"/></Float64>
  <Float32 name="same" valueReference="4" causality="parameter" start="1.5"><Dimension start="2"/></Float32>
  <Int16 name="count" valueReference="3" variability="fixed" initial="approx" min="0" start="1"/>
  <UInt8 name="small" valueReference="11" causality="input" declaredType="Small" start="1"/>
  <Boolean name="is on" valueReference="12" causality="output" variability="constant" start="1"/>
  <String name="text" valueReference="13" causality="parameter"><Dimension start="2"/>
    <Start value="ab"/><Start value="c"/></String>
  <Binary name="frame" valueReference="14" causality="input"><Start value="ff"/></Binary>
  <Clock name="tick" valueReference="15" causality="input" intervalVariability="triggered"/>
  <Int32 name="derived" valueReference="16" causality="calculatedParameter"/>
</ModelVariables>
<ModelStructure>
  <Output valueReference="9" dependencies="6 5"/><Output valueReference="12"/>
  <InitialUnknown valueReference="9" dependencies=""/>
  <InitialUnknown valueReference="16" dependencies="14 3"/>
</ModelStructure>
</fmiModelDescription>
"""
OF_FMI_2 = {"Float64": "Real", "Float32": "Real", "Enumeration": "Enumeration", "Boolean": "Boolean"}
LIMITS = {"Int16": ("-32768", "32767"), "UInt8": ("0", "255"), "UInt64": ("0", str(2**31 - 1))}
LIMITS["Int32"] = (str(-(2**31)), str(2**31 - 1))


@pytest.fixture
def described(tmp_path: Path) -> Callable[..., ModelDescription]:
    """The description of an FMU of TEXT with one text replaced by another."""

    def describe_changed(old: str = "", new: str = "") -> ModelDescription:
        assert old in TEXT
        path = write_archive(tmp_path / "everything.fmu", {XML: TEXT.replace(old, new).encode()})
        return describe(path)

    return describe_changed


def of_fmpy(path: Path) -> tuple[list[Any], list[list[Any]]]:
    """Returns the scalars as they follow from FMPy's variables, and the dependencies of the outputs."""
    read: Any = fmpy.read_model_description(str(path), validate=False)
    sizes = {v.valueReference: v.start for v in read.modelVariables}
    rows, names = [], {}
    for v in read.modelVariables:
        shape = [int(d.start or sizes[d.valueReference]) for d in v.dimensions]
        indices = [[]]
        for size in shape:
            indices = [[*index, str(i + 1)] for index in indices for i in range(size)]
        stem, end = ("der(speed", ")") if v.name == "der(speed)" else (v.name, "")
        names[id(v)] = [f"{stem}[{','.join(i)}]{end}" if i else v.name for i in indices]
        if v.type in ("Binary", "Clock"):
            continue
        declared = v.declaredType
        start = str(v.start or "").split() if v.type != "String" else []  # of which FMPy reads the first
        own = LIMITS.get(v.type, (None, None))
        stated = [getattr(v, n) or (declared and getattr(declared, n, None)) for n in ("min", "max")]
        is_relative = bool(declared and declared.relativeQuantity)  # FMPy reads that of a type alone
        low, high = (given or limit for given, limit in zip(stated, own, strict=True))
        kind = OF_FMI_2.get(v.type, "String" if v.type == "String" else "Integer")
        for i, name in enumerate(names[id(v)]):
            begin = (start * math.prod(shape) if len(start) == 1 else start)[i] if start else None
            own_row = (kind, v.causality, v.variability, v.description, begin, low, high, is_relative)
            rows.append((name, v.valueReference, *own_row))
    outputs = [
        [names[id(u.variable)], None if u.dependencies is None else [names[id(d)] for d in u.dependencies]]
        for u in read.outputs
    ]
    return rows, outputs


def test_a_variable_states_that_it_is_a_relative_quantity(described: Callable[..., ModelDescription]) -> None:
    ours = described('name="same"', 'name="same" relativeQuantity="1"')
    assert {v.name for v in ours.modelVariables if v.is_relative and "speed" not in v.name} == {
        "same[1]",
        "same[2]",
    }


def test_everything_that_fmpy_reads_is_read(
    described: Callable[..., ModelDescription], tmp_path: Path
) -> None:
    ours = described()
    rows, outputs = of_fmpy(tmp_path / "everything.fmu")
    read = attrgetter("type", "causality", "variability", "description", "start", "min", "max", "is_relative")
    variables = [v if v.type != "String" else replace(v, start=None) for v in ours.modelVariables]
    assert [(v.name, ours.elements[i].reference, *read(v)) for i, v in enumerate(variables)] == rows
    assert [v.valueReference for v in ours.modelVariables] == [*range(len(rows))]
    flat = [(name, known and [*chain(*known)]) for group, known in outputs for name in group]
    found = [(u.variable.name, u.dependencies and [v.name for v in u.dependencies]) for u in ours.outputs]
    assert found == flat
    assert ours.left_out == {"frame": "Binary", "tick": "Clock"}


def test_a_variable_of_a_clock_is_left_out(described: Callable[..., ModelDescription]) -> None:
    read = described('valueReference="9" causality', 'valueReference="9" clocks="15" causality')
    assert read.left_out == {"frame": "Binary", "tick": "Clock", "speed": "Float64 of a Clock"}
    assert [u.variable.name for u in read.outputs] == ["is on"]
    assert "speed[1,1]" not in [v.name for v in read.modelVariables]


def test_defaults_are_those_of_the_standard(described: Callable[..., ModelDescription]) -> None:
    variables = {v.name: v for v in described().modelVariables}
    assert {name: v.initial for name, v in variables.items() if not name.startswith(("speed[", "gain["))} == {
        "time": None, "der(speed[1])": "calculated", "der(speed[2])": "calculated", "rows": "exact",
        "mode": "exact", "same[1]": "exact", "same[2]": "exact", "count": "approx", "small": "exact",
        "is on": "exact", "text[1]": "exact", "text[2]": "exact", "derived": "calculated",
    }  # fmt: skip
    speed, small = variables["speed[2,3]"], variables["small"]
    assert (speed.unit, speed.nominal, speed.initial) == ("cm/s", "0.5", "calculated")
    assert (small.min, small.max) == ("0", "9")
    wide = described('min="0" start="1"', 'min="-99999" start="1"')
    assert {v.min for v in wide.modelVariables if v.name == "count"} == {"-32768"}
    assert [variables[f"text[{i}]"].start for i in (1, 2)] == ["ab", "c"]
    assert [item.value for item in variables["mode"].declaredType.items] == ["-1", "7"]  # type: ignore


def test_capabilities_have_the_names_of_fmi_2(described: Callable[..., ModelDescription]) -> None:
    read = described().coSimulation
    assert read.canGetAndSetFMUstate
    assert read.canSerializeFMUstate
    assert read.canHandleVariableCommunicationStepSize
    assert not read.canInterpolateInputs
    assert not read.providesDirectionalDerivative


@pytest.mark.parametrize("kind", ["Float64", "Float32", "Int32", "UInt8", "Boolean", "String"])
def test_a_variability_that_is_not_stated_follows_from_type_and_causality(
    described: Callable[..., ModelDescription], kind: str
) -> None:
    """FMI 3.0.2, 2.4.7.4: continuous for both floating-point types, discrete for others; fixed parameters."""
    variables = "".join(
        f'<{kind} name="{name}" valueReference="{40 + i}" causality="{causality}"/>'
        for i, (name, causality) in enumerate([("x", "local"), ("y", "output"), ("k", "parameter")])
    )
    read = described("</ModelVariables>", f"{variables}</ModelVariables>")
    found = {v.name: v.variability for v in read.modelVariables}
    moving = "continuous" if kind.startswith("Float") else "discrete"
    assert [found[name] for name in "xyk"] == [moving, moving, "fixed"]


def test_an_attribute_start_of_a_string_which_the_schema_lacks_is_no_value(
    described: Callable[..., ModelDescription],
) -> None:
    read = described(
        "</ModelVariables>", '<String name="s" valueReference="40" start="a b"/></ModelVariables>'
    )
    assert [v.start for v in read.modelVariables if v.name == "s"] == [None]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('fmiVersion="3.0"', 'fmiVersion="1.0"', "is an FMU of FMI 1.0: expected FMI 2.0 or 3.0"),
        ("CoSimulation", "ScheduledExecution", "neither CoSimulation nor ModelExchange: expected"),
        ('start="1 2 3"', 'start="1 2"', "variable gain: 2 start values: expected 1 or 3"),
        ('min="0" start="1"', 'min="0" start="1 2"', "variable count: 2 start values: expected 1$"),
        ('structuralParameter" start="3"', 'structuralParameter" start="0"', "dimensions .2, 0.: expected"),
        ('start="3"/>', 'start="900000"/>', "variable speed: expected at most 1000000 scalars in all"),
        ('variability="tunable"', 'variability="odd"', "variable gain: variability 'odd': expected one of"),
        ('declaredType="Mode"', 'declaredType="Mood"', "variable mode: declaredType 'Mood' is not defined"),
        ("<Int32 name", "<Int24 name", "variable derived: type 'Int24': expected one of Float64, Float32, I"),
        ('valueReference="4"', 'valueReference="-4"', "variable same: valueReference -4: expected 0..42949"),
        ('modelIdentifier="everything"', "", "CoSimulation has no modelIdentifier"),
        ('name="count"', 'name="small"', "everything.fmu: 2 variables are called 'small': expected one"),
        ('name="count"', 'name="gain[3]"', r"2 variables are called 'gain\[3\]': expected one"),
        ('name="count"', 'name="tick"', "2 variables are called 'tick': expected one"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_named(
    described: Callable[..., ModelDescription], old: str, new: str, message: str
) -> None:
    with pytest.raises(FmuLoadError, match=message):
        described(old, new)


def test_a_library_of_another_standard_or_platform_is_refused(linear: Build, tmp_path: Path) -> None:
    of_2, of_3 = members(linear()), members(linear(fmi=3))
    (library,) = (name for name in of_3 if name.startswith("binaries/"))
    (other,) = (content for name, content in of_2.items() if name.startswith("binaries/"))
    missing = "fmi3InstantiateCoSimulation, .*fmi3DoStep.*"
    lacks = f"linear{SHARED_LIBRARY_SUFFIX} lacks {missing}: expected them in FMI 3.0"
    no_binary = f"has no binary for {platform_folder(host_platform(), 3)}: it has aarch64-linux"
    cases = {lacks: {library: other}, no_binary: {"binaries/aarch64-linux/linear.so": b""}}
    for message, libraries in cases.items():
        path = write_archive(tmp_path / f"{len(message)}.fmu", {XML: of_3[XML], **libraries})
        with pytest.raises(FmuLoadError, match=message):
            FmuInstance("m", path, describe(path))


def test_a_token_that_the_fmu_refuses_is_told(linear: Build, tmp_path: Path) -> None:
    content = members(linear(fmi=3))
    content[XML] = content[XML].replace(b'instantiationToken="', b'instantiationToken="not ')
    path = write_archive(tmp_path / "other.fmu", content)
    with pytest.raises(FmuLoadError, match=r"other.fmu cannot be instantiated: GUID not "):
        FmuInstance("m", path, describe(path))


def test_without_a_compiler_and_a_library_an_fmu_is_refused(
    linear: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise ExportError("no compiler")

    monkeypatch.setattr(fmi3.compiled_library, "load", refuse)
    fmi3._calls.cache_clear()
    path = linear(fmi=3)
    try:
        with pytest.raises(FmuLoadError, match=r"FMI 3.0 needs a library of fmi3_calls.c.*: no compiler"):
            FmuInstance("m", path, describe(path))
    finally:
        fmi3._calls.cache_clear()
