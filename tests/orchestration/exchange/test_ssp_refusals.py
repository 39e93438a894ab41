"""SSP packages that others changed: what is refused, and what stands in for what is missing."""

import io
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest

from fmus.files import write_archive
from fmus.fmi.description import describe
from orchestration.cli.package_fmus import build_ramp_source
from orchestration.errors import FmuLoadError, ScenarioError, SystemDefinitionError
from orchestration.exchange import ssp_read, ssp_write
from orchestration.exchange.ssp_xml import STRUCTURE
from orchestration.run import simulate
from orchestration.scenarios import scenario
from tests.described_fmus import members
from tests.orchestration.exchange.conftest import refusal
from tests.shared_builds import Fmus


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        ('[[events]]\ntime = 1.0\nset = {"plant.roll" = 0.1}', "events"),
        ("[experiment]\nfmu_tolerance = 1e-6", "a tolerance"),
        ('[[faults]]\ninput = "controller.measured_depth"\nkind = "freeze"', "faults"),
    ],
)
def test_a_scenario_with_what_a_package_cannot_hold_is_refused(tmp_path: Path, lines: str, what: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'base = "nominal-l1"\n{lines}\n')
    with pytest.raises(ScenarioError, match=f"mine with {what}: expected none"):
        ssp_write.package(scenario.load(path), tmp_path / "mine.ssp", build_ramp_source)


def test_an_array_of_fmi_3_is_refused(fmi3_built: Fmus, tmp_path: Path) -> None:
    """Its elements are no variables for those who read a package."""
    settings = {"plant": str(fmi3_built["RovDepthPlant"])}
    chosen = scenario.load(scenario.find("nominal-l1"), settings=settings)
    refused = r"plant\.voltage\[1\], an element of an array of FMI 3\.0: expected scalars, as l1-depth build"
    with pytest.raises(ScenarioError, match=rf"an SSP package of nominal-l1.* with {refused}"):
        ssp_write.package(chosen, tmp_path / "loop.ssp", build_ramp_source)
    assert list(tmp_path.iterdir()) == []


def test_a_package_with_an_fmu_of_fmi_3_runs(package: Path, fmi3_built: Fmus, tmp_path: Path) -> None:
    fmu = {"resources/RovDepthPlant.fmu": fmi3_built["RovDepthPlant"].read_bytes()}
    changed = write_archive(tmp_path / "changed.ssp", members(package) | fmu)
    recordings = []
    for path in (package, changed):
        with ssp_read.opened(path) as loop:
            experiment = replace(loop.experiment, stop_time=5.0, record=("plant.depth", "plant.voltage[2]"))
            recordings.append(simulate(loop.system, experiment))
            assert describe(loop.system.components["plant"]).fmiVersion == ("2.0", "3.0")[path == changed]
    assert np.array_equal(recordings[0].values, recordings[1].values)


def test_an_fmu_that_cannot_be_loaded_is_named_by_its_place_in_the_package(
    package: Path, tmp_path: Path
) -> None:
    name = "resources/RovDepthPlant.fmu"
    with zipfile.ZipFile(io.BytesIO(members(package)[name])) as fmu:
        kept = {member: fmu.read(member) for member in fmu.namelist() if not member.startswith("binaries/")}
    plant = write_archive(tmp_path / "plant.fmu", kept).read_bytes()
    path = write_archive(tmp_path / "changed.ssp", members(package) | {name: plant})
    message = rf"^{re.escape(str(path))}: resources.RovDepthPlant\.fmu has no binary for "
    with pytest.raises(FmuLoadError, match=message), ssp_read.opened(path) as loop:
        simulate(loop.system, loop.experiment)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("application/x-fmu-sharedlibrary", "application/x-ssp-package", "type 'application/x-ssp-package'"),
        ('stopTime="310.0"', 'stopTime="soon"', "expected numbers of seconds"),
        ('source="resources/', 'source="../resources/', "expected a file in the package"),
        ('startElement="plant"', 'startElement="plnt"', "no element 'plnt'; nearest is 'plant'"),
        ("</ssd:System>", "", "expected XML"),
        (' version="1.0" name=', ' version="3.0" name=', "version '3.0': expected 1.0 or 2.0"),
        ("<ssd:Connection start", '<ssd:Connection startIndices="0" start', "startIndices of a connection"),
        ("<ssd:SystemStr", "<!DOCTYPE x><ssd:SystemStr", "expected XML without a document type"),
        ('<ssc:BaseUnit kg="1"', '<ssc:BaseUnit kg="one"', "a unit: invalid literal for int"),
        ('unit="V"', 'unit="N"', "connector plant.voltage[1] is in N: expected V, the unit in the FMU"),
        ('<ssv:Integer value="2"', '<ssv:Integer value="two"', "expected a value of type Real, Integer"),
        ('<ssv:Integer value="2"', '<ssv:Integer value="2_0"', "expected a value of type Real, Integer"),
    ],
)
def test_what_is_not_understood_is_refused(
    edited: Callable[[str, str, str], Path], old: str, new: str, message: str
) -> None:
    assert message in refusal(edited(STRUCTURE, old, new))


