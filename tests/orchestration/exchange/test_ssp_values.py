"""Values of an SSP package: bindings at every level, mappings, units, connectors that pass values on."""

from pathlib import Path

import pytest

from fmus.files import write_archive
from orchestration.errors import ScenarioError
from orchestration.exchange import ssp_read
from tests.described_fmus import members, redescribed
from tests.orchestration.exchange.conftest import refusal
from tests.orchestration.exchange.structures import (
    LINEAR,
    NESTED,
    binding,
    bindings,
    component,
    connection,
    connectors,
    mapping,
    package,
    real,
    system,
)


def test_a_value_of_a_connector_of_a_system_is_that_of_what_it_leads_to(tmp_path: Path) -> None:
    given = bindings(binding("inner.gain", "7"), binding("inner.in", "-3"))
    with ssp_read.opened(package(tmp_path, system("root", NESTED, "", given))) as loop:
        assert loop.experiment.parameters == {"inner.b.k": 7.0}
        assert loop.experiment.inputs == {"inner.b.u": -3.0}


def test_a_value_that_a_connector_passes_on_is_converted_and_one_of_a_driven_input_has_no_effect(
    tmp_path: Path,
) -> None:
    inner = system("d", component("b"), connection("in", "b.k"), connectors(**{"in": "parameter cm"}))
    given = bindings(binding("d.in", "80"), binding("a.u", "7"))
    root = system("root", component("a") + inner, connection("a.y", "a.u"), given)
    with ssp_read.opened(package(tmp_path, root)) as loop:
        assert (loop.experiment.parameters, loop.experiment.inputs) == ({"d.b.k": 0.8}, {})


@pytest.mark.parametrize(
    ("given", "wire", "message"),
    [
        (
            mapping("p", "a.k", '<ssc:LinearTransformation factor="two"/>'),
            "",
            "mapping of a.k: could not convert",
        ),
        (
            "",
            "<ssc:BooleanMappingTransformation/>",
            "connection a.y -> a.u: a BooleanMappingTransformation: not supported; expected a linear one",
        ),
    ],
)
def test_a_transformation_that_is_not_understood_is_refused(
    tmp_path: Path, given: str, wire: str, message: str
) -> None:
    wires = connection("a.y", "a.u", inside=wire)
    root = system("root", component("a"), wires, bindings(binding("p", "1", "", given)) if given else "")
    assert message in refusal(package(tmp_path, root))


def test_a_text_with_a_linear_transformation_is_refused(tmp_path: Path) -> None:
    own = binding("p", '<ssv:String value="text"/>', "", mapping("p", "a.k", LINEAR))
    message = refusal(package(tmp_path, system("root", component("a"), "", bindings(own)), "String"))
    assert "'text' with a linear transformation: expected a number" in message


@pytest.mark.parametrize(
    ("of_component", "of_inner", "of_root", "expected"),
    [
        (["k=1", "k=2"], [], [], 2.0),
        (["k=1"], ["b.k=2"], [], 2.0),
        (["k=1"], ["b.k=2"], ["inner.b.k=3"], 3.0),
        (["k=1"], [], ["inner.b.k=4", "inner.b.k=3"], 3.0),
        (["k=1"], ["b./k=5"], [], 5.0),
        (["k=1"], ["b.k=2"], ["inner./b.k=6"], 6.0),
    ],
)
def test_a_higher_level_goes_over_a_lower_one_and_the_last_set_over_the_first(
    tmp_path: Path, of_component: list[str], of_inner: list[str], of_root: list[str], expected: float
) -> None:
    """PREFIX/NAME=VALUE: the prefix of a binding stands before the names of its set."""

    def bound(texts: list[str]) -> str:
        parts = [(text.rpartition("/"), text.partition("=")[2]) for text in texts]
        return bindings(*(binding(n.partition("=")[0], value, prefix) for (prefix, _, n), value in parts))

    inner = system("inner", component("b", bound(of_component)), "", bound(of_inner))
    with ssp_read.opened(package(tmp_path, system("root", inner, "", bound(of_root)))) as loop:
        assert loop.experiment.parameters == {"inner.b.k": expected}


