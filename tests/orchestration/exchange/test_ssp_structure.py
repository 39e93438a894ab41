"""SSP by its text: nested systems, arrays, units of connectors, signal dictionaries."""

import random
from pathlib import Path

import pytest

from fmus.files import write_archive
from orchestration.errors import SystemDefinitionError
from orchestration.exchange import ssp_read
from orchestration.exchange.ssp_xml import STRUCTURE
from orchestration.system.system import LinearTransformation
from tests.described_fmus import described, members
from tests.orchestration.exchange.conftest import refusal
from tests.orchestration.exchange.structures import (
    LINEAR,
    NESTED,
    component,
    connection,
    connectors,
    package,
    system,
)


def test_systems_in_systems_become_components_of_one_level(tmp_path: Path) -> None:
    wires = connection("a.y", "inner.in") + connection("c.u", "inner.out")
    root = system("root", component("a") + NESTED + component("c"), wires)
    with ssp_read.opened(package(tmp_path, root)) as loop:
        assert list(loop.system.components) == ["a", "inner.b", "c"]
        assert set(loop.system.connections) == {("a.y", "inner.b.u"), ("inner.b.y", "c.u")}
        assert loop.experiment.record == ("a.y", "inner.b.y", "c.y")
        # the names have dots: checked as those of any system
        assert {port.component for pair in loop.prepared.system.connections for port in pair} == {
            "a",
            "inner.b",
            "c",
        }
        assert (loop.experiment.start_time, loop.experiment.stop_time) == (1.0, 2.0)
        assert loop.experiment.step_size == 0.001  # a thousandth of the run


@pytest.mark.parametrize(
    ("attributes", "inside", "expected"),
    [
        ("", "", []),
        ("", LINEAR, [LinearTransformation(4.0, 0.05)]),
        ('suppressUnitConversion="true"', LINEAR, [LinearTransformation(0.04, 0.05)]),
        ('suppressUnitConversion="true"', "", [LinearTransformation(0.01)]),
    ],
)
def test_units_of_connectors_are_converted_before_a_transformation(
    tmp_path: Path, attributes: str, inside: str, expected: list[LinearTransformation]
) -> None:
    """m to cm by the outer connection, unless it is suppressed, and cm to m by the inner one."""
    inner = system("d", component("b"), connection("in", "b.u"), connectors(**{"in": "input cm"}))
    root = system("root", component("a") + inner, connection("a.y", "d.in", attributes, inside))
    with ssp_read.opened(package(tmp_path, root)) as loop:
        ((*names, change),) = [(one, other, given) for one, other, *given in loop.system.connections]
    assert (names, change) == (["a.y", "d.b.u"], expected)


def test_a_unit_that_is_not_defined_is_refused_but_where_its_conversion_is_suppressed(tmp_path: Path) -> None:
    for attributes, message in (
        ("", "connection a.y -> d.in: unit 'm': expected furlongs or a unit"),
        ('suppressUnitConversion="true"', ""),
    ):
        inner = system(
            "d",
            component("b"),
            connection("in", "b.u", 'suppressUnitConversion="1"'),
            connectors(**{"in": "input furlongs"}),
        )
        root = system("root", component("a") + inner, connection("a.y", "d.in", attributes))
        if message:
            assert message in refusal(package(tmp_path, root))
            continue
        with ssp_read.opened(package(tmp_path, root)) as loop:
            assert loop.system.connections == (("a.y", "d.b.u"),)


def test_a_package_without_a_stop_time_is_refused(tmp_path: Path) -> None:
    path = package(tmp_path, system("root", component("a")))
    text = members(path)[STRUCTURE].replace(b' stopTime="2"', b"")
    write_archive(path, members(path) | {STRUCTURE: text})
    assert "expected a default experiment with a stop time, of it or of an FMU" in refusal(path)


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [("x[1] x[2]", "v[1] v[2] v[3]", "'a.x'"), ("x[1] x[2]", "w", "'a.x'"), ("y", "w", "'a.x'")],
)
def test_arrays_of_different_sizes_and_unknown_names_are_refused(
    tmp_path: Path, source: str, target: str, message: str
) -> None:
    """A connection of x and v: no such variables, or arrays of them."""
    path = package(tmp_path, system("root", component("a"), connection("a.x", "a.v")))
    fmu = described(tmp_path / "g.fmu", target.split(), source.split(), ["k"])
    write_archive(path, members(path) | {"f.fmu": fmu.read_bytes()})
    with ssp_read.opened(path) as loop, pytest.raises(SystemDefinitionError, match=message):
        _ = loop.prepared


