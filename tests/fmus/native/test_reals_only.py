"""FMUs whose every variable is a Real, for importers that know no other type."""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import pytest

from fmus.compliance.examine import examine
from fmus.errors import ExportError
from fmus.generate import builder
from fmus.registry import Flavour
from tests.described_fmus import members
from tests.mutants.mutant import broken_rules as static_broken_rules
from tests.shared_builds import Fmus

from .blocks import EVERYTHING, ITEMS


@pytest.fixture(scope="module")
def reals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return builder.build_block(EVERYTHING, tmp_path_factory.mktemp("reals"), reals_only=True)


def test_every_variable_is_a_real_that_names_its_values(reals: Path) -> None:
    described: Any = fmpy.read_model_description(str(reals))
    variables = {v.name: v for v in described.modelVariables}
    assert {v.type for v in described.modelVariables} == {"Real"}
    mode, enabled, level = variables["mode"], variables["enabled"], variables["level"]
    assert (mode.start, mode.min, mode.max, mode.description) == ("3", "0", "3", "Mode: 0 rest, 3 run")
    assert (enabled.start, enabled.max) == ("1", "1")
    assert enabled.description.endswith("0 false, 1 true")
    assert (level.min, level.max, level.description) == ("-5", "5", "Level: a whole number")


def test_its_page_shows_whole_numbers_where_other_fmus_have_types(reals: Path) -> None:
    page = members(reals)["documentation/index.html"].decode()
    cells = dict(
        re.findall(r'>([a-z]+)</td><td [^>]*>[^<]*</td><td data-heading="Unit or type">([^<]*)<', page)
    )
    assert cells["mode"] == cells["enabled"] == cells["level"] == "whole number"
    assert "enumeration" not in cells.values()


def test_what_depends_on_an_item_may_depend_on_all(reals: Path) -> None:
    """An importer that moves Reals at random does not find the dependencies that one item alone has."""
    root = ElementTree.fromstring(members(reals)["modelDescription.xml"])
    names = [v.get("name") for v in root.iter("ScalarVariable")]
    unknowns = root.findall("ModelStructure/InitialUnknowns/Unknown")
    listed = {names[int(u.get("index", "0")) - 1]: u.get("dependencies") for u in unknowns}
    assert listed["steps"] is None  # of the Integer `count`
    assert listed["product"] == " ".join(str(names.index(name) + 1) for name in ("gain", "limit"))


@pytest.mark.slow
def test_it_steps_as_the_ordinary_fmu_does(reals: Path, load: Any, small_built: Fmus) -> None:
    plain = load(small_built[EVERYTHING.name]).begin()
    fmu = load(reals).begin()
    for values in ({"mode": 0, "level": 3}, {"mode": 3, "enabled": 0}):
        for name, value in values.items():
            fmu[name] = float(value)
            setter = plain.slave.setBoolean if name == "enabled" else plain.slave.setInteger
            setter([plain.references[name]], [value])
        t = 0.1 * (values == {"mode": 3, "enabled": 0})
        for loaded in (fmu, plain):
            loaded["force"] = 2.0
            loaded.slave.doStep(t, 0.1)
        assert fmu["y"] == plain["y"] != 0.0
        assert fmu["steps"] == plain.slave.getInteger([plain.references["steps"]])[0]
        assert fmu["high"] == plain.slave.getBoolean([plain.references["high"]])[0]


@pytest.mark.parametrize(
    ("name", "value"), [("mode", 1.0), ("mode", 2.5), ("enabled", 0.5), ("enabled", 2.0), ("level", 0.5)]
)
def test_what_is_no_item_truth_value_or_whole_number_is_refused(
    reals: Path, load: Any, name: str, value: float
) -> None:
    fmu = load(reals)
    before = fmu[name]
    assert fmu.status("setReal", [fmu.references[name]], [value]) == "error"
    assert f"{name} = {value:g}: expected" in fmu.log[-1]
    assert fmu[name] == before


def test_an_input_of_whole_numbers_has_no_derivative(reals: Path, load: Any) -> None:
    """Half way to the next one it would have a value that fmi2SetReal refuses."""
    fmu = load(reals).begin()
    assert fmu.status("setRealInputDerivatives", [fmu.references["level"]], [1], [1.0]) == "error"
    assert "level: expected a continuous input" in fmu.log[-1]


def test_its_files_break_no_rule_of_fmi(reals: Path) -> None:
    assert static_broken_rules(reals) == {}


@pytest.mark.slow
def test_it_breaks_no_rule_of_fmi(reals: Path) -> None:
    assert not {result.rule.name: result.messages for result in examine(reals) if result.messages}


@pytest.mark.slow
def test_an_initial_value_that_whole_numbers_do_not_move_gets_no_advice(tmp_path: Path) -> None:
    """Its inputs have an effect only beside another start value; random ones of whole numbers are refused."""
    plant = builder.build_block(builder.load_block("RovDepthPlant"), tmp_path, reals_only=True)
    assert not {result.rule.name: result.messages for result in examine(plant) if result.messages}


def test_a_python_fmu_of_reals_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="expected the native flavour"):
        builder.build_block(ITEMS, tmp_path, Flavour.PYTHON, reals_only=True)
