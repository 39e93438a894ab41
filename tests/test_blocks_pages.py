"""The pages on blocks show the code as it is."""

import re
import runpy
from dataclasses import fields
from pathlib import Path

from fmus import numerics
from fmus.block import Block
from fmus.block.block_file import write_new_block
from fmus.block.units import BASE_UNITS
from fmus.build.builder import load_block

from .page_examples import examples

ROOT = Path(__file__).parent.parent


def page_of_the_site(name: str) -> str:
    """A page that is made with the site."""
    return runpy.run_path(str(ROOT / ".ci" / f"{name}_page.py"))["page"]()


def test_the_reference_of_blocks_has_every_field_function_and_base_unit() -> None:
    page = page_of_the_site("blocks")
    assert {member.name for member in fields(Block)} <= set(re.findall(r"^\| `(\w+)` \|", page, re.M))
    assert set(numerics.__all__) == set(re.findall(r"^\| `(\w+)\(.*\)` \|", page, re.M))
    assert [name for name in BASE_UNITS if f"`{name}`" not in page] == []


def test_the_reference_of_controllers_has_every_parameter_with_its_start_value() -> None:
    """But for the points of a table behind its first one."""
    shown = {
        tuple(row) for row in re.findall(r"^\| `(\S+)` \| (\S+) \|", page_of_the_site("controllers"), re.M)
    }
    for name in ("Pid", "Mrac", "SlidingMode", "SuperTwisting", "Adrc"):
        for v in load_block(f"{name}DepthController").of_causality("parameter"):
            if v.enumeration is None and not re.search(r"_table_\w+\[\d\d?\]$", v.name):
                assert (v.name, repr(v.start)) in shown


def test_the_tutorial_shows_the_block_that_new_writes(tmp_path: Path) -> None:
    shown = examples(ROOT / "docs" / "tutorials" / "your-own-controller.md")
    (block,) = [example.code for example in shown if example.file == "pid.py"]
    assert block == "# pid.py\n" + write_new_block("pid", tmp_path)[0].read_text(encoding="utf-8")
