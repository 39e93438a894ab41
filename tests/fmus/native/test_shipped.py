"""The library that an FMU will carry gives what Python gives, or the FMU is not written."""

import math
import random
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from fmus.block import Block
from fmus.errors import ExportError
from fmus.generate import builder
from fmus.generate.archive import native_members
from fmus.generate.native import ShippedLibrary
from fmus.generate.trace import trace
from fmus.generate.verify import Comparison, check_shipped, check_trace
from fmus.platforms import host_platform, library_name
from tests.described_fmus import members
from tests.shared_builds import Fmus, slow_but, with_libraries

from .blocks import EVERYTHING

RESULTS = {"calculate": "c", "initial_state": "x", "step": "next", "output": "y"}
CODE = "sources/model_code.h"
Members = dict[str, bytes]


def altered(members: Mapping[str, bytes], function: str) -> Members:
    """The same sources, but the first result of a function is larger by a part in a billion."""
    result = f"{RESULTS[function]}[0]"
    head = re.compile(rf"(^static [^\n]*\bmodel_{function}\(.*?)^\}}", re.MULTILINE | re.DOTALL)
    code, count = head.subn(rf"\1    {result} += 1e-9 + 1e-9 * {result};\n}}", members[CODE].decode())
    assert count == 1
    return {**members, CODE: code.encode()}


@pytest.fixture
def library_of() -> Iterator[Callable[[Block, str, Mapping[str, bytes]], ShippedLibrary]]:
    """Loads the library of a block's FMU with these members, which is compiled if it is not among them."""
    opened: list[ShippedLibrary] = []

    def one(block: Block, guid: str, members: Mapping[str, bytes]) -> ShippedLibrary:
        path = library_name(block.name, host_platform())
        built = members if path in members else with_libraries(block.name, dict(members))
        opened.append(ShippedLibrary(trace(block), guid, built[path]))
        return opened[-1]

    yield one
    for library in opened:
        library.close()


@pytest.mark.slow
@pytest.mark.parametrize("function", slow_but(("calculate", "step"), RESULTS))
def test_a_library_that_differs_in_one_function_is_refused(
    library_of: Callable[..., ShippedLibrary], function: str
) -> None:
    guid, members = native_members(trace(EVERYTHING))
    library = library_of(EVERYTHING, guid, altered(members, function))
    message = (
        rf"{function} gives .* in Python and .* when it is compiled; set ZIG_GLOBAL_CACHE_DIR to an empty"
    )
    with pytest.raises(ExportError, match=message):
        check_shipped(check_trace(trace(EVERYTHING)), library)


@pytest.mark.parametrize(
    "name", slow_but(("Everything", "ThrustAllocation"), ["Everything", *builder.block_names()])
)
def test_a_library_is_compared_at_most_points_of_each_function(
    built: Fmus, library_of: Callable[..., ShippedLibrary], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    block = EVERYTHING if name == "Everything" else builder.load_block(name)
    shares: dict[str, float] = {}
    check_compiled = Comparison.check_compiled

    def counting(comparison: Comparison, given: list[list[float] | None], rng: random.Random) -> None:
        name = next(name for name, other in compared.items() if other is comparison)
        shares[name] = sum(numbers is not None for numbers in given) / len(given)
        check_compiled(comparison, given, rng)

    guid, content = native_members(trace(block))
    library = library_of(block, guid, members(built[name]) if name in built else content)
    compared = check_trace(trace(block))
    monkeypatch.setattr(Comparison, "check_compiled", counting)
    check_shipped(compared, library)
    # but where a result is no value of its type; half of the outputs belong to states that no step reached,
    # and of the others 1 of 120 to a state that the library of L1Controller rounds otherwise
    assert shares["initial_state"] > 0.9
    assert shares["step"] > 0.9
    assert shares["output"] >= 119 / 240


def test_an_fmu_whose_library_differs_is_not_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    compiled = builder.compiled_libraries
    monkeypatch.setattr(
        builder,
        "compiled_libraries",
        lambda name, members, *others: compiled(name, altered(members, "step"), *others),
    )
    with pytest.raises(ExportError, match=r"block 'Everything': .*step gives .* when it is compiled"):
        builder.build_block(EVERYTHING, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("j", "is_restored"), [(1.0, True), (-1.0, True), (1.5, False), (math.nan, False)])
def test_a_state_in_memory_is_restored_in_its_range_alone(
    built: Fmus, library_of: Callable[..., ShippedLibrary], j: float, is_restored: bool
) -> None:
    block = builder.load_block("ThrustAllocation")
    guid, _ = native_members(trace(block))
    library = library_of(block, guid, members(built[block.name]))
    arguments = block.inputs(), block.parameters(), block.calculated()
    if is_restored:
        assert library.reached(0.0, 0.1, replace(block.state(), j=j), *arguments)
    else:
        with pytest.raises(ExportError, match="fmi2SetFMUstate returns error: expected ok"):
            library.reached(0.0, 0.1, replace(block.state(), j=j), *arguments)


def test_a_library_of_another_guid_is_refused(library_of: Callable[..., ShippedLibrary]) -> None:
    _, members = native_members(trace(EVERYTHING))
    with pytest.raises(ExportError, match="fmi2GetFMUstate returns error: expected ok"):
        library_of(EVERYTHING, "another", members)
