"""SSP packages: what is in them, and that a package is its scenario."""

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd, read_ssv
from fmpy.validation import validate_fmu

from fmus.files import write_archive
from orchestration.cli.package_fmus import build_ramp_source, build_started
from orchestration.exchange import ssp_read, ssp_write
from orchestration.exchange.ssp_xml import STRUCTURE, SspVersion, tag
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.described_fmus import described, members, redescribed

SAME_SYSTEM = ("nominal-l1", "nominal-extended", "buoyancy", "monte-carlo")
VEHICLE = [name for name in scenario.shipped() if name.startswith(SAME_SYSTEM)]


@pytest.mark.slow
def test_it_holds_a_structure_and_a_parameter_set_for_each_scenario_of_the_system(package: Path) -> None:
    blocks = ("Ramps_depth_reference", "L1DepthController", "RovDepthPlant")
    expected = {f"{name}.ssd" for name in VEHICLE if name != "nominal-extended"}
    expected |= {f"parameters/{name}.ssv" for name in VEHICLE} | {f"resources/{name}.fmu" for name in blocks}
    assert members(package).keys() == expected | {STRUCTURE}


@pytest.mark.parametrize("name", VEHICLE)
def test_every_file_follows_the_schemas_of_ssp(package: Path, tmp_path: Path, name: str) -> None:
    """Those that FMPy ships, by which it validates what it reads."""
    assert read_ssd(str(package)).name == "nominal-extended"
    assert read_ssv(str(package), f"parameters/{name}.ssv").name == name
    structure = members(package)[STRUCTURE if name == "nominal-extended" else f"{name}.ssd"]
    assert read_ssd(str(write_archive(tmp_path / "variant.ssp", {STRUCTURE: structure}))).name == name


@pytest.mark.slow
def test_packing_twice_gives_the_same_file_and_packing_a_package_its_loop(
    package: Path, tmp_path: Path
) -> None:
    again = ssp_write.package(
        scenario.load(scenario.find("nominal-extended")), tmp_path / "again.ssp", build_ramp_source
    )
    assert again.read_bytes() == package.read_bytes()
    with ssp_read.opened(package) as loop:
        repacked = ssp_write.package(loop, tmp_path / "repacked.ssp", build_ramp_source)
        with ssp_read.opened(repacked) as second:
            assert second.system.connections == loop.system.connections
            assert second.experiment.parameters == loop.experiment.parameters
            assert second.experiment.inputs == loop.experiment.inputs


def test_importers_that_read_prefixes_find_them_declared_on_the_root(package: Path) -> None:
    root, _, rest = members(package)[STRUCTURE].decode().partition("<ssd:System ")
    assert all(f"xmlns:{prefix}=" in root for prefix in ("ssd", "ssc", "ssv", "osp"))
    assert "xmlns" not in rest


def test_the_system_has_no_connector_of_its_own(package: Path) -> None:
    system = ElementTree.fromstring(members(package)[STRUCTURE]).find(tag("ssd:System"))
    assert system is not None
    assert system.find(tag("ssd:Connectors")) is None
    assert all(c.get("startElement") and c.get("endElement") for c in system.iter(tag("ssd:Connection")))


@pytest.mark.parametrize("name", ["", "nominal-l1", "buoyancy-extended", "nominal-extended-ideal"])
def test_a_package_runs_as_its_scenario_bit_by_bit(package: Path, name: str) -> None:
    assert_same_recording(package, name)


@pytest.mark.slow
def test_a_package_whose_fmus_start_with_the_values_runs_as_its_scenarios_bit_by_bit(tmp_path: Path) -> None:
    """As `l1-depth package` writes it, with blocks built again."""
    chosen = scenario.load(scenario.find("nominal-extended"))
    path = ssp_write.package(chosen, tmp_path / "loop.ssp", build_ramp_source, build_started)
    with ssp_read.opened(path) as loop:
        starts = {
            v.name: v.start
            for v in fmpy.read_model_description(str(loop.system.components["controller"])).modelVariables
        }
    assert starts["augmentation"] == "2"
    for name in ("", "nominal-l1"):
        assert_same_recording(path, name)


