"""What does not fit is found before anything is loaded, with the nearest name."""

import zipfile
from pathlib import Path
from typing import Any

import pytest

from fmus.fmi.description import describe
from orchestration.errors import FmuLoadError, SystemDefinitionError
from orchestration.system.system import System, check
from tests.described_fmus import described
from tests.shared_builds import Fmus


def lags(foreign: Fmus, *connections: tuple[str, str]) -> System:
    return System({"one": foreign["Lag"], "two": foreign["Lag"]}, connections)


@pytest.mark.parametrize(
    ("connections", "driven", "message"),
    [
        ([("one.z", "two.u")], ["one.u"], r"no variable 'one.z'; nearest is 'one.y'"),
        ([("on.y", "two.u")], ["one.u"], r"no component 'on' for 'on.y'; nearest is 'one'"),
        ([("one.u", "two.u")], ["one.u"], "expected an output first, got input"),
        ([("one.y", "two.y")], ["one.u"], "expected an input second, got output"),
        ([("one.y", "two.u"), ("two.y", "two.u")], ["one.u"], "two.u is driven 2 times: expected once"),
        ([("one.y", "two.u")], ["one.u", "two.u"], "two.u is driven 2 times: expected once"),
        ([("one.y", "two.u")], [], "one.u: driven by nothing"),
        ([("one.y", "two.u")], ["one.y"], "one.y is driven: expected an input, got output"),
    ],
)
def test_wiring_mistakes(foreign: Fmus, connections: list, driven: list, message: str) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        check(lags(foreign, *connections), driven)


def test_names_may_be_plain_text_and_connections_lists() -> None:
    system = System({"one": "a.fmu", "two": Path("b.fmu")}, [["one.y", "two.u"]])
    assert system == System({"one": Path("a.fmu"), "two": Path("b.fmu")}, (("one.y", "two.u"),))


@pytest.mark.parametrize(
    ("components", "connections", "message"),
    [
        (["a.fmu"], [], r"expected \{\"name\": \"path.fmu\"\}, got \['a.fmu'\]"),
        ({"a.b": "a.fmu", "a": "a.fmu"}, [], "component 'a.b': expected a name that no other begins"),
        ({"a": "a.fmu"}, ("a.y", "a.u"), r"connection 'a.y': expected \(\"a.output\", \"b.input\"\)"),
        ({"a": "a.fmu"}, [("a.y", "a.u", "a.v")], "connection .* expected"),
    ],
)
def test_a_system_of_another_form_is_refused(components: Any, connections: Any, message: str) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        System(components, connections)


def test_types_must_be_equal(foreign: Fmus) -> None:
    system = System({"lag": foreign["Lag"], "types": foreign["Types"]}, (("lag.y", "types.a"),))
    with pytest.raises(SystemDefinitionError, match="expected an output of type Integer or Enumeration for"):
        check(system, ["lag.u", "types.b"])


def test_units_must_be_equal(built: Fmus) -> None:
    system = System({"plant": built["RovDepthPlant"]}, (("plant.depth", "plant.voltage[1]"),))
    with pytest.raises(SystemDefinitionError, match=r"expected equal units, got m and V"):
        check(system)


def test_a_unit_that_an_fmu_names_but_does_not_define_is_compared_by_its_name(
    built: Fmus, tmp_path: Path
) -> None:
    units = {"y": "V", "z": "mV"}
    named = described(tmp_path / "named.fmu", outputs=["y", "z"], units=units)
    components = {"named": named, "plant": built["RovDepthPlant"]}
    others = ["voltage[2]", "thruster_efficiency[1]", "thruster_efficiency[2]", "external_force"]
    others += ["buoyancy_change", "current_velocity", "roll", "pitch"]
    others += ["wave_velocity", "wave_acceleration", "wave_pressure_head"]
    driven = [f"plant.{name}" for name in others]
    check(System(components, [("named.y", "plant.voltage[1]")]), driven)
    with pytest.raises(SystemDefinitionError, match="expected equal units, got mV and V"):
        check(System(components, [("named.z", "plant.voltage[1]")]), driven)


def test_a_missing_file_offers_the_nearest(built: Fmus) -> None:
    path = built["RovDepthPlant"].with_name("RovDepthPlan.fmu")
    with pytest.raises(FmuLoadError, match=r"no FMU at .*nearest is 'RovDepthPlant.fmu'"):
        describe(path)


def test_a_corrupt_or_truncated_fmu_is_named(built: Fmus, tmp_path: Path) -> None:
    path, data = tmp_path / "broken.fmu", built["RovDepthPlant"].read_bytes()
    for content in (b"", b"not a zip at all", data[: len(data) // 2]):
        path.write_bytes(content)
        with pytest.raises(FmuLoadError, match=r"broken.fmu is not an FMU: expected a zip"):
            describe(path)


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        (b"<fmiModelDescription", "cannot be read"),
        (b'<fmiModelDescription fmiVersion="9.0"/>', "cannot be read|expected FMI 2.0"),
    ],
)
def test_a_broken_model_description_is_named(tmp_path: Path, xml: bytes, message: str) -> None:
    path = tmp_path / "broken.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", xml)
    with pytest.raises(FmuLoadError, match=message):
        describe(path)
