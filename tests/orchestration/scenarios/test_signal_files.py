"""A table of a signal may stand in a CSV file; the scenario that is kept holds its values."""

from pathlib import Path

import pytest

from orchestration.errors import ScenarioError
from orchestration.scenarios import scenario

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
            r"mine.toml:9: .*waves.csv:3: .* columns 1 and 2, got",
        ),
        ('file = "data/waves.csv"', "t,a\n0\n", r"waves.csv:2: expected numbers in columns 1 and 2, got '0'"),
        ('file = "data/waves.csv"', "t,a\n1,0\n0,0\n", r"mine.toml:7: .*table: expected ascending times"),
        ('file = "data/waves.csv"', "t,a\n", r"mine.toml:7: .*table: expected times and as many values"),
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
