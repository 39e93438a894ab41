"""Units that files and options state: each reader gives a value in the unit of the variable, or an error."""

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.files import write_archive
from fmus.fmi.description import describe
from fmus.units import UnitDefinition
from orchestration.cli.changes import Changes
from orchestration.errors import OrchestrationError, ScenarioError, SystemDefinitionError
from orchestration.exchange import ssp_read
from orchestration.exchange.ssp_xml import STRUCTURE
from orchestration.report.find import _measured
from orchestration.scenarios import scenario
from orchestration.studies.fit.dive import read_dive
from orchestration.studies.score.protocol import read_protocol
from orchestration.studies.vehicle import Vehicle
from orchestration.sweep.varied import sweep_table, target, varied
from orchestration.system.experiment import Experiment
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.quantities import Conversion, are_equal, conversion
from orchestration.system.system import System, check
from tests.described_fmus import described, redescribed

# m as in SI, and units that the FMU alone has or means otherwise
DEFINITIONS = (
    '<UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit>'
    '<Unit name="fm"><BaseUnit m="1" factor="1.8"/></Unit>'
    '<Unit name="C"><BaseUnit K="1" offset="273.15"/></Unit></UnitDefinitions><ModelVariables>'
)
UNITS = {"u": "m", "y": "m", "k": "m", "depth": "m", "control_force": "m", "t": "C", "share": "1"}


@pytest.fixture
def fmu(tmp_path: Path) -> Path:
    """An FMU whose control_force is in m, so that a dive is read as all else is."""
    inputs = ["u", "control_force", "plain", "n:Integer"]
    parameters = ["k", "t", "share", "bare", "word:String"]
    plain = described(tmp_path / "plain.fmu", inputs, ["y", "depth"], parameters, UNITS)
    return redescribed(plain, tmp_path / "a.fmu", lambda xml: xml.replace("<ModelVariables>", DEFINITIONS))


def loaded(folder: Path, lines: str, **settings: object) -> scenario.Scenario:
    path = folder / "s.toml"
    experiment = '[experiment]\nstop_time = 1.0\nstep_size = 0.5\nopen_inputs = "start"\n'
    path.write_text(f'[components]\na = "a.fmu"\n{experiment}{lines}')
    return scenario.load(path, settings=settings.get("settings"))  # pyright: ignore


def of_table(folder: Path, number: float, unit: str) -> object:
    (folder / "d.csv").write_text(f"t [ms],v [s],u [{unit}]\n-500,1,{number}\n0,2,7\n")
    lines = '[signals."a.u"]\nkind = "table"\nfile = "d.csv"\ncolumn = "u"\n'
    table = loaded(folder, lines).resolved["signals"]["a.u"]
    assert table["times"] == [-0.5, 0.0]
    assert table.keys() == {"kind", "times", "values"}
    return table["values"][0]


def of_inline_table(folder: Path, number: float, unit: str) -> object:
    lines = f'[signals."a.u"]\nkind = "table"\ntimes = [0, 1]\nvalues = [{number}, 0]\nunit = "{unit}"\n'
    return loaded(folder, lines).resolved["signals"]["a.u"]["values"][0]


def of_table_without_titles(folder: Path, number: float, unit: str) -> object:
    (folder / "d.csv").write_text(f"0,{number}\n1,7\n")
    lines = f'[signals."a.u"]\nkind = "table"\nfile = "d.csv"\nunit = "{unit}"\n'
    return loaded(folder, lines).resolved["signals"]["a.u"]["values"][0]


def parameter_file(folder: Path, number: float, unit: str) -> Path:
    path = folder / "p.toml"
    path.write_text(f'[parameters."a.k"]\nvalue = {number}\nunit = "{unit}"\n')
    return path


