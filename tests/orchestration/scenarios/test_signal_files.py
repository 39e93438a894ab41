"""A table of a signal may stand in a CSV file; the scenario that is kept holds its values."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from fmus.files import write_archive
from orchestration.errors import ScenarioError, ScenarioWarning
from orchestration.scenarios import scenario
from tests.described_fmus import XML, described, members

HEAD = """\
[components]
p = "RovDepthPlant"
[experiment]
stop_time = 1
step_size = 0.1
open_inputs = "start"
"""
SIGNAL = '[signals."p.external_force"]\nkind = "table"\n'
WAVES = "time [s],heave,force [N]\n0,9,1\n0.5,9,3\n\n1,9,2\n"


def load(folder: Path, signal: str, csv: str = WAVES) -> scenario.Scenario:
    (folder / "data").mkdir(exist_ok=True)
    (folder / "data" / "waves.csv").write_text(csv, encoding="utf-8")
    path = folder / "mine.toml"
    path.write_text(HEAD + SIGNAL + signal, encoding="utf-8")
    return scenario.load(path)


@pytest.mark.parametrize(
    ("column", "csv", "at_quarter"),
    [
        ('column = "force"', WAVES, 2.0),
        ("", WAVES, 9.0),
        ("", "0,1\n1,5\n", 2.0),
        ("hold = true", "\ufeff0.0,1\n1,5\n", 1.0),
    ],
)
def test_times_are_in_the_first_column_and_values_in_the_second_or_the_named_one(
    tmp_path: Path, column: str, csv: str, at_quarter: float
) -> None:
    loaded = load(tmp_path, f'file = "data/waves.csv"\n{column}\n', csv)
    assert loaded.experiment.signals["p.external_force"](0.25) == pytest.approx(at_quarter)


def test_the_resolved_scenario_needs_no_file(tmp_path: Path) -> None:
    resolved = load(tmp_path, 'file = "data/waves.csv"\ncolumn = "force"\n').resolved
    values = {"times": [0.0, 0.5, 1.0], "values": [1.0, 3.0, 2.0]}
    assert resolved["signals"] == {"p.external_force": {"kind": "table", **values}}


def test_a_file_of_a_base_is_beside_the_base(tmp_path: Path) -> None:
    load(tmp_path, 'file = "data/waves.csv"\ncolumn = "force"\n')
    (tmp_path / "sub").mkdir()
    child = tmp_path / "sub" / "child.toml"
    child.write_text('base = "../mine.toml"\n', encoding="utf-8")
    assert scenario.load(child).experiment.signals["p.external_force"](0.25) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("signal", "csv", "message"),
    [
        ('file = "data/wave.csv"', WAVES, r"mine.toml:9: signals.*wave.csv: expected .*'waves.csv'"),
        ('file = "data/waves.csv"\ncolumn = "forse"', WAVES, r"waves.csv:1: no column 'forse'; .* 'force'"),
        (
            'file = "data/waves.csv"\ncolumn = "a"',
            "0,1\n",
            r"waves.csv:1: column = 'a': expected a first line",
        ),
        (
            'file = "data/waves.csv"',
            "t,a\n0,1\n1,x\n",
            r"mine.toml:9: .*waves.csv:3: expected a number in column 2, got 'x'",
        ),
        ('file = "data/waves.csv"', "t,a\n0\n", r"mine.toml:9: .*waves.csv:2: 1 cells: expected 2"),
        ('file = "data/waves.csv"', "t\n0\n", r"waves.csv:2: expected a number in column 2, got ''"),
        ('file = "data/waves.csv"', ",Time,a\n0,0,1\n", r"waves.csv:1: 'time' is not the first column"),
        (
            'file = "data/waves.csv"\ncolumn = "a"',
            "a,b\n0,1\n",
            r"waves.csv:1: column = 'a': expected another",
        ),
        ('file = "data/waves.csv"', "# mine\n0,1,5\n", r"waves.csv:2: 3 columns without titles: expected"),
        ('file = "data/waves.csv"', "t,a\n1,0\n1,2\n0,0\n", r"mine.toml:9: .*waves.csv:4: earlier time 0 s"),
        ('file = "data/waves.csv"', "t,a\n", r"mine.toml:9: .*table: expected times and as many values"),
        ('file = "data/waves.csv"', "t\n", r"mine.toml:9: .*table: expected times and as many values"),
        (
            'file = "data/waves.csv"\ntimes = [0.0]',
            WAVES,
            r"mine.toml:9: .*file, and times or values: expect",
        ),
        ('fil = "data/waves.csv"', WAVES, r"mine.toml:9: .*unknown key 'fil'; nearest is 'file'"),
    ],
)
def test_a_mistake_is_named_with_file_and_line(tmp_path: Path, signal: str, csv: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        load(tmp_path, f"{signal}\n", csv)


def test_two_rows_of_one_time_are_a_jump(tmp_path: Path) -> None:
    signal = load(tmp_path, 'file = "data/waves.csv"\n', "0,0\n0.5,0\n0.5,1\n1,1\n").experiment.signals
    assert signal["p.external_force"].at(np.array([0.25, 0.5, 0.75])).tolist() == [0.0, 1.0, 1.0]  # type: ignore[attr-defined]


TYPES = {
    "b": '<Boolean start="false"/>',
    "n": '<Integer start="0"/>',
    "e": '<Enumeration declaredType="Mode" start="4"/>',
    "d": '<Real start="0.0"/>',
    "c": '<Real start="0.0" min="-1000" max="1000"/>',
}


@pytest.fixture
def typed(tmp_path: Path) -> Path:
    """An FMU with an input of each type, of which the Real d is discrete, the Real c continuous."""
    content = members(described(tmp_path / "a.fmu", [*TYPES]))
    text = content[XML].decode().replace('variability="continuous"', 'variability="discrete"')
    for i, (name, kind) in enumerate(TYPES.items()):
        old = f'valueReference="{i}" causality="input" variability="discrete"><Real start="0.0"/>'
        new = old if name != "c" else old.replace("discrete", "continuous")
        assert old in text
        text = text.replace(old, new.replace('<Real start="0.0"/>', kind))
    items = '<Enumeration><Item name="Off" value="-2"/><Item name="auto" value="4"/></Enumeration>'
    types = f'<TypeDefinitions><SimpleType name="Mode">{items}</SimpleType></TypeDefinitions>'
    text = text.replace("<ModelVariables>", f"{types}<ModelVariables>")
    return write_archive(tmp_path / "a.fmu", {XML: text.encode()})


def load_typed(fmu: Path, signal: str, csv: str = "") -> scenario.Scenario:
    head = HEAD.replace('p = "RovDepthPlant"', f'a = "{fmu.name}"').replace(
        "step_size = 0.1", "step_size = 0.25"
    )
    (fmu.parent / "d.csv").write_text(csv, encoding="utf-8")
    path = fmu.parent / "typed.toml"
    path.write_text(head + signal, encoding="utf-8")
    return scenario.load(path)


@pytest.mark.parametrize(
    ("name", "csv", "values"),
    [
        ("b", "0,0\n0.5,1\n", [0, 0, 1, 1, 1]),
        ("b", "0,true\n0.3,False\n", [1, 1, 0, 0, 0]),
        ("n", "0,-3\n0.5,10\n", [-3, -3, 10, 10, 10]),
        ("e", "0,auto\n0.5,Off\n0.75,4\n", [4, 4, -2, 4, 4]),
        ("d", "0,1.5\n0.5,2.5\n", [1.5, 1.5, 2.5, 2.5, 2.5]),
        ("c", "0,1.5\n0.5,2.5\n", [1.5, 2.0, 2.5, 2.5, 2.5]),
    ],
)
def test_a_table_of_a_discrete_input_holds_and_takes_its_values_by_name(
    typed: Path, name: str, csv: str, values: list[float]
) -> None:
    """From a file and in the scenario; the resolved scenario has numbers, and is the same run."""
    loaded = load_typed(typed, f'[signals."a.{name}"]\nkind = "table"\nfile = "d.csv"\n', csv)
    assert loaded.prepared.signal_values.tolist() == [values]
    assert loaded.resolved["signals"][f"a.{name}"].get("hold", False) is (name != "c")
    rows = [row.split(",") for row in csv.split()]
    quoted = [x.lower() if x in ("true", "False") else f'"{x}"' if x.isalpha() else x for _, x in rows]
    inline = f"times = [{', '.join(t for t, _ in rows)}]\nvalues = [{', '.join(quoted)}]\n"
    again = load_typed(typed, f'[signals."a.{name}"]\nkind = "table"\n{inline}')
    assert again.resolved == {**loaded.resolved, "title": again.title}


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("b", "yes", "a number or one of false, true"),
        ("e", "aut", "a number or one of Off, auto"),
        ("n", "true", "a number"),
        ("c", "true", "a number"),
    ],
)
def test_a_text_that_is_no_value_of_the_input_is_refused(
    typed: Path, name: str, text: str, expected: str
) -> None:
    table = f'[signals."a.{name}"]\nkind = "table"\n'
    with pytest.raises(
        ScenarioError, match=rf"typed.toml:9: .*d.csv:2: expected {expected} in column 2, got"
    ):
        load_typed(typed, table + 'file = "d.csv"\n', f"0,1\n1,{text}\n")
    for value, got in ((f'"{text}x"', f"'{text}x'"), *([("true", "'true'")] if name != "b" else [])):
        with pytest.raises(
            ScenarioError, match=rf"typed.toml:7: .*table: expected numbers.*, got {got} among"
        ):
            load_typed(typed, table + f"times = [0.0]\nvalues = [{value}]\n")


@pytest.mark.parametrize(
    ("times", "warned"),
    [
        ("[2.0, 3.0]", "p.external_force 2..3 s"),
        ("[-2.0, -0.5]", "p.external_force -2..-0.5 s"),
        ("[1.0, 2.0]", ""),
        ("[-1.0, 0.0]", ""),
        ("[-1.0, 9.0]", ""),
    ],
)
def test_a_table_that_does_not_overlap_the_run_is_a_warning(tmp_path: Path, times: str, warned: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load(tmp_path, f"times = {times}\nvalues = [1.0, 2.0]\n")
    expected = [f"tables that do not overlap the run, 0..1 s, keep one value: {warned}"] if warned else []
    assert [str(w.message) for w in caught if w.category is ScenarioWarning] == expected


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('file = "d.csv"', r"typed.toml:\d+: .*d.csv:3: -2000: expected -1000 to 1000$"),
        (
            "times = [0, 1]\nvalues = [1, -2000]",
            r"typed.toml:\d+: .*values\[1\]: -2000: expected -1000 to 1000$",
        ),
        ("times = [0, 1]\nvalues = [1, 1000.0001]", r"values\[1\]: 1000.0001: expected -1000 to 1000$"),
    ],
)
def test_a_number_out_of_the_range_of_the_input_is_named_with_its_line(
    typed: Path, table: str, message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        load_typed(typed, f'[signals."a.c"]\nkind = "table"\n{table}\n', "0,5\n\n1,-2000\n")
