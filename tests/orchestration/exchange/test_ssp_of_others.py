"""SSP packages as other tools write them: connections that start at an input, sources with escapes."""

from pathlib import Path

import numpy as np
import pytest

from fmus.files import write_archive
from orchestration.exchange import ssp_read, ssp_write
from orchestration.exchange.ssp_xml import STRUCTURE
from orchestration.scenarios import scenario
from orchestration.system.system import LinearTransformation
from tests.described_fmus import described, members
from tests.orchestration.exchange.conftest import refusal

SPACES = " ".join(
    f'xmlns:{prefix}="http://ssp-standard.org/SSP1/SystemStructure{name}"'
    for prefix, name in (("ssd", "Description"), ("ssc", "Common"), ("ssv", "ParameterValues"))
)
SSV = f"""<ssv:ParameterSet {SPACES} version="1.0" name="set"><ssv:Parameters>
<ssv:Parameter name="p"><ssv:Real value="-2.5"/></ssv:Parameter></ssv:Parameters></ssv:ParameterSet>"""


def package(
    path: Path,
    connections: str = "",
    source: str = "f.fmu",
    member: str = "f.fmu",
    kinds: str = "input output",
) -> Path:
    """A package of two components of one FMU, with input u, output y and parameter p; the .ssv of `a` too.

    source, member: of the FMU, and with .ssv in place of .fmu of the parameters
    """
    fmu = described(path / "f.fmu", inputs=["u"], outputs=["y"], parameters=["p"]).read_bytes()
    connectors = "".join(
        f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Real/></ssd:Connector>'
        for name, kind in zip("uy", kinds.split(), strict=True)
    )
    binding = f'<ssd:ParameterBinding source="{source.replace(".fmu", ".ssv")}"/>'
    bindings = f"<ssd:ParameterBindings>{binding}</ssd:ParameterBindings>"
    components = "".join(
        f'<ssd:Component name="{name}" source="{source}"><ssd:Connectors>{connectors}</ssd:Connectors>'
        f"{bindings if name == 'a' else ''}</ssd:Component>"
        for name in "abc"
    )
    text = (
        f'<ssd:SystemStructureDescription {SPACES} name="s" version="1.0"><ssd:System name="root">'
        f"<ssd:Elements>{components}</ssd:Elements><ssd:Connections>{connections}</ssd:Connections></ssd:System>"
        '<ssd:DefaultExperiment stopTime="1"><ssd:Annotations><ssc:Annotation type="osp" '
        'xmlns:osp="http://opensimulationplatform.com/SSP/OSPAnnotations"><osp:FixedStepAlgorithm '
        'baseStepSize="0.5"/></ssc:Annotation></ssd:Annotations></ssd:DefaultExperiment>'
        "</ssd:SystemStructureDescription>"
    )
    files = {member: fmu, member.replace(".fmu", ".ssv"): SSV.encode(), STRUCTURE: text.encode()}
    return write_archive(path / "p.ssp", files)


def connection(start: str, end: str, inside: str = "") -> str:
    (one, first), (other, second) = start.split("."), end.split(".")
    return (
        f'<ssd:Connection startElement="{one}" startConnector="{first}" endElement="{other}" '
        f'endConnector="{second}">{inside}</ssd:Connection>'
    )


def test_data_flow_from_the_output_to_the_input_whichever_is_the_start(tmp_path: Path) -> None:
    scaled = connection("b.u", "a.y", '<ssc:LinearTransformation factor="-2" offset="0.5"/>')
    with ssp_read.opened(package(tmp_path, scaled + connection("b.y", "c.u"))) as loop:
        assert loop.system.connections == (("a.y", "b.u", LinearTransformation(-2.0, 0.5)), ("b.y", "c.u"))
        assert [target.name for _, target in loop.prepared.system.connections] == ["b.u", "c.u"]


@pytest.mark.parametrize(
    ("kinds", "start", "end"),
    [
        ("input output", "b.u", "a.y"),
        ("inout output", "b.u", "a.y"),
        ("input inout", "b.u", "a.y"),
        ("inout inout", "a.y", "b.u"),
    ],
)
def test_one_connector_whose_kind_is_a_direction_decides(
    tmp_path: Path, kinds: str, start: str, end: str
) -> None:
    """Where neither is, data flow from the start, and the variables of the FMUs must fit."""
    with ssp_read.opened(package(tmp_path, connection(start, end), kinds=kinds)) as loop:
        assert loop.system.connections == (("a.y", "b.u"),)
        assert loop.prepared.system.connections