def of_parameter_file(folder: Path, number: float, unit: str) -> object:
    lines = f'parameter_files = ["{parameter_file(folder, number, unit).name}"]\n'
    (folder / "base.toml").write_text(f'{lines}[components]\na = "a.fmu"\n')
    (folder / "s.toml").write_text('base = "base.toml"\n[experiment]\nstop_time = 1.0\nstep_size = 0.5\n')
    return scenario.load(folder / "s.toml").experiment.parameters["a.k"]


def of_option_parameters(folder: Path, number: float, unit: str) -> object:
    changes = Changes.of_options(parameters=str(parameter_file(folder, number, unit)))
    # what the options of a sweep or of a page name again
    again = Changes.of_options(settings=[changes.options()[1]])
    values = [loaded(folder, "", settings=x.settings).experiment.parameters["a.k"] for x in (changes, again)]
    assert values[0] == values[1]
    return values[0]


def of_option_set(folder: Path, number: float, unit: str) -> object:
    changes = Changes.of_options(settings=[f"a.k={number}{unit}", f"a.u={number} {unit}"])
    experiment = loaded(folder, "", settings=changes.settings).experiment
    assert experiment.parameters["a.k"] == experiment.inputs["a.u"]
    return experiment.parameters["a.k"]


def of_scenario(folder: Path, number: float, unit: str) -> object:
    lines = f'[parameters]\n"a.k" = "{number} {unit}"\n[inputs]\n"a.u" = "{number} {unit}"\n'
    experiment = loaded(folder, lines).experiment
    assert experiment.parameters["a.k"] == experiment.inputs["a.u"]
    return experiment.parameters["a.k"]


def of_event(folder: Path, number: float, unit: str) -> object:
    lines = f'[inputs]\n"a.u" = 0.0\n[[events]]\ntime = 0.5\nset = {{"a.u" = "{number} {unit}"}}\n'
    (changes,) = loaded(folder, lines).prepared.changes.values()
    return changes[0][1]


def of_sweep(entry: str) -> Callable[[Path, float, str], object]:
    def read(folder: Path, number: float, unit: str) -> object:
        chosen = loaded(folder, f'[sweep.vary."a.k"]\n{entry.format(number=number, unit=unit)}\n')
        declared: Any = sweep_table(chosen.sweep, lambda _: "s").vary["a.k"]
        of_name = varied(target("a.k", chosen.prepared.system, chosen.experiment), declared, "s")
        return of_name.grid[0] if of_name.draw is None else of_name.draw([0.0])[0]

    return read


def of_draw(folder: Path, number: float, unit: str) -> object:
    text = f'distribution = "uniform"\nlow = {number}\nhigh = 1e6\nunit = "{unit}"\n'
    (folder / "a.vehicle.toml").write_text(f'[vary.k]\nvariables = ["plant.k"]\n{text}')
    law = read_protocol(vehicle=Vehicle.of(str(folder / "a.fmu"))).law("k")
    assert law.quantile([0.0])[0] == law.reach[0]
    return law.reach[0]


def of_vehicle(folder: Path, number: float, unit: str) -> object:
    (folder / "a.vehicle.toml").write_text('[variables]\ninertia = "k"\n')
    settings = Changes.of_options(settings=[f"plant.k={number}{unit}"]).settings
    return Vehicle.of(str(folder / "a.fmu"), settings=settings).values().heave[0]


def of_dive(folder: Path, number: float, unit: str) -> object:
    titles = f"time [min],depth [{unit}],control_force [{unit}]"
    (folder / "dive.csv").write_text(f"{titles}\n1,{number},{number}\n2,700,8\n")
    dive = read_dive(folder / "dive.csv", Vehicle.of(str(folder / "a.fmu")))
    assert dive.times.tolist() == [0.0, 60.0]
    return np.asarray(dive.commands["control_force"].values)[0]


def of_parameter_set(folder: Path, number: float, unit: str) -> object:
    return ssp(folder, f'<ssv:Real value="{number}" unit="{unit}"/>', "")


