"""Which blocks there are, and that each is what it says before it becomes an FMU."""

from dataclasses import replace
from importlib.metadata import EntryPoint

import pytest

from fmus import registry
from fmus.block import Block
from fmus.errors import ExportError
from fmus.generate import builder


@pytest.fixture
def offer(monkeypatch: pytest.MonkeyPatch) -> object:
    """Make the builder find one block only, under the name given."""

    def one(name: str, block: Block) -> None:
        point = EntryPoint(name, "somewhere:BLOCK", registry.BLOCKS)
        monkeypatch.setattr(EntryPoint, "load", lambda self: block)
        monkeypatch.setattr(registry, "entry_points", lambda group: [point])

    return one


def test_the_shipped_blocks_are_found() -> None:
    laws = "Adrc", "L1", "Mrac", "Pid", "SlidingMode", "SuperTwisting"
    depth_controllers = [f"{law}DepthController" for law in laws]
    others = "DepthReference L1Controller L1HeavePitchController ThrustAllocation WaveSource"
    plants = "BlueRov2Plant ExamplePlant RovDepthPlant RovHeavePitchPlant"
    assert registry.block_names() == sorted([*depth_controllers, *others.split(), *plants.split()])


def test_every_state_of_a_shipped_block_is_declared() -> None:
    states = [(name, v) for name in registry.block_names() for v in builder.load_block(name).state_variables]
    assert len(states) > 200
    assert not [(name, v.name) for name, v in states if not v.description]


def test_a_block_must_bear_the_name_of_its_entry_point(offer: object) -> None:
    block = builder.load_block("ExamplePlant")
    offer("Mine", block)  # type: ignore[operator]
    with pytest.raises(ExportError, match=r"'Mine' loads a block named 'ExamplePlant'"):
        builder.load_block("Mine")


def test_an_entry_point_that_cannot_be_loaded_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("Broken", "no_such_package:BLOCK", registry.BLOCKS)
    monkeypatch.setattr(registry, "entry_points", lambda group: [point])
    with pytest.raises(ExportError, match=r"'Broken': .* no_such_package:BLOCK .*No module named"):
        builder.load_block("Broken")


def test_an_entry_point_must_lead_to_a_block(offer: object) -> None:
    offer("Mine", 3)  # type: ignore[operator]
    with pytest.raises(ExportError, match=r"entry point somewhere:BLOCK is 3: expected a Block"):
        builder.load_block("Mine")


BAD_NAMES = "None class two__parts 2nd my-block Blöck CON nul Com1 LPT9"


@pytest.mark.parametrize("name", ["", *BAD_NAMES.split()])
def test_a_name_that_no_class_identifier_of_c_or_file_of_windows_can_have_is_refused(name: str) -> None:
    block, expected = (
        replace(builder.load_block("ExamplePlant"), name=name),
        "ASCII letters, digits and single un",
    )
    with pytest.raises(ExportError, match=f"block {name!r}: expected {expected}"):
        builder.verified(block)


def test_a_block_that_cannot_take_a_step_is_refused(offer: object) -> None:
    plant = builder.load_block("ExamplePlant")

    def broken(t: object, *arguments: object) -> object:
        if isinstance(t, float):
            raise AttributeError("no such thing")
        return plant.step(t, *arguments)

    offer("Mine", replace(plant, name="Mine", step=broken))  # type: ignore[operator]
    with pytest.raises(ExportError, match=r"cannot take a step at its start values: .*no such thing"):
        builder.verified(builder.load_block("Mine"))
