"""Files of data as other programs write them, without a scenario."""

from pathlib import Path

import numpy as np
import pytest

from orchestration.errors import ScenarioError
from orchestration.scenarios.data_file import DataFile, read_data_file


def read(folder: Path, text: str) -> DataFile:
    path = folder / "d.csv"
    path.write_text(text, encoding="utf-8")
    return read_data_file(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,roll,u\n0,0.1,5\n0.5,0.1,15.8,6\n", r"d.csv:3: 4 cells: expected 3"),
        ("# a log\n\ntime;u\n0;1\n1\n", r"d.csv:5: 1 cells: expected 2"),
        ("0,1\n1,2,\n", r"d.csv:2: 3 cells: expected 2"),
        ("0,1\n1,2,5\n", r"d.csv:2: 3 cells: expected 2"),  # a decimal comma
        ("# a log\nt,u,v [m],v [mm]\n0,1,2,3\n", r"d.csv:2: two columns 'v': expected titles that differ"),
        ("t;u\n0,5;1\n1;1.000\n", r"d.csv:3: got '1.000', after '0,5' in line 2: expected one decimal sign"),
        ("0.5;1\n1;1,000\n", r"d.csv:2: got '1,000', after '0.5' in line 1: expected one decimal sign"),
        ("t\0,\0u\0", r"d.csv: expected a CSV file, got UTF-16 or no text; save it as UTF-8"),
    ],
)
def test_rows_are_as_long_as_the_first_with_one_decimal_sign_and_titles_differ(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        read(tmp_path, text)


def test_columns_without_a_title_may_be_many(tmp_path: Path) -> None:
    assert read(tmp_path, "t,,\n0,1,2\n").numbers(0, 2).tolist() == [[0.0, 2.0]]


@pytest.mark.parametrize(
    ("text", "line", "cell"),
    [
        ('t,u\n0,1\n1,"1,000"\n', 3, "'1,000'"),
        ('0,"1,5"\n', 1, "'1,5'"),
        ("t,u\n0,1_000\n", 2, "'1_000'"),
        ("1_000,2\n2_000,3\n", 1, "'1_000'"),
        ("NaN,1.5\n1,2\n", 1, "'NaN'"),
        ("# time,u\nnan,1\n1,2\n", 2, "'nan'"),
        ("t;u\n0;1_000,5\n", 2, "'1_000,5'"),
        ("t;u\n0;1.000,5\n", 2, "'1.000,5'"),
        ("t,u\n0,\n", 2, "''"),
        ("t,u\n0,2\n1,true\n", 3, "'true'"),
    ],
)
def test_a_cell_that_is_no_number_is_refused_with_its_line(
    tmp_path: Path, text: str, line: int, cell: str
) -> None:
    with pytest.raises(ScenarioError) as refusal:
        read(tmp_path, text).numbers(0, 1)
    assert f"d.csv:{line}: expected a number in column" in str(refusal.value)
    assert f"got {cell}" in str(refusal.value)


@pytest.mark.parametrize("text", ["t,u\n13:50:40,1\n", "13:50:40.250,1\n", "t;u\n9:05;1\n"])
def test_a_clock_time_needs_a_date(tmp_path: Path, text: str) -> None:
    with pytest.raises(
        ScenarioError, match=r"got '\d+:.*'; seconds or a date before it: 2026-05-04T13:50:40"
    ):
        read(tmp_path, text).numbers(0)
    dated = text.replace("13:", "2026-05-04T13:").replace("9:05", "2026-05-04T09:05")
    assert read(tmp_path, dated).numbers(0).tolist() == [[0.0]]


@pytest.mark.parametrize("rows", ["2026-05-04T12:00:01\n5\n", "nan\n5\n2026-05-04T12:00:01\n"])
def test_a_date_among_numbers_is_refused(tmp_path: Path, rows: str) -> None:
    with pytest.raises(ScenarioError, match=r"d.csv:\d: expected a (date|number) in column 1, got '"):
        read(tmp_path, f"t\n{rows}").numbers(0, gaps=True)


def test_gaps_may_be_before_dates(tmp_path: Path) -> None:
    dates = read(tmp_path, "t\n-\n2026-05-04T12:00:01\n-\n2026-05-04T12:00:03.5\n").numbers(0, gaps=True)
    np.testing.assert_array_equal(dates[:, 0], [np.nan, 0.0, np.nan, 2.5])


def test_texts_stand_for_the_numbers_that_they_are_given(tmp_path: Path) -> None:
    file = read(tmp_path, "t,u\n0,auto\n1,off\n2,7\n3,OFF\n")
    assert file.numbers(1, names={"off": 1, "auto": 4})[:, 0].tolist() == [4.0, 1.0, 7.0, 1.0]
    with pytest.raises(
        ScenarioError, match=r"d.csv:2: expected a number or one of off, on in column 2, got 'auto'"
    ):
        file.numbers(1, names={"off": 1, "on": 4})


@pytest.mark.parametrize(
    ("title", "name", "unit"),
    [
        ("u [cm]", "u", "cm"), ("u (cm)", "u", "cm"), ("u[cm]", "u", "cm"), ("u[1] [V]", "u[1]", "V"),
        ("u[1][V]", "u[1]", "V"), ("u[1]", "u[1]", ""), ('"u[1,2]"', "u[1,2]", ""), ("der(x)", "der(x)", ""),
        ("u(cm)", "u", "cm"), ("[cm]", "", "cm"), ("u(1)", "u(1)", ""), ("a.der(h)", "a.der(h)", ""),
        ("u / cm", "u", "cm"), ("u / zoll", "u", "zoll"), ("u/cm", "u", "cm"), ("a/depth", "a/depth", ""),
        ("u / (m/s)", "u", "m/s"), ("u in cm", "u", "cm"), ("u in water", "u in water", ""),
    ],
)  # fmt: skip
def test_a_title_has_a_unit_in_brackets_that_are_no_index(
    tmp_path: Path, title: str, name: str, unit: str
) -> None:
    file = read(tmp_path, f"t,{title}\n0,1\n")
    assert (file.titles[1], file.units[1]) == (name, unit)


@pytest.mark.parametrize("unit", ["ms", "UTC"])
def test_dates_have_no_unit(tmp_path: Path, unit: str) -> None:
    file = read(tmp_path, f"t [{unit}],u\n2026-05-04T12:00:01,1\n")
    with pytest.raises(ScenarioError, match=f":1: t has dates in {unit}: expected a title without a unit"):
        file.times()


@pytest.mark.parametrize(
    ("text", "titles", "line"),
    [
        ("# t [ms],u [cm]\n0,1\n", ("t", "u"), 1),  # numpy.savetxt(header=...)
        ('# rig 3\n#"t [ms]","u [cm]"\n\n# by hand, in May, at noon\n0,1\n', ("t", "u"), 2),
        ("sep=;\nt [ms];u [cm]\n0;1\n", ("t", "u"), 2),  # as Excel writes it
        ("# a,b\nt [ms],u [cm]\n# c,d\n0,1\n", ("t", "u"), 2),
        ("# 0,0\n0,1\n", (), 2),
        ("# t [ms],u [cm]\n# 0,0\n0,1\n", ("t", "u"), 1),
        ("#\tt [ms]\tu [cm]\n0\t1\n", ("t", "u"), 1),
        ("# u [mm],t\n## t [ms],u [cm]\n# fresh water, calm\n0,1\n", ("t", "u"), 2),
    ],
)
def test_titles_may_be_a_comment_above_the_numbers(
    tmp_path: Path, text: str, titles: tuple[str, ...], line: int
) -> None:
    file = read(tmp_path, text)
    assert (file.titles, file.units) == (titles, ("ms", "cm")[: len(titles)])
    assert file.start.endswith(f"d.csv:{line}")
    assert file.numbers(0, 1).tolist() == [[0.0, 1.0]]


def test_a_title_may_have_microseconds(tmp_path: Path) -> None:
    file = read(tmp_path, "TimeUS [us],u\n91000000,1\n")
    assert file.conversion(0, "s")(file.numbers(0)[0, 0]) == pytest.approx(91.0)