def ssp(folder: Path, value: str, unit: str, units: str = "", end: str = "") -> object:
    """Returns a.k of a package whose system binds the value by a prefix; unit, end: of the connectors."""
    base = "http://ssp-standard.org/SSP1/SystemStructure"
    spaces = f'xmlns:ssd="{base}Description" xmlns:ssc="{base}Common" xmlns:ssv="{base}ParameterValues"'
    values = f'<ssv:Parameter name="k">{value}</ssv:Parameter>' if value else ""
    connectors = "".join(
        f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Real{own and f" unit={own!r}"}/></ssd:Connector>'
        for name, kind, own in (("y", "output", unit), ("u", "input", end or unit))
    )
    components = "".join(
        f'<ssd:Component name="{name}" source="resources/{name}.fmu" type="application/x-fmu-sharedlibrary">'
        f"<ssd:Connectors>{connectors}</ssd:Connectors></ssd:Component>"
        for name in ("a", "b")
    )
    text = f"""<ssd:SystemStructureDescription {spaces} name="s" version="1.0"><ssd:System name="r">
        <ssd:ParameterBindings><ssd:ParameterBinding prefix="a."><ssd:ParameterValues>
        <ssv:ParameterSet name="p" version="1.0"><ssv:Parameters>{values}</ssv:Parameters></ssv:ParameterSet>
        </ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>
        <ssd:Elements>{components}</ssd:Elements><ssd:Connections><ssd:Connection startElement="a"
        startConnector="y" endElement="b" endConnector="u"/></ssd:Connections></ssd:System>
        <ssd:Units>{units}</ssd:Units><ssd:DefaultExperiment stopTime="1"/>
        </ssd:SystemStructureDescription>"""
    stepped = '<DefaultExperiment stepSize="0.1"/><ModelVariables>'
    fmu = redescribed(
        folder / "a.fmu", folder / "c.fmu", lambda xml: xml.replace("<ModelVariables>", stepped)
    )
    files = {f"resources/{name}.fmu": fmu.read_bytes() for name in ("a", "b")}
    write_archive(folder / "p.ssp", {STRUCTURE: text.encode(), **files})
    with ssp_read.opened(folder / "p.ssp") as chosen:
        return chosen.experiment.parameters.get("a.k")


READERS = {
    "a table": of_table,
    "a table in the scenario": of_inline_table,
    "a table without titles": of_table_without_titles,
    "a parameter file": of_parameter_file,
    "--parameters": of_option_parameters,
    "--set": of_option_set,
    "a scenario": of_scenario,
    "an event": of_event,
    "values of a sweep": of_sweep('values = ["{number} {unit}"]'),
    "a grid": of_sweep('values = [{number}]\nunit = "{unit}"'),
    "a range": of_sweep('linspace = [{number}, 1e6, 3]\nunit = "{unit}"'),
    "a distribution": of_sweep('distribution = "uniform"\nlow = {number}\nhigh = 1e6\nunit = "{unit}"'),
    "a choice": of_sweep('distribution = "choice"\nvalues = [{number}]\nunit = "{unit}"'),
    "a draw": of_draw,
    "a vehicle": of_vehicle,
    "a dive": of_dive,
    "a parameter set": of_parameter_set,
}


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
def test_each_reader_gives_a_value_in_the_unit_of_the_variable(
    fmu: Path, reader: Callable[[Path, float, str], object]
) -> None:
    """A prefix of SI, a definition of the FMU that is no prefix of SI, and the unit itself; kg is refused."""
    values = [
        reader(fmu.parent, number, unit) for number, unit in ((-150.0, "cm"), (-2.0, "fm"), (-2.5, "m"))
    ]
    assert values == [-1.5, -3.6, -2.5]
    with pytest.raises(
        OrchestrationError, match="unit 'kg': expected m or a unit of its dimension"
    ) as refusal:
        reader(fmu.parent, 1.5, "kg")
    place = r"--set |\S+\.(csv|toml):\d+: |\S+\.ssp: \S+\.ssd:\d+: |\S+s\.toml: |s: |a\.u"
    assert re.match(place, str(refusal.value))
    with pytest.raises(OrchestrationError, match=r"unknown unit 'cmm': expected m .*; nearest is 'mm'"):
        reader(fmu.parent, 1.5, "cmm")