def assert_same_recording(package: Path, name: str) -> None:
    """name: of the scenario in the package; "" is the packaged one, nominal-extended."""
    chosen = scenario.load(scenario.find(name or "nominal-extended"))
    with ssp_read.opened(package, name) as loop:
        recording = simulate(loop.system, loop.experiment)
    own = simulate(chosen.system, chosen.experiment)
    np.testing.assert_array_equal(recording.time, own.time)
    for signal in chosen.experiment.record:
        given = signal.replace("controller.depth_reference", "depth_reference.depth_reference")
        np.testing.assert_array_equal(recording[given], own[signal], err_msg=signal)


def test_a_unit_has_the_factor_and_the_offset_of_the_fmus_definition(tmp_path: Path) -> None:
    units = '<UnitDefinitions><Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>'
    units += '<Unit name="km"><BaseUnit m="1" factor="1000"/></Unit></UnitDefinitions>'
    fmu = redescribed(
        described(tmp_path / "plain.fmu", outputs=["t", "x"], units={"t": "degC", "x": "km"}),
        tmp_path / "a.fmu",
        lambda xml: xml.replace("<ModelVariables>", f"{units}<ModelVariables>"),
    )
    mine = scenario.Scenario("mine", "", System({"a": fmu}), Experiment(1.0, 0.1), {})
    package = ssp_write.package(mine, tmp_path / "mine.ssp", build_ramp_source)
    structure = ElementTree.fromstring(members(package)[STRUCTURE])
    defined = {unit.get("name"): unit[0].attrib for unit in structure.iter(tag("ssc:Unit"))}
    assert defined == {"degC": {"K": "1", "offset": "273.15"}, "km": {"m": "1", "factor": "1000.0"}}


def test_no_two_structures_have_one_name(package: Path) -> None:
    """OMSimulator refuses them: names are those of its variants."""
    structures = [text for path, text in members(package).items() if path.endswith(".ssd")]
    names = [ElementTree.fromstring(text).get("name") for text in structures]
    assert sorted(map(str, names)) == sorted(VEHICLE)


def test_omsimulator_finds_the_step_size_where_both_of_its_versions_look_for_it(package: Path) -> None:
    """First among the annotations of the system, in an element of its own and as attributes."""
    (system,) = ElementTree.fromstring(members(package)[STRUCTURE]).findall(tag("ssd:System"))
    (annotation,) = system.findall(f"{tag('ssd:Annotations')}/{tag('ssc:Annotation')}")
    assert annotation.get("type") == "org.openmodelica"
    (information,) = annotation.findall(f"{tag('oms:Annotations')}/{tag('oms:SimulationInformation')}")
    (master,) = information
    assert (master.tag, master.get("stepSize")) == (tag("oms:FixedStepMaster"), "0.02")
    assert (information.get("method"), information.get("fixedStepSize")) == ("oms_ma", "0.02")


def test_every_parameter_set_has_the_same_names(package: Path) -> None:
    """So that each replaces the start values of the packaged scenario, which FMUs in the package have."""
    sets = [read_ssv(str(package), f"parameters/{name}.ssv") for name in VEHICLE]
    names = [{p.name for p in parameter_set.parameters} for parameter_set in sets]
    assert all(own == names[0] for own in names)
    (plain,) = (s for s in sets if s.name == "nominal-l1")
    assert {p.name: p.value for p in plain.parameters}["controller.augmentation"] == "1"


def test_a_variant_of_a_package_with_smooth_ramps_has_its_own_ramps(tmp_path: Path) -> None:
    """Its parameter set says so, as the FMU in the package starts with smooth ones."""
    chosen = scenario.load(scenario.find("nominal-extended-smooth"))
    path = ssp_write.package(chosen, tmp_path / "smooth.ssp", build_ramp_source, lambda fmu, *_: fmu)
    for name, is_smooth in (("nominal-extended-smooth", "true"), ("nominal-extended", "false")):
        values = {p.name: p.value for p in read_ssv(str(path), f"parameters/{name}.ssv").parameters}
        assert values["depth_reference.smooth"] == is_smooth


def test_components_are_to_start_with_the_values_of_the_packaged_scenario(
    package: Path, asked_starts: dict[str, dict]
) -> None:
    """As importers need them that apply no values; which are those of its parameter set."""
    bound = {p.name: p.value for p in read_ssv(str(package), "parameters/nominal-extended.ssv").parameters}
    asked = {f"{component}.{name}": x for component, own in asked_starts.items() for name, x in own.items()}
    assert {name: str(value).lower() for name, value in asked.items()} == bound
    assert asked["controller.augmentation"] == 2


