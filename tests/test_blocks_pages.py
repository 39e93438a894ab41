"""Tests of the pages on blocks against the code."""

import ast
import re
import runpy
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from fmus import numerics
from fmus.block import Block
from fmus.block.block_file import write_new_block
from fmus.generate.builder import load_block
from fmus.units import SYMBOLS
from orchestration.studies.score.protocol import read_protocol
from orchestration.studies.score.score_document import Score

from .page_examples import examples

ROOT = Path(__file__).parent.parent


def page_of_the_site(name: str) -> str:
    """Returns a page that the site's build makes, by a program that may import its neighbours."""
    return program_of_the_site(name)["page"]()


def program_of_the_site(name: str) -> dict[str, Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / ".ci"))
        return runpy.run_path(str(ROOT / ".ci" / f"{name}_page.py"))


def test_the_reference_of_blocks_has_every_field_function_and_base_unit() -> None:
    page = page_of_the_site("blocks")
    assert {member.name for member in fields(Block)} <= set(re.findall(r"^\| `(\w+)` \|", page, re.M))
    assert set(numerics.__all__) == set(re.findall(r"^\| `(\w+)\(.*\)` \|", page, re.M))
    assert [name for name in SYMBOLS if f"`{name}`" not in page] == []


def parameters_of_the_site(page: str) -> Iterator[tuple[str, str, str]]:
    """Yields name, start value and source of each parameter; equal elements share a row."""
    rows = re.findall(r"^\| (`.*?`) \| (\S+) \|.*(?<!\\)\| (.*) \|$", page_of_the_site(page), re.M)
    for shown, start, source in rows:
        first, *others = re.findall(r"`(.*?)`", shown)
        array = first.partition("[")[0]
        for name in (first, *(f"{array}{other}" for other in others)):
            yield name, start, source.replace("\\|", "|")


def without_a_row(page: str, blocks: Sequence[str]) -> list[str]:
    """Returns parameters of blocks whose start value and source a page lacks; numbers have ten digits there.

    Only the first point of a table is compared.
    """
    rows = [*parameters_of_the_site(page)]
    return [
        v.name
        for block in blocks
        for v in load_block(block).of_causality("parameter")
        if v.enumeration is None and not re.search(r"_table_\w+\[\d\d?\]$", v.name)
        if (v.name, f"{v.start:.10g}" if isinstance(v.start, float) else repr(v.start), v.source) not in rows
    ]


def test_the_reference_of_controllers_has_every_parameter_with_its_start_value() -> None:
    names = ("Pid", "Mrac", "SlidingMode", "SuperTwisting", "Adrc")
    assert without_a_row("controllers", [f"{name}DepthController" for name in names]) == []


def test_the_reference_of_vehicles_has_the_source_of_every_number() -> None:
    """This includes a vehicle with different numbers."""
    names = ("RovDepthPlant", "RovHeavePitchPlant", "BlueRov2Plant", "WaveSource", "ExamplePlant")
    assert without_a_row("vehicles", names) == []


def test_the_page_of_the_protocol_has_every_metric_case_and_key_of_a_score() -> None:
    named = re.findall(r"`(\w[\w-]*)`", page_of_the_site("protocol"))
    tables = read_protocol().tables
    assert {*tables.metrics, *tables.cases, *Score.model_fields} <= set(named)


def test_the_tutorial_shows_the_block_that_new_writes(tmp_path: Path) -> None:
    shown = examples(ROOT / "docs" / "tutorials" / "your-own-controller.md")
    (block,) = [example.code for example in shown if example.file == "pid.py"]
    assert block == "# pid.py\n" + write_new_block("pid", tmp_path)[0].read_text(encoding="utf-8")


def test_the_tutorial_of_a_thermostat_shows_functions_that_new_writes(tmp_path: Path) -> None:
    shown = examples(ROOT / "docs" / "tutorials" / "thermostat.md")
    (functions,) = [e.code for e in shown if e.language == "python" and e.code.startswith("def ")]
    written = write_new_block("room", tmp_path, "plain")[0].read_text(encoding="utf-8")
    parts = functions.split("\n\n\n")
    assert len(parts) == 4
    assert not [part for part in parts if part.strip() not in written]


def test_the_page_on_importers_names_tests_that_there_are_with_their_fmus() -> None:
    program = program_of_the_site("compatibility")
    runs = [tool[interface] for tool in program["table"]().values() for interface in program["INTERFACES"]]
    tested = [run for run in runs if isinstance(run, dict) and "by_hand" not in run]
    assert len(tested) > 10
    for run in tested:
        path, _, name = run["test"].partition("::")
        text = (ROOT / path).read_text(encoding="utf-8")
        functions = {node.name for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}
        assert name in functions
        expected = ["builder.block_names()"] if run["fmus"] == "all" else [f'"{fmu}"' for fmu in run["fmus"]]
        assert [part for part in expected if part not in text] == []
    text = (ROOT / "tests/windows/test_windows.py").read_text(encoding="utf-8")
    assert {run["test"] for run in program["windows"]()} == set(re.findall(r"^def (test_\w+)", text, re.M))


def test_the_page_on_importers_has_a_row_for_each_run() -> None:
    program = program_of_the_site("compatibility")
    entries = [tool[i] for tool in program["table"]().values() for i in program["INTERFACES"]]
    rows = re.findall(r"^\| .* \| (?:by hand: .*|\S+ \S+: `tests/.*`) \|$", program["page"](), re.M)
    assert len(rows) == sum(isinstance(entry, dict) for entry in entries)
    pages = {tool["page"] for tool in program["table"]().values() if "page" in tool}
    assert pages | {"README.md"} == {path.name for path in (ROOT / "docs/how-to/importing").glob("*.md")}