@pytest.mark.parametrize(
    ("unit", "expected", "value"),
    [
        ("m", "m", 20.0),
        ("", "anything", 20.0),
        ("km", "m", 20e3),
        ("um", "m", 20e-6),
        ("mm", "cm", 2.0),
        ("kN.s/m", "N.s/m", 20e3),
        ("degC", "K", 293.15),
        ("K", "degC", -253.15),
        ("degF", "degC", -20.0 / 3.0),
        ("deg", "rad", np.pi / 9.0),
        ("rpm", "rad/s", 2.0 * np.pi / 3.0),
        ("rev/min", "rpm", 20.0),
        ("h", "min", 1200.0),
        ("%", "1", 0.2),
        ("1", "%", 2000.0),
        ("-", "1", 20.0),
        ("-", "-", 20.0),
        ("1", "-", 20.0),
        ("1", "", 20.0),
        ("l/min", "m3/s", 20e-3 / 60.0),
        ("mbar", "Pa", 2000.0),
    ],
)
def test_names_in_si_units_are_converted_both_ways(unit: str, expected: str, value: float) -> None:
    change = conversion(unit, expected)
    assert change(20.0) == pytest.approx(value, rel=1e-14, abs=1e-12)
    assert change.inverse(change(-3.0)) == pytest.approx(-3.0, rel=1e-12)


def test_a_definition_goes_over_the_name(fmu: Path) -> None:
    """C of this FMU is the degree Celsius, of SI the coulomb; some tools write a rad without exponents."""
    units = describe(fmu).modelVariables[0].units
    assert conversion("C", "K", units)(-20.0) == pytest.approx(253.15)
    assert conversion("K", "C", units)(253.15) == pytest.approx(-20.0)
    assert conversion("mC", "A.s", units) == Conversion(divisor=1000.0)
    without = {"rad": UnitDefinition(), "m": UnitDefinition({"m": 1}), "cm": UnitDefinition({"kg": 1})}
    assert conversion("deg", "rad", without)(-180.0) == pytest.approx(-np.pi, rel=1e-15)
    with pytest.raises(SystemDefinitionError, match="unit 'cm': expected m"):
        conversion("cm", "m", without)


@pytest.mark.parametrize(("factor", "is_equal"), [(1.0 + 5e-13, True), (1.0 + 2e-12, False), (-1.0, False)])
def test_units_are_equal_within_the_digits_that_tools_write(factor: float, is_equal: bool) -> None:
    degree = UnitDefinition({"rad": 1}, np.pi / 180.0, 273.15)
    other = UnitDefinition({"rad": 1}, np.pi / 180.0 * factor, 273.15 * factor)
    assert are_equal("a", "b", {"b": degree}, {"a": other}) == is_equal
    assert are_equal("a", None, {}, {})
    assert not are_equal("kg", "m", {}, {})