@pytest.mark.parametrize(
    ("kind", "system", "message"),
    [
        ("SystemStructureDescription", '<System name="root"/>', "no component: expected at least one FMU"),
        ("SystemStructureDescription", "", "expected a System"),
        ("ParameterSet", '<System name="root"/>', "expected a SystemStructureDescription of SSP"),
    ],
)
def test_a_structure_without_a_component_is_refused(
    tmp_path: Path, kind: str, system: str, message: str
) -> None:
    name = "http://ssp-standard.org/SSP1/SystemStructureDescription"
    structure = f'<{kind} xmlns="{name}" version="1.0">{system}</{kind}>'
    empty = write_archive(tmp_path / "empty.ssp", {STRUCTURE: structure.encode()})
    assert f"empty.ssp: SystemStructure.ssd: {message}" in refusal(empty)
    nothing = write_archive(tmp_path / "nothing.ssp", {"System.ssd": structure.encode()})
    assert "no SystemStructure.ssd in it; nearest is 'System.ssd'" in refusal(nothing)


def test_a_misspelt_parameter_is_answered_with_the_nearest(edited: Callable[[str, str, str], Path]) -> None:
    path = edited(STRUCTURE, 'name="proportional_gain"', 'name="proportional_gian"')
    with (
        pytest.raises(SystemDefinitionError, match=r"nearest is 'controller\.proportional_gain'"),
        ssp_read.opened(path),
    ):
        pass


def test_an_unknown_parameter_set_is_answered_with_the_nearest(package: Path) -> None:
    assert "nearest is 'nominal-extended'" in refusal(package, "nominal-extendet")


@pytest.mark.parametrize("name", ["../outside", "/etc/outside", "C:outside", "a\\\\b", "line\nbreak"])
def test_a_parameter_set_whose_name_leads_out_of_the_folder_of_results_is_refused(
    edited: Callable[[str, str, str], Path], name: str
) -> None:
    path = edited("parameters/nominal-l1.ssv", 'name="nominal-l1"', f"name={quoteattr(name)}")
    assert re.search(r"edited\.ssp: parameter set .*: expected a name of a file", refusal(path, name))


def test_a_package_larger_than_any_tool_writes_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.ssp", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("zeros", bytes(110_000_000))
    assert re.search(r"bomb\.ssp: .* bytes unpacked from", refusal(tmp_path / "bomb.ssp"))


def test_what_is_no_package_is_said(package: Path, tmp_path: Path) -> None:
    (tmp_path / "text.ssp").write_text("no zip")
    assert "expected an SSP package, a zip" in refusal(tmp_path / "text.ssp")
    assert "nearest is 'loop.ssp'" in refusal(package.parent / "lop.ssp")


def test_a_step_size_that_is_not_stated_is_the_smallest_that_an_fmu_suggests(
    edited: Callable[[str, str, str], Path],
) -> None:
    path = edited(STRUCTURE, "osp:FixedStepAlgorithm", "osp:AnotherAlgorithm")
    with ssp_read.opened(path) as loop:
        assert loop.experiment.step_size == 0.02


def test_values_of_the_system_go_over_those_of_its_components(
    edited: Callable[[str, str, str], Path],
) -> None:
    source = '<ssd:ParameterBinding source="parameters/nominal-l1.ssv"/>'
    bindings = f"<ssd:ParameterBindings>{source}</ssd:ParameterBindings>"
    with ssp_read.opened(edited(STRUCTURE, "<ssd:Elements>", f"{bindings}<ssd:Elements>")) as loop:
        assert loop.experiment.parameters["controller.augmentation"] == 1


BINDING = (
    '<ssd:ParameterBinding prefix="{prefix}"><ssd:ParameterValues><ssv:ParameterSet version="1.0" name="p">'
    '<ssv:Parameters><ssv:Parameter name="{name}"><ssv:Real value="7.5"/></ssv:Parameter></ssv:Parameters>'
    "</ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding>"
)


@pytest.mark.parametrize(
    ("of_system", "prefix", "name"),
    [
        (True, "", "plant.inertia"),
        (True, "plant.", "inertia"),
        (False, "", "inertia"),
        (False, "ine", "rtia"),
    ],
)
def test_the_prefix_of_a_binding_stands_before_each_name_of_its_set(
    edited: Callable[[str, str, str], Path], package: Path, of_system: bool, prefix: str, name: str
) -> None:
    binding = BINDING.format(prefix=prefix, name=name)
    text = members(package)[STRUCTURE].decode()
    if of_system:
        old = "<ssd:Elements>"
        new = f"<ssd:ParameterBindings>{binding}</ssd:ParameterBindings>{old}"
    else:
        begin = text.index('<ssd:Component name="plant"')
        old = text[begin : text.index("</ssd:ParameterBindings>", begin)]
        new = old + binding  # the last of two bindings holds
    with ssp_read.opened(edited(STRUCTURE, old, new)) as loop:
        assert loop.experiment.parameters["plant.inertia"] == 7.5


@pytest.mark.parametrize("start", ["-2.0", "1.5"])
def test_a_run_begins_at_the_start_time_of_the_package(
    edited: Callable[[str, str, str], Path], start: str
) -> None:
    with ssp_read.opened(edited(STRUCTURE, 'startTime="0.0"', f'startTime="{start}"')) as loop:
        assert loop.experiment.start_time == float(start)


def test_an_input_that_nothing_drives_keeps_the_start_value_of_its_fmu(
    edited: Callable[[str, str, str], Path],
) -> None:
    path = edited(STRUCTURE, '"thruster_efficiency[1]"', '"thruster_efficiency[2]"')
    with ssp_read.opened(path) as loop:
        assert "plant.thruster_efficiency[1]" not in loop.experiment.inputs
        assert ("plant.thruster_efficiency[1]", 1.0) in [(p.name, x) for p, x in loop.prepared.settings]
        assert loop.resolved["experiment"]["open_inputs"] == "start"
