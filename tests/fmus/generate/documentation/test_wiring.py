"""The connections and the block diagram of the page in an FMU, against what the scenarios connect."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]

import fmus
from fmus.block import Block
from fmus.generate.builder import block_names, load_block
from fmus.generate.documentation.page import documentation
from fmus.generate.documentation.wiring import connections, declared_variables, diagram
from tests.fmus.generate.small_blocks import one_block_of_all

BASES = Path(fmus.__file__).parents[1] / "orchestration" / "scenarios" / "base"
PAIRS = [
    ("vehicle.toml", "L1DepthController", "RovDepthPlant"),
    ("vehicle.toml", "PidDepthController", "BlueRov2Plant"),
    ("vehicle.toml", "L1HeavePitchController", "RovHeavePitchPlant"),
    ("example.toml", "L1Controller", "ExamplePlant"),
]


def declared(source: Block, target: Block) -> set[tuple[str, str]]:
    """The scalar (output, input) that the pages connect."""
    outputs, inputs = (
        declared_variables(source.of_causality("output")),
        declared_variables(target.of_causality("input")),
    )
    return {
        (output.name, target_input.name)
        for one in connections(target)
        if one.is_input and source.name in one.fmus
        for output, target_input in zip(outputs[one.other], inputs[one.own], strict=True)
    }


def driven(base: str, blocks: dict[str, Block]) -> Iterator[tuple[str, str, str]]:
    """Role and name of each input that the interface of a base drives, with the output, "" for a number."""
    known = {f"{role}.{v.name}" for role, block in blocks.items() for v in block.variables}
    interface = tomllib.loads((BASES / base).read_text("utf-8"))["interface"]["inputs"]
    for target, sources in interface.items():
        texts = (source if isinstance(source, dict) else {"source": source} for source in sources)
        there = [
            source["source"]
            for source in texts
            if source.get("source") in known or isinstance(source.get("source"), float)
            if source.get("where", source.get("source")) in known or isinstance(source.get("source"), float)
            if source.get("without") not in known
        ]
        if target in known and there:
            yield (*target.split("."), str(there[0]).partition(".")[2] if there[0] in known else "")


@pytest.mark.parametrize(("base", "controller", "plant"), PAIRS)
def test_the_page_connects_what_scenarios_connect(base: str, controller: str, plant: str) -> None:
    blocks = {"controller": load_block(controller), "plant": load_block(plant)}
    for role, other in (("controller", "plant"), ("plant", "controller")):
        found = declared(blocks[other], blocks[role])
        inputs = {name: output for of, name, output in driven(base, blocks) if of == role}
        assert {(output, name) for name, output in inputs.items() if output} <= found
        # scenarios hold the others at a number, though the FMU could drive them
        assert all(inputs[name] in ("", output) for output, name in found)
        assert found


def test_blocks_with_the_same_output_are_not_connected() -> None:
    connected = connections(load_block("RovDepthPlant"))
    assert not {"RovHeavePitchPlant", "BlueRov2Plant"} & {name for one in connected for name in one.fmus}
    assert "pitch" not in {one.own for one in connected}


def test_both_ends_of_a_connection_have_it_on_their_page() -> None:
    blocks = {name: load_block(name) for name in block_names()}
    ends = {
        (name, one.own, fmu, one.other, one.is_input)
        for name, block in blocks.items()
        for one in connections(block)
        for fmu in one.fmus
    }
    assert ends == {(fmu, other, name, own, not is_input) for name, own, fmu, other, is_input in ends}


def test_a_block_that_fits_no_other_has_no_table() -> None:
    page = documentation(one_block_of_all())["documentation/index.html"].decode()
    assert connections(one_block_of_all()) == []
    assert "Connections with other FMUs" not in page


def test_the_diagram_has_a_port_for_each_declared_variable_at_its_side() -> None:
    block = load_block("L1DepthController")
    root: Any = etree.fromstring(diagram(block, connections(block)))
    ports = {text.text: text.get("text-anchor") for text in root.iter("text") if text.get("class") == "port"}
    sides = {"input": "start", "output": "end"}
    assert ports == {
        n: side for kind, side in sides.items() for n in declared_variables(block.of_causality(kind))
    }
    assert len(list(root.iter("polygon"))) == len(ports)


def test_the_diagram_groups_ports_by_the_fmus_that_they_fit() -> None:
    block = load_block("L1DepthController")
    texts = [text.text for text in etree.fromstring(diagram(block, connections(block))).iter("text")]
    start = texts.index("DepthReference")
    assert texts[start + 1 : start + 5] == [
        "depth_reference",
        "depth_reference_rate",
        "depth_reference_acceleration",
        "BlueRov2Plant or 2 others",
    ]


def test_no_text_of_the_diagram_leaves_it_or_covers_another() -> None:
    block = load_block("L1HeavePitchController")
    root: Any = etree.fromstring(diagram(block, connections(block)))
    width, letter = float(root.get("width")), 7.3  # of a monospaced font of 12 px
    rows: dict[str, float] = {}
    for text in root.iter("text"):
        if text.get("class") == "port":
            rows[text.get("y")] = rows.get(text.get("y"), 0.0) + letter * len(text.text)
    assert max(rows.values()) < width


def test_the_page_is_the_same_each_time() -> None:
    block = load_block("RovDepthPlant")
    assert documentation(block) == documentation(block)
    assert not re.search(rb"0x[0-9a-f]{6}", documentation(block)["documentation/index.html"])