def packaged(folder: Path, units: dict[str, str], components: str) -> Path:
    """Returns a package of three components; each FMU is a file whose output has a unit."""
    for file, unit in units.items():
        (folder / file).parent.mkdir()
        described(folder / file, inputs=["u"], outputs=["y"], units={"y": unit})
    text = f"""
connections = [["a.y", "b.u"], ["b.y", "c.u"], ["c.y", "a.u"]]
components = {{ {components} }}
experiment = {{ stop_time = 1.0, step_size = 0.1 }}
"""
    (folder / "mine.toml").write_text(text)
    return ssp_write.package(scenario.load(folder / "mine.toml"), folder / "mine.ssp", build_ramp_source)


def test_fmus_of_one_name_and_different_content_have_a_file_each(tmp_path: Path) -> None:
    components = 'a = "one/f.fmu", b = "other/f.fmu", c = "one/f.fmu"'
    path = packaged(tmp_path, {"one/f.fmu": "m", "other/f.fmu": "mm"}, components)
    with ssp_read.opened(path) as loaded:
        assert {name: fmu.name for name, fmu in loaded.system.components.items()} == {
            "a": "f.fmu", "b": "b.fmu", "c": "f.fmu"
        }  # fmt: skip


def test_a_free_name_is_chosen_where_the_component_has_the_name_of_another_file(tmp_path: Path) -> None:
    files = {"x/b.fmu": "km", "one/f.fmu": "m", "other/f.fmu": "mm"}
    path = packaged(tmp_path, files, 'c = "x/b.fmu", a = "one/f.fmu", b = "other/f.fmu"')
    with ssp_read.opened(path) as loaded:
        units = {
            name: fmpy.read_model_description(str(fmu), validate=False).modelVariables[-1].unit
            for name, fmu in loaded.system.components.items()
        }
        assert loaded.system.components["b"].name == "b_2.fmu"
    assert units == {"a": "m", "b": "mm", "c": "km"}


def test_a_variant_has_the_values_of_its_parameter_set(package: Path) -> None:
    bound = {
        f"{component.get('name')}.{parameter.get('name')}": parameter[0].get("value")
        for component in ElementTree.fromstring(members(package)["buoyancy-l1.ssd"]).iter(
            tag("ssd:Component")
        )
        for parameter in component.iter(tag("ssv:Parameter"))
    }
    assert bound == {p.name: p.value for p in read_ssv(str(package), "parameters/buoyancy-l1.ssv").parameters}


@pytest.mark.slow
def test_its_fmus_say_integer_for_enumeration_and_are_otherwise_the_same(
    package: Path, built: Mapping[str, Path], tmp_path: Path
) -> None:
    packed, own = tmp_path / "packed.fmu", built["L1DepthController"]
    packed.write_bytes(members(package)["resources/L1DepthController.fmu"])
    assert validate_fmu(str(packed)) == []
    assert list(members(packed)) == list(members(own))
    differing = {name for name, content in members(own).items() if members(packed)[name] != content}
    assert differing == {"modelDescription.xml"}
    described, original = (
        {v.name: v for v in fmpy.read_model_description(str(path)).modelVariables} for path in (packed, own)
    )
    kinds = {(original[name].type, described[name].type) for name in original}
    assert {kind for kind in kinds if kind[0] != kind[1]} == {("Enumeration", "Integer")}
    choice = described["augmentation"]
    assert (choice.min, choice.max, choice.start) == ("1", "3", "2")
    assert "1 none, 2 pi, 3 nonlinear_p" in (choice.description or "")


def test_a_package_of_ssp_2_differs_in_the_version_alone(package: Path, tmp_path: Path) -> None:
    """FMUs and importers that know 1.0 alone find the same elements in the same namespaces."""
    chosen = scenario.load(scenario.find("nominal-extended"))
    one, ramps = members(package), tmp_path / "Ramps_depth_reference.fmu"
    ramps.write_bytes(one[f"resources/{ramps.name}"])
    second = ssp_write.package(chosen, tmp_path / "two.ssp", lambda *_: ramps, version=SspVersion.V2)
    assert list(members(second)) == list(one)
    for name, text in members(second).items():
        if not name.endswith(".fmu"):
            assert b' version="1.0"' in one[name]
            assert text == one[name].replace(b' version="1.0"', b' version="2.0"')
    with ssp_read.opened(package) as first, ssp_read.opened(second) as later:
        assert later.experiment == first.experiment
        assert later.system.connections == first.system.connections
