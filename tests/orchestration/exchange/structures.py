"""Parts of the text of a SystemStructure.ssd, and small packages over one described FMU."""

from pathlib import Path

from fmus.files import write_archive
from orchestration.exchange.ssp_xml import STRUCTURE
from tests.described_fmus import described

BASE = "http://ssp-standard.org/SSP1/SystemStructure"
SPACES = " ".join(
    f'xmlns:{prefix}="{BASE}{name}"'
    for prefix, name in (
        ("ssd", "Description"),
        ("ssc", "Common"),
        ("ssv", "ParameterValues"),
        ("ssm", "ParameterMapping"),
    )
)


def connectors(**kinds: str) -> str:
    """Connectors by their names; "output cm" has a unit."""
    own = ((name, *kind.split(), "") for name, kind in kinds.items())
    texts = (
        f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Real{unit and f" unit={unit!r}"}/></ssd:Connector>'
        for name, kind, unit, *_ in own
    )
    return f"<ssd:Connectors>{''.join(texts)}</ssd:Connectors>"


def component(name: str, inside: str = "", source: str = "f.fmu", **kinds: str) -> str:
    """kinds: of its connectors; by default those of an input u, an output y and a parameter k"""
    own = connectors(**kinds or {"u": "input", "y": "output", "k": "parameter"})
    return f'<ssd:Component name="{name}" source="{source}">{own}{inside}</ssd:Component>'


def system(name: str, elements: str, connections: str = "", before: str = "") -> str:
    inside = f"<ssd:Elements>{elements}</ssd:Elements><ssd:Connections>{connections}</ssd:Connections>"
    return f'<ssd:System name="{name}">{before}{inside}</ssd:System>'


def connection(start: str, end: str, attributes: str = "", inside: str = "") -> str:
    """Between "element.connector"s; of the system itself where no dot is."""
    ends = (
        f'{side}Element="{name.rpartition(".")[0]}" {side}Connector="{name.rpartition(".")[2]}"'
        for side, name in (("start", start), ("end", end))
    )
    return f"<ssd:Connection {' '.join(ends)} {attributes}>{inside}</ssd:Connection>"


def bindings(*sets: str) -> str:
    return f"<ssd:ParameterBindings>{''.join(sets)}</ssd:ParameterBindings>"


def binding(name: str, value: str, prefix: str = "", mapping: str = "") -> str:
    own = f'<ssv:Parameter name="{name}">{value if "<" in value else real(value)}</ssv:Parameter>'
    values = f'<ssv:ParameterSet version="1.0" name="p"><ssv:Parameters>{own}</ssv:Parameters>'
    values = f"<ssd:ParameterValues>{values}</ssv:ParameterSet></ssd:ParameterValues>"
    return f'<ssd:ParameterBinding prefix="{prefix}">{values}{mapping}</ssd:ParameterBinding>'


def real(value: str, unit: str = "") -> str:
    return f'<ssv:Real value="{value}"{unit and f" unit={unit!r}"}/>'


def mapping(source: str, target: str, inside: str = "", attributes: str = "") -> str:
    entry = f'<ssm:MappingEntry source="{source}" target="{target}" {attributes}>{inside}</ssm:MappingEntry>'
    inside = f'<ssm:ParameterMapping version="1.0">{entry}</ssm:ParameterMapping>'
    return f"<ssd:ParameterMapping>{inside}</ssd:ParameterMapping>"


LINEAR = '<ssc:LinearTransformation factor="4" offset="5"/>'
UNITS = '<ssc:Unit name="m"><ssc:BaseUnit m="1"/></ssc:Unit>'
UNITS += '<ssc:Unit name="cm"><ssc:BaseUnit m="1" factor="0.01"/></ssc:Unit>'


def package(folder: Path, root: str, kind: str = "") -> Path:
    """A package of an FMU f.fmu with input u, output y and parameter k in m; kind: type of FMI of k"""
    units = {"u": "m", "y": "m"} | ({} if kind else {"k": "m"})
    fmu = described(folder / "f.fmu", ["u"], ["y"], [f"k:{kind}" if kind else "k"], units)
    text = f'<ssd:SystemStructureDescription {SPACES} name="s" version="1.0">{root}<ssd:Units>{UNITS}'
    text += '</ssd:Units><ssd:DefaultExperiment startTime="1" stopTime="2"/></ssd:SystemStructureDescription>'
    return write_archive(folder / "p.ssp", {"f.fmu": fmu.read_bytes(), STRUCTURE: text.encode()})


NESTED = system(
    "inner",
    component("b"),
    connection("in", "b.u") + connection("b.y", "out") + connection("gain", "b.k"),
    connectors(**{"in": "input", "out": "output", "gain": "parameter"}),
)
