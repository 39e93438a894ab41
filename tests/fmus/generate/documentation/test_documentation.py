"""What a user reads inside an FMU: complete, well-formed, without the network, and licensed."""

import re
from dataclasses import replace
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import pytest
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]

from fmus.block import Block
from fmus.block.guide import NO_GUIDE, Guide, Source
from fmus.errors import number_text
from fmus.generate import builder
from fmus.generate.documentation.page import documentation
from fmus.generate.documentation.wiring import declared_variables
from tests.described_fmus import members
from tests.shared_builds import Fmus

NAMES = builder.block_names()
LINKS_INSIDE = {"fmi-ls-ref.txt", "licenses/"}


class Page:
    """The page as a browser sees it: links, text of each table row, headings; fails on crossed elements."""

    def __init__(self, text: str) -> None:
        self.declaration, _, content = text.partition("\n")
        root: Any = etree.fromstring(re.sub(r"<(meta\b[^>]*)>", r"<\1/>", content))
        self.elements = {element.tag for element in root.iter()}
        links = ("href", "src", "action", "data")
        self.links = [value for e in root.iter() for key, value in e.attrib.items() if key in links]
        self.rows = [["".join(cell.itertext()) for cell in row.iter("td")] for row in root.iter("tr")]
        self.headings = ["".join(heading.itertext()) for heading in root.iter("h2")]


def text_of(block: Block) -> str:
    return documentation(block)["documentation/index.html"].decode()


def rows_of(name: str) -> dict[str, list[str]]:
    """The rows of the tables of variables by the name of the variable."""
    return {row[0]: row for row in Page(text_of(builder.load_block(name))).rows if len(row) == 7}


@pytest.mark.parametrize("name", NAMES)
def test_every_variable_stands_in_a_table_with_unit_range_and_source(name: str) -> None:
    block, rows = builder.load_block(name), rows_of(name)
    listed = declared_variables(block.variables)
    assert set(rows) == set(listed)
    assert sum(map(len, listed.values())) == len(block.variables)
    for named, scalars in listed.items():
        _, description, unit, start, permitted, variability, source = rows[named]
        assert unit in {v.unit or v.type.lower() for v in scalars} | {
            ", ".join(v.unit or "" for v in scalars)
        }
        assert {(v.variability, v.description, v.source) for v in scalars} == {
            (variability, description, source)
        }
        assert {bool(start), bool(permitted)} == {v.settable for v in scalars}
        for v in scalars:
            limits = [limit for limit in (v.minimum, v.maximum) if limit is not None]
            assert not v.settable or v.enumeration or all(number_text(x) in permitted for x in limits)


def test_the_start_value_of_each_type_can_be_read_back() -> None:
    rows = rows_of("RovDepthPlant")
    assert [rows[name][3] for name in ("net_weight", "sensor_seed", "free_surface")] == ["-1.2", "1", "true"]
    assert rows_of("L1Controller")["regressor"][3:5] == ["2", "one of 1 (infinity_norm), 2 (state)"]


def test_an_array_is_one_row_with_the_start_value_of_each_element() -> None:
    rows = rows_of("L1DepthController")
    assert rows["thruster_gain[1..2]"][3] == "0.25"
    assert rows["prediction_error_matrix[1..2,1..2]"][2:4] == ["1/s, 1, 1/s2, 1/s", "-0.1, 0, 0, -0.1"]
    forces = rows["thruster_table_force[1..24]"][3].split(", ")
    assert (len(forces), forces[3]) == (24, "-30.4986815")  # not -30.498681499999996


def test_the_parameters_of_the_advice_stand_first_and_in_its_order() -> None:
    names = list(rows_of("L1DepthController"))
    assert names[:4] == ["model_inertia", "model_damping", "thruster_gain[1..2]", "voltage_limit"]
    assert names.index("velocity_source") < names.index("internal_step") < names.index("depth_reference")


@pytest.mark.parametrize("name", NAMES)
def test_every_section_is_there(name: str) -> None:
    page = Page(text_of(builder.load_block(name)))
    assert page.declaration == "<!DOCTYPE html>"
    sections = (
        "Connections with other FMUs, Parameters, Inputs and outputs, Equations, Sign conventions, Limits"
    )
    assert ", ".join(page.headings) == f"{sections}, Running it, Reference results, Sources and licences"