def test_a_variable_without_a_unit_takes_no_unit_but_of_a_parameter_file(fmu: Path) -> None:
    """Many FMUs state no units: parameter files for them have units for readers."""
    folder = fmu.parent
    with pytest.raises(ScenarioError, match=r"s.toml:\d+: a.plain = '3 cm': unit 'cm': expected no unit"):
        loaded(folder, '[inputs]\n"a.plain" = "3 cm"\n')
    assert loaded(folder, '[inputs]\n"a.plain" = "3 1"\n').experiment.inputs == {"a.plain": 3.0}
    (folder / "p.toml").write_text('[parameters."a.bare"]\nvalue = 3.0\nunit = "cm"\n')
    chosen = loaded(folder, "", settings=Changes.of_options(parameters=str(folder / "p.toml")).settings)
    assert chosen.experiment.parameters == {"a.bare": 3.0}
    (folder / "p.toml").write_text('[parameters."a.word"]\nvalue = "3"\nunit = "cm"\n')
    with pytest.raises(ScenarioError, match=r"p.toml:1: a.word = '3' has the unit 'cm': expected a number"):
        Changes.of_options(parameters=str(folder / "p.toml"))


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("a.k=fast", "--set a.k = 'fast': expected a number in m"),
        ("a.share=fast", "--set a.share = 'fast': expected a number"),
        ("a.k=true", "--set a.k = True: expected a value of type Real"),
        ("a.k=1,5 m", "--set a.k = '1,5 m': expected a number in m"),
        ("a.k=1 500 m", "--set a.k = '1 500 m': expected a number in m"),
        ("a.k=inf m", "--set a.k = inf: expected a finite number"),  # as SSP's INF with a unit
        ("a.k=inf", "--set a.k = inf: expected a finite number"),
        ("a.n=3cm", "--set a.n = '3cm': expected a value of type Integer, which has no unit"),
        ("a.k=6V", "--set a.k = '6V': unit 'V': expected m or a unit of its dimension"),
        ("a.k=1e5", ""),
        ("a.word=3 cm", ""),
    ],
)
def test_a_wrong_value_names_the_option(fmu: Path, assignment: str, message: str) -> None:
    settings = Changes.of_options(settings=[assignment]).settings
    if message:
        with pytest.raises(OrchestrationError, match=re.escape(message)) as refusal:
            loaded(fmu.parent, "", settings=settings)
        assert ".toml" not in str(refusal.value)
    else:
        parameters = loaded(fmu.parent, "", settings=settings).experiment.parameters
        assert parameters in ({"a.k": 1e5}, {"a.word": "3 cm"})


@pytest.mark.parametrize(
    ("name", "unit", "read"),
    [("k", "g", 2e-3), ("k", "degC", 275.15), ("depth", "cm", None), ("z", "km", None), ("z", "m", 2.0)],
)
def test_a_vehicle_is_read_in_si_units_and_its_depth_is_in_m(
    tmp_path: Path, name: str, unit: str, read: float | None
) -> None:
    fmu = described(tmp_path / "a.fmu", ["control_force"], ["depth"], ["k", "z"], {name: unit})
    (tmp_path / "a.vehicle.toml").write_text('[variables]\ninertia = "k"\nstart_depth = "z"\n')
    if read is None:
        with pytest.raises(ScenarioError, match=f"plant is a: {name} is in {unit}: expected m"):
            Vehicle.of(str(fmu))
    else:
        assert Vehicle.of(str(fmu), settings={"plant.k": 2.0}).values().heave[0] == read


def test_a_file_of_a_package_defines_its_own_units(fmu: Path) -> None:
    fathom = '<ssc:Unit name="fathom"><ssc:BaseUnit m="1" factor="1.8288"/></ssc:Unit>'
    assert ssp(fmu.parent, '<ssv:Real value="-2" unit="fathom"/>', "", fathom) == -3.6576
    metre = '<ssc:Unit name="metre"><ssc:BaseUnit m="1"/></ssc:Unit>'
    ssp(fmu.parent, "", "metre", metre)
    with pytest.raises(ScenarioError, match=r"connector a.y is in cm: expected m, the unit in the FMU"):
        ssp(fmu.parent, "", "cm")
    with pytest.raises(ScenarioError, match=r"connector a\.u is in kg: expected m"):
        ssp(fmu.parent, "", "m", end="kg")
    with pytest.raises(ScenarioError, match=r"a unit: .*'x'"):
        ssp(fmu.parent, "", "m", '<ssc:Unit name="x"><ssc:BaseUnit m="x"/></ssc:Unit>')