@pytest.mark.parametrize(
    ("start", "end", "message"),
    [
        ("a.y", "b.y", "connection of a.y and b.y, both outputs: expected one output"),
        ("b.u", "a.u", "connection of b.u and a.u, both inputs: expected one output"),
    ],
)
def test_two_connectors_of_one_direction_are_refused(
    tmp_path: Path, start: str, end: str, message: str
) -> None:
    assert message in refusal(package(tmp_path, connection(start, end)))


@pytest.mark.parametrize(
    ("source", "member"),
    [
        ("resources/my%20fmu%20%231.fmu", "resources/my fmu #1.fmu"),
        ("resources/my fmu #1.fmu", "resources/my fmu #1.fmu"),
        ("resources/my%20fmu.fmu", "resources/my%20fmu.fmu"),
        ("resources/gr%C3%B6%c3%9fe.fmu", "resources/größe.fmu"),
        ("./größe.fmu", "größe.fmu"),
        ("resources%2Ff.fmu", "resources/f.fmu"),
        ("resources/100%.fmu", "resources/100%.fmu"),
        ("resources/a+b.fmu", "resources/a+b.fmu"),
    ],
)
def test_a_source_is_a_uri_with_escapes_or_a_path_without(tmp_path: Path, source: str, member: str) -> None:
    """Of components and of parameter bindings."""
    with ssp_read.opened(package(tmp_path, source=source, member=member)) as loop:
        assert {fmu.name for fmu in loop.system.components.values()} == {Path(member).name}
        assert loop.experiment.parameters == {"a.p": -2.5}


def test_a_source_with_escapes_is_read_as_a_uri_first(tmp_path: Path) -> None:
    path = package(tmp_path, source="x%20y.fmu", member="x y.fmu")
    content = members(path)
    write_archive(path, content | {"x%20y.fmu": b"other", "x%20y.ssv": b"other"})
    with ssp_read.opened(path) as loop:
        assert {fmu.name for fmu in loop.system.components.values()} == {"x y.fmu"}


@pytest.mark.parametrize(
    "source",
    [
        "f.fmu#part",
        "f.fmu?part",
        "file:f.fmu",
        "http://host/f.fmu",
        "//host/f.fmu",
        "/f.fmu",
        "%2Ff.fmu",
        "../f.fmu",
        "in/%2e%2E/f.fmu",
        "C%3A/f.fmu",
        "in%5Cf.fmu",
        "f%00.fmu",
        "f%FF.fmu",
        "",
    ],
)
def test_a_source_outside_the_package_or_with_a_fragment_is_refused(tmp_path: Path, source: str) -> None:
    message = refusal(package(tmp_path, source=source))
    assert f"a: source {source!r}: expected a file in the package, as a relative URI" in message


def test_a_file_outside_the_package_is_refused_though_it_is_there(tmp_path: Path) -> None:
    """By its path, and from the folder of the package up to the root and down again."""
    outside = str(tmp_path / "f.fmu")
    for source in (outside, "../" * 40 + outside.lstrip("/")):
        message = refusal(package(tmp_path, source=source))
        assert f"a: source {source!r}: expected a file in the package" in message
    assert Path(outside).is_file()


def test_sources_are_written_as_uris_without_escapes(tmp_path: Path) -> None:
    """FMUs of different content have different names, also where those differ in what is replaced."""
    for name, unit in (("größe 1#", "m"), ("größe_1%", "cm")):
        described(tmp_path / f"{name}.fmu", inputs=["u"], outputs=["y"], units={"u": unit})
    (tmp_path / "mine.toml").write_text(
        'components = {"one 1" = "größe 1#.fmu", b = "größe_1%.fmu"}\n'
        'inputs = {"one 1.u" = -1.0, "b.u" = 2.0}\n'
        "experiment = {stop_time = 1.0, step_size = 0.5}\n",
        encoding="utf-8",
    )
    written = scenario.load(tmp_path / "mine.toml")
    path = ssp_write.package(written, tmp_path / "mine.ssp", lambda source, folder: folder)
    names = [name for name in members(path) if name.startswith("resources/")]
    assert sorted(names) == ["resources/b.fmu", "resources/gr__e_1_.fmu"]
    with ssp_read.opened(path) as loop:
        fmus = {name: fmu.name for name, fmu in loop.system.components.items()}
        assert fmus == {"one 1": "gr__e_1_.fmu", "b": "b.fmu"}
        np.testing.assert_equal(dict(loop.experiment.inputs), {"one 1.u": -1.0, "b.u": 2.0})