@pytest.mark.parametrize("name", NAMES)
def test_the_page_needs_no_network(name: str) -> None:
    block = builder.load_block(name)
    page, text = Page(text_of(block)), text_of(block)
    outside = [link for link in page.links if ":" in link or link.startswith("//")]
    assert outside == [source.url for source in block.guide.sources if source.url]
    assert {*page.links} - {*outside} == LINKS_INSIDE
    assert not page.elements & {"script", "link", "iframe", "object"}
    assert "@import" not in text
    assert "url(" not in text


@pytest.mark.parametrize("name", NAMES)
def test_a_guide_names_nothing_that_the_block_does_not_have(name: str) -> None:
    """A renamed parameter may not live on in the advice; words with an underscore are names."""
    block = builder.load_block(name)
    known = {v.name.partition("[")[0] for v in block.variables}
    known |= {item.name.lower() for v in block.variables for item in v.enumeration or ()}
    guide = block.guide
    advice = " ".join((*guide.conventions, *guide.tuning, *guide.limits))
    named = set(re.findall(r"\b[a-z]{2,}(?:_[a-z]+)+\b", advice))
    assert named <= known
    assert named


def test_links_within_the_fmu_lead_somewhere(either: dict[str, Path]) -> None:
    names = members(either["ExamplePlant"])
    for link in LINKS_INSIDE:
        target = link.removeprefix("../") if link.startswith("../") else f"documentation/{link}"
        assert any(name.startswith(target) for name in names), f"{link} leads nowhere"


def test_what_a_guide_says_is_text_and_not_markup() -> None:
    spiteful = '<script>"x" & y</script>'
    guide = Guide(spiteful, (spiteful,), (spiteful,), (spiteful,), (Source(spiteful, 'https://a/"><b>'),))
    block = replace(builder.load_block("ExamplePlant"), description=spiteful, guide=guide)
    page = Page(text_of(block))
    assert "script" not in page.elements
    assert "b" not in page.elements
    assert 'https://a/"><b>' in page.links


def test_a_block_without_a_guide_is_documented_by_its_variables() -> None:
    block = replace(builder.load_block("ExamplePlant"), guide=NO_GUIDE)
    page = Page(text_of(block))
    assert page.headings[1:4] == ["Parameters", "Inputs and outputs", "Running it"]
    assert [row[0] for row in page.rows if len(row) == 7]


def test_the_licence_of_everything_inside_is_inside(built: Fmus, python_built: Fmus) -> None:
    def licences(path: Path) -> dict[str, str]:
        folder = "documentation/licenses/"
        return {
            name.removeprefix(folder).removesuffix(".txt"): content.decode()
            for name, content in members(path).items()
            if name.startswith(folder)
        }

    native, python = licences(built["ExamplePlant"]), licences(python_built["ExamplePlant"])
    for licences_inside in (native, python):
        listed = [line.partition(".txt: ")[0] for line in licences_inside.pop("license").splitlines()]
        assert sorted(listed) == sorted(licences_inside)
    assert set(native) == {"l1-depth", "fmi-headers", "zig", "mingw-w64"}
    assert set(python) == {"l1-depth", "pythonfmu"}
    assert native["l1-depth"] == (Path(__file__).parents[4] / "LICENSE").read_text("utf-8")
    assert "2-Clause BSD License" in native["fmi-headers"]
    assert "AS IS" in native["fmi-headers"]
    assert native["zig"] == distribution("ziglang").read_text("licenses/ziglang/LICENSE")
    assert "mingw-w64 project" in native["mingw-w64"]
    assert "MIT License" in python["pythonfmu"]


def test_the_page_names_the_interfaces_that_the_archive_has(built: Fmus, python_built: Fmus) -> None:
    for fmus, text in ((built, "co-simulation and model exchange"), (python_built, "co-simulation")):
        content = members(fmus["ExamplePlant"])
        assert f"An FMU of FMI 2.0 for {text}, made by" in content["documentation/index.html"].decode()
        assert (b"<ModelExchange" in content["modelDescription.xml"]) == ("model exchange" in text)


@pytest.mark.parametrize("name", NAMES)
def test_a_path_of_the_repository_is_explained_where_one_stands(name: str) -> None:
    page = text_of(builder.load_block(name))
    explained, _, sentence = page.partition("<p>Paths that begin with docs/")
    assert ("docs/" in explained) is bool(sentence)