def test_a_setting_of_the_experiment_is_varied_in_any_unit_of_time(fmu: Path) -> None:
    entry = '[sweep.vary."experiment.step_size"]\nvalues = [500, 250]\nunit = "ms"\n'
    chosen = loaded(fmu.parent, entry)
    declared: Any = sweep_table(chosen.sweep, lambda _: "s").vary["experiment.step_size"]
    name = target("experiment.step_size", chosen.prepared.system, chosen.experiment)
    assert varied(name, declared, "s").grid == (0.5, 0.25)


def test_a_truncated_distribution_is_cut_at_the_limits_of_the_variable(fmu: Path) -> None:
    most = ' unit="m" max="2"'
    limited = redescribed(fmu, fmu.parent / "b.fmu", lambda xml: xml.replace(' unit="m"', most))
    checked = check(System({"a": limited}), open_inputs=OpenInputs.START)
    law = 'distribution = "normal"\nmean = 199.0\nstd = 10.0\ntruncate = true\nunit = "cm"\n'
    declared: Any = sweep_table(tomllib.loads(f'[vary."a.k"]\n{law}'), lambda _: "s").vary["a.k"]
    draw = varied(target("a.k", checked, Experiment(1.0, 0.1)), declared, "s").draw
    assert draw is not None
    assert draw([0.999999])[0] == pytest.approx(2.0, abs=1e-4)
    assert draw([0.5])[0] == pytest.approx(1.94, abs=0.02)


def test_a_measured_column_is_in_the_unit_of_the_page(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t [min],T [degC],a,b [x],c [cm]\n1,-20,1,2,3\n2,0,1,2,4\n")
    recording = _measured(tmp_path / "log.csv", {"K", "m", ""}).recording
    assert recording.units == ("K", "", "x", "m")
    assert recording.time.tolist() == [60.0, 120.0]
    assert recording.values.tolist() == [[pytest.approx(253.15), 1.0, 2.0, 0.03], [273.15, 1.0, 2.0, 0.04]]


@pytest.mark.parametrize("of_type", [False, True])
def test_the_offset_of_a_unit_is_ignored_for_a_relative_quantity(tmp_path: Path, of_type: bool) -> None:
    """Stated by the variable or its type; a relative quantity in degC is none of an absolute one in degC."""
    units = (
        '<Unit name="K"><BaseUnit K="1"/></Unit><Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>'
    )
    types = '<SimpleType name="D"><Real relativeQuantity="true"/></SimpleType>'
    definitions = f"<UnitDefinitions>{units}</UnitDefinitions><TypeDefinitions>{types}</TypeDefinitions>"
    head = f"{definitions}<ModelVariables>"
    stated = 'declaredType="D"' if of_type else 'relativeQuantity="1"'

    def change(xml: str) -> str:
        for name in ("d", "y", "u"):
            xml = re.sub(rf'(name="{name}" .*?<Real) ', rf"\1 {stated} ", xml)
        return xml.replace("<ModelVariables>", head)

    names = {"d": "K", "y": "degC", "u": "K", "absolute": "degC", "other": "K"}
    plain = described(tmp_path / "p.fmu", ["u", "absolute", "other"], ["y"], ["d"], names)
    fmu = redescribed(plain, tmp_path / "a.fmu", change)
    settings = Changes.of_options(settings=["a.d=5degC", "a.other=5degC"]).settings
    experiment = loaded(tmp_path, "", settings=settings).experiment
    assert (experiment.parameters["a.d"], experiment.inputs["a.other"]) == (5.0, 278.15)
    check(System({"a": fmu}, [("a.y", "a.u")]), ["a.absolute", "a.other"])
    with pytest.raises(SystemDefinitionError, match="got degC and degC, of which one is a relative quantity"):
        check(System({"a": fmu}, [("a.y", "a.absolute")]), ["a.u", "a.other"])