@pytest.mark.parametrize(
    ("value", "prefix", "mapped", "expected"),
    [
        (real("2"), "", mapping("p", "a.k"), {"a.k": 2.0}),
        (real("2"), "", mapping("p", "a.k", LINEAR), {"a.k": 13.0}),
        (real("2"), "x.", mapping("x.p", "a.k", LINEAR), {"a.k": 13.0}),
        (real("200", "cm"), "", mapping("p", "a.k", LINEAR), {"a.k": 13.0}),
        (real("2", "cm"), "", mapping("p", "a.k", LINEAR, 'suppressUnitConversion="true"'), {"a.k": 13.0}),
        (real("80", "cm"), "", mapping("p", "a.k"), {"a.k": 0.8}),
        (real("80", "[cm]"), "", mapping("p", "a.k"), {"a.k": 0.8}),
        (real("2"), "", mapping("q", "a.k"), {}),
    ],
)
def test_a_mapping_renames_converts_and_then_transforms(
    tmp_path: Path, value: str, prefix: str, mapped: str, expected: dict[str, float]
) -> None:
    """What it does not map is not applied."""
    root = system("root", component("a"), "", bindings(binding("p", value, prefix, mapped)))
    with ssp_read.opened(package(tmp_path, root)) as loop:
        assert loop.experiment.parameters == expected


ITEMS = '<TypeDefinitions><SimpleType name="Law"><Enumeration><Item name="none" value="1"/>'
ITEMS += '<Item name="pi" value="2"/></Enumeration></SimpleType></TypeDefinitions>'


def test_a_table_of_a_mapping_with_a_text_for_an_integer_is_refused(tmp_path: Path) -> None:
    kind = "ssc:IntegerMappingTransformation"
    item = f'<{kind}><ssc:MapEntry source="3" target="x"/></{kind}>'
    own = binding("p", '<ssv:Integer value="3"/>', "", mapping("p", "a.k", item))
    path = package(tmp_path, system("root", component("a"), "", bindings(own)), "Integer")
    with (
        pytest.raises(ScenarioError, match=r"mapping of a\.k: target 'x': invalid literal"),
        ssp_read.opened(path),
    ):
        pass


@pytest.mark.parametrize(
    ("kind", "given", "table", "expected"),
    [
        ("Integer", "3", "3 30", 30),
        ("Integer", "4", "3 30", 4),
        ("Boolean", "true", "true false", False),
        ("Boolean", "0", "true false", False),
        ("Boolean", "0", "false 1", True),
        ("Enumeration", "pi", "", 2),
        ("Enumeration", "pi", "pi none", 1),
        ("Enumeration", "linear", "linear pi", 2),
    ],
)
def test_a_table_of_a_mapping_replaces_the_values_in_it(
    tmp_path: Path, kind: str, given: str, table: str, expected: object
) -> None:
    """Items of an enumeration have names."""
    source, _, target = table.partition(" ")
    item = f'<ssc:MapEntry source="{source}" target="{target}"/>' if table else ""
    mapped = f"<ssc:{kind}MappingTransformation>{item}</ssc:{kind}MappingTransformation>"
    own = binding("p", f'<ssv:{kind} value="{given}"/>', "", mapping("p", "a.k", mapped))
    path = package(tmp_path, system("root", component("a"), "", bindings(own)), kind)

    def with_items(xml: str) -> str:
        typed = xml.replace("<Enumeration start", '<Enumeration declaredType="Law" start')
        return typed.replace("<ModelVariables>", f"{ITEMS}<ModelVariables>")

    fmu = redescribed(tmp_path / "f.fmu", tmp_path / "g.fmu", with_items)
    write_archive(path, members(path) | {"f.fmu": fmu.read_bytes()})
    with ssp_read.opened(path) as loop:
        assert loop.experiment.parameters == {"a.k": expected}
        assert isinstance(loop.experiment.parameters["a.k"], type(expected))
