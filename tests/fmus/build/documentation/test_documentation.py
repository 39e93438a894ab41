"""What a user reads inside an FMU: complete, well-formed, without the network, and licensed."""

import re
import zipfile
from dataclasses import replace
from html.parser import HTMLParser
from importlib.metadata import distribution
from pathlib import Path

import pytest

from fmus.block import Block
from fmus.block.guide import NO_GUIDE, Guide, Source
from fmus.build import builder
from fmus.build.documentation.page import documentation
from tests.shared_builds import Fmus

NAMES = builder.block_names()
VOID = {"meta", "img"}  # the elements of the page that HTML never closes


class Page(HTMLParser):
    """The page as a browser sees it: links, text of each table row, headings; fails on crossed elements."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.rows: list[list[str]] = []
        self.headings: list[str] = []
        self.declaration = ""
        self.elements: set[str] = set()
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert self._open == [], f"not closed: {self._open}"

    def handle_decl(self, decl: str) -> None:
        self.declaration = decl

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.add(tag)
        self.links += [value or "" for key, value in attrs if key in ("href", "src", "action", "data")]
        if tag not in VOID:
            self._open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag == "td":
            self.rows[-1].append("")
        if tag == "h2":
            self.headings.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self._open, f"</{tag}> closes nothing"
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] == "td":
            self.rows[-1][-1] += data
        if self._open and self._open[-1] == "h2":
            self.headings[-1] += data


def text_of(block: Block) -> str:
    return documentation(block)["documentation/index.html"].decode()


@pytest.mark.parametrize("name", NAMES)
def test_every_variable_stands_in_a_table_with_unit_range_and_source(name: str) -> None:
    block = builder.load_block(name)
    rows = {row[0]: row for row in Page(text_of(block)).rows if len(row) == 7}
    assert list(rows) == [
        v.name
        for causality in ("input", "output", "parameter", "calculatedParameter")
        for v in block.of_causality(causality)
    ]
    for v in block.variables:
        _, unit, start, permitted, variability, description, source = rows[v.name]
        assert unit == (v.unit or v.type.lower())
        assert (variability, description, source) == (v.variability, v.description, v.source)
        assert bool(start) == bool(permitted) == v.settable
        for limit in (v.minimum, v.maximum):
            assert not v.settable or limit is None or str(limit) in permitted


def test_the_start_value_of_each_type_can_be_read_back() -> None:
    block = builder.load_block("RovDepthPlant")
    rows = {row[0]: row for row in Page(text_of(block)).rows if len(row) == 7}
    assert [rows[name][2] for name in ("net_weight", "sensor_seed", "free_surface")] == ["-1.2", "1", "true"]
    law = {row[0]: row for row in Page(text_of(builder.load_block("L1Controller"))).rows if row}
    assert law["regressor"][2:4] == ["2", "one of 1 (infinity_norm), 2 (state)"]


@pytest.mark.parametrize("name", NAMES)
def test_every_section_is_there(name: str) -> None:
    page = Page(text_of(builder.load_block(name)))
    assert page.declaration == "DOCTYPE html"
    assert page.headings == [
        "Equations",
        "Sign conventions",
        "Tuning",
        "Limits",
        "Variables",
        "Running it",
        "Reference results",
        "Sources and licences",
    ]


@pytest.mark.parametrize("name", NAMES)
def test_the_page_needs_no_network(name: str) -> None:
    block = builder.load_block(name)
    page, text = Page(text_of(block)), text_of(block)
    outside = [link for link in page.links if ":" in link or link.startswith("//")]
    assert outside == [source.url for source in block.guide.sources if source.url]
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


@pytest.mark.parametrize("name", NAMES)
def test_links_within_the_fmu_lead_somewhere(either: dict[str, Path], name: str) -> None:
    page = Page(text_of(builder.load_block(name)))
    with zipfile.ZipFile(either[name]) as archive:
        members = archive.namelist()
    inside = {link for link in page.links if ":" not in link}
    assert inside == {"../model.png", "fmi-ls-ref.txt", "licenses/"}
    for link in inside:
        target = link.removeprefix("../") if link.startswith("../") else f"documentation/{link}"
        assert any(member.startswith(target) for member in members), f"{name}: {link} leads nowhere"


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
    assert page.headings[0] == "Variables"
    assert len([row for row in page.rows if len(row) == 7]) == len(block.variables)


def test_the_licence_of_everything_inside_is_inside(built: Fmus, python_built: Fmus) -> None:
    def licences(path: Path) -> dict[str, str]:
        folder = "documentation/licenses/"
        with zipfile.ZipFile(path) as archive:
            members = [member for member in archive.namelist() if member.startswith(folder)]
            return {
                member.removeprefix(folder).removesuffix(".txt"): archive.read(member).decode()
                for member in members
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
        with zipfile.ZipFile(fmus["ExamplePlant"]) as archive:
            description = archive.read("modelDescription.xml").decode()
            page = archive.read("documentation/index.html").decode()
        assert f"An FMU of FMI 2.0 for {text}, made by" in page
        assert ("<ModelExchange" in description) == ("model exchange" in text)