@pytest.mark.parametrize("start", ["inner.outt", "outt"])
def test_a_connector_of_a_system_that_is_not_there_is_refused(tmp_path: Path, start: str) -> None:
    """In the system itself and in one inside it: the input would stay open in silence."""
    root = system("root", component("a") + NESTED, connection(start, "a.u"), connectors(out="input"))
    message = refusal(package(tmp_path, root))
    assert f"connection of {start}: no connector 'outt'; nearest is 'out'" in message


def test_arrays_are_connected_element_by_element(tmp_path: Path) -> None:
    path = package(tmp_path, system("root", component("a"), connection("a.x", "a.v")))
    fmu = described(tmp_path / "g.fmu", ["v[1]", "v[2]"], ["x[1]", "x[2]"], ["k"])
    write_archive(path, members(path) | {"f.fmu": fmu.read_bytes()})
    with ssp_read.opened(path) as loop:
        assert loop.system.connections == (("a.x[1]", "a.v[1]"), ("a.x[2]", "a.v[2]"))


def test_a_signal_dictionary_renames(tmp_path: Path) -> None:
    reference = '<ssd:SignalDictionaryReference name="{}" dictionary="bus">{}</ssd:SignalDictionaryReference>'
    one, other = reference.format("bus", connectors(s="inout")), reference.format("b2", connectors(s="inout"))
    inner = system("inner", component("b") + other, connection("b2.s", "b.u"))
    root = system("root", component("a") + one + inner, connection("a.y", "bus.s"))
    with ssp_read.opened(package(tmp_path, root)) as loop:
        assert loop.system.connections == (("a.y", "inner.b.u"),)


def test_a_component_that_is_no_fmu_is_refused_by_its_name(tmp_path: Path) -> None:
    root = system("root", system("inner", component("table", source=STRUCTURE)))
    assert "component inner.table: source SystemStructure.ssd: expected an FMU" in refusal(
        package(tmp_path, root)
    )


@pytest.mark.parametrize("seed", range(20))
def test_random_nested_systems_connect_as_the_flat_ones(tmp_path: Path, seed: int) -> None:
    """Each path from an output to an input leads up and down through connectors, in either order of ends."""
    rng = random.Random(seed)
    places = [[f"s{rng.randrange(3)}" for _ in range(rng.randrange(3))] for _ in range(5)]
    names = [[*place, f"c{i}"] for i, place in enumerate(places)]
    wires: dict[tuple[str, ...], list[str]] = {}
    inner: dict[tuple[str, ...], dict[str, str]] = {}
    expected = set[tuple[str, str]]()

    def wire(at: tuple[str, ...], start: str, end: str) -> None:
        ends = (start, end) if rng.random() < 0.5 else (end, start)
        wires.setdefault(at, []).append(connection(*ends))

    for number, target in enumerate(names):
        source = names[rng.randrange(5)]
        depth = (
            next(i for i, (a, b) in enumerate(zip([*source, ""], [*target, "-"], strict=False)) if a != b)
            if source != target
            else len(source) - 1
        )
        expected.add((f"{'.'.join(source)}.y", f"{'.'.join(target)}.u"))
        out, into = f"{source[-1]}.y", f"{target[-1]}.u"
        for level in range(len(source) - 1, depth, -1):
            inner.setdefault(tuple(source[:level]), {})[f"o{number}"] = "output"
            wire(tuple(source[:level]), out, f"o{number}")
            out = f"{source[level - 1]}.o{number}"
        for level in range(len(target) - 1, depth, -1):
            inner.setdefault(tuple(target[:level]), {})[f"i{number}"] = "input"
            wire(tuple(target[:level]), f"i{number}", into)
            into = f"{target[level - 1]}.i{number}"
        wire(tuple(source[:depth]), out, into)

    def text(at: tuple[str, ...]) -> str:
        own = "".join(component(name[-1]) for name in names if tuple(name[:-1]) == at)
        below = sorted(
            {tuple(n[: len(at) + 1]) for n in names if tuple(n[: len(at)]) == at and len(n) > len(at) + 1}
        )
        own += "".join(text(one) for one in below)
        return system(
            at[-1] if at else "root", own, "".join(wires.get(at, [])), connectors(**inner.get(at, {}))
        )

    with ssp_read.opened(package(tmp_path, text(()))) as loop:
        assert set(loop.system.connections) == expected
