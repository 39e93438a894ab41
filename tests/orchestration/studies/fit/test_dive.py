"""Logs of dives as other programs write them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestration.errors import OrchestrationError
from orchestration.studies.fit.dive import Dive, held_over, read_dive
from orchestration.studies.vehicle import Vehicle

PLAIN = """\
time [s],measured_depth [m],voltage[1],voltage[2]
10.0,1.5,2.5,3.0
10.1,1.6,2.5,3.0
10.25,1.75,-1.0,3.0
"""
IN_MS = (
    PLAIN.replace("[s]", "[ms]").replace("10.25", "10250").replace("10.1", "10100").replace("10.0", "10000")
)
GERMAN = """\
# Tauchgang 7
Zeit;Tiefe (cm);U vorn [V];U hinten [mV];Bemerkung
2026-05-04T12:00:00,00;150,0;2,5;3000;los
2026-05-04T12:00:00,10;160,0;2,5;3000;

2026-05-04T12:00:00,25;175,0;-1,0;3000;
"""
MAPPING = {"time": "Zeit", "measured_depth": "Tiefe", "voltage[1]": "U vorn", "voltage[2]": "U hinten"}
Read = Callable[..., Dive]


@pytest.fixture
def read(tmp_path: Path, vehicle: Vehicle) -> Read:
    def written(text: str, mapping: dict[str, str] | None = None, of: Vehicle = vehicle) -> Dive:
        path = tmp_path / "dive.csv"
        path.write_text(text, encoding="utf-8-sig")
        return read_dive(path, of, mapping)

    return written


@pytest.mark.parametrize(
    ("text", "mapping"),
    [
        (PLAIN, None),
        (PLAIN.replace(",", "\t"), None),
        (PLAIN.replace("voltage", "plant.voltage").replace("measured_depth", "plant.depth"), None),
        (IN_MS, None),
        (GERMAN, MAPPING),
    ],
)
def test_a_log_is_the_same_dive_however_it_is_written(
    read: Read, text: str, mapping: dict[str, str] | None
) -> None:
    dive = read(text, mapping)
    assert dive.times == pytest.approx([0.0, 0.1, 0.25])
    assert dive.depths == pytest.approx([1.5, 1.6, 1.75])
    assert dive.commands.keys() == {"voltage[1]", "voltage[2]"}
    assert dive.commands["voltage[1]"].at(np.array([0.0, 0.2, 0.3])) == pytest.approx([2.5, 2.5, -1.0])
    assert dive.commands["voltage[2]"].at(np.array([0.3])) == pytest.approx([3.0])


GAPS = """\
time,measured_depth,voltage[1],voltage[2],current_velocity
0,1.0,,,0.1
1,1.1,2,2,
1.5,,2,2,
2,nan,3,,0.2
4,1.4,3,3,
5,1.5,,,
"""


def test_gaps_have_no_reading_and_hold_the_commands(read: Read) -> None:
    """From the first to the last row in which all commands are known, at 1 s and 4 s of the log."""
    dive = read(GAPS)
    assert dive.times.tolist() == [0.0, 3.0]
    assert dive.depths.tolist() == [1.1, 1.4]
    times = np.array([0.0, 0.9, 1.0, 2.9, 3.0])
    assert dive.commands["voltage[1]"].at(times).tolist() == [2.0, 2.0, 3.0, 3.0, 3.0]
    assert dive.commands["voltage[2]"].at(times).tolist() == [2.0, 2.0, 2.0, 2.0, 3.0]
    assert dive.commands["current_velocity"].at(times).tolist() == [0.1, 0.1, 0.2, 0.2, 0.2]


def test_a_long_gap_in_the_commands_is_told(read: Read) -> None:
    text = "time,depth,voltage[1],voltage[2]\n0,1,0,0\n0.5,1,1,1\n3,2,1,1\n3.5,2,,\n4,2,1,1\n"
    assert [*held_over(read(text))] == [
        "dive: no commands from 0.5 s to 3 s: they are held; if they changed, make it two files"
    ]


def test_many_gaps_are_one_line_with_their_count(read: Read) -> None:
    rows = "".join(f"{t},{t}.5,1,1\n" for t in (0, 1, 2, 5, 7, 20, 30))
    assert [*held_over(read(f"time,depth,voltage[1],voltage[2]\n{rows}"))] == [
        "dive: no commands from 7 s to 20 s, the longest of 4 gaps: they are held; if they changed, "
        "make it two files"
    ]


def test_rows_far_apart_may_have_another_unit_and_its_title_cures_it(read: Read) -> None:
    text = "TimeUS,depth,voltage[1],voltage[2]\n91000000,1,1,1\n91100000,2,1,1\n91200000,2.5,1,1\n"
    (message,) = held_over(read(text, {"time": "TimeUS"}))
    assert message.endswith("if the times are not in s, their title needs the unit, as in time [us]")
    cured = read(text.replace("TimeUS", "TimeUS [us]"), {"time": "TimeUS"})
    assert cured.times == pytest.approx([0.0, 0.1, 0.2])
    assert [*held_over(cured)] == []


def test_two_rows_of_one_time_are_a_jump_of_the_commands(read: Read) -> None:
    """The depth is the same or missing in one of them; the reading counts once."""
    rows = "0,1.0,2,3\n0.5,1.1,2,3\n0.5,1.1,-4,3\n0.5,,-5,3\n1,1.4,-5,3\n"
    dive = read(f"time,depth,voltage[1],voltage[2]\n{rows}")
    assert (dive.times.tolist(), dive.depths.tolist()) == ([0.0, 0.5, 1.0], [1.0, 1.1, 1.4])
    assert dive.commands["voltage[1]"].at(np.array([0.4, 0.5, 0.6])).tolist() == [2.0, -5.0, -5.0]


def test_a_command_that_is_set_needs_no_column(read: Read, vehicle: Vehicle) -> None:
    given = replace(vehicle, settings={"plant.voltage[2]": 0.0})
    text = "time,depth,voltage[1]\n0,1,0\n1,1.2,1\n"
    assert read(text, of=given).commands.keys() == {"voltage[1]"}


def test_the_variable_that_stands_for_another_names_its_column_too(read: Read, vehicle: Vehicle) -> None:
    mapped = replace(vehicle, mapping={"current_velocity": "external_force"})
    text = PLAIN.replace("voltage[2]\n", "voltage[2],current_velocity\n").replace("3.0\n", "3.0,0.5\n")
    assert read(text, of=mapped).commands.keys() == {"voltage[1]", "voltage[2]", "external_force"}


@pytest.mark.parametrize(
    ("old", "new", "mapping", "message"),
    [
        (
            "time [s]",
            "zeit",
            {},
            "dive.csv:1: no column time: name it by --map data.time=COLUMN; its columns are zeit",
        ),
        ("voltage[2]", "u", {}, r"no column voltage\[2\]: name it by --map data.voltage\[2\]=COLUMN"),
        ("", "", {"measured_depth": "measured_dept"}, "dive.csv:1: no column 'measured_dept'; nearest is"),
        ("", "", {"voltag": "time"}, r"--map data.voltag=time: .*voltage\["),
        (
            "[m]",
            "[ft]",
            {},
            "measured_depth: unknown unit 'ft': expected m or a unit of its dimension; nearest is 't'",
        ),
        (
            "10.1,",
            "10.0,",
            {},
            "dive.csv:3: repeated time 10 s with another depth, 1.6 m after 1.5 m: expected one",
        ),
        ("10.25,", "9,", {}, "dive.csv:4: earlier time 9 s after 10.1 s: expected ascending"),
        ("1.6,", "deep,", {}, "dive.csv:3: expected a number in column 2, got 'deep'"),
        ("10.1,", ",", {}, "dive.csv:3: expected a number in column 1, got ''"),
        ("1.6,", "1.6,1.7,", {}, "dive.csv:3: 5 cells: expected 4"),
        (",voltage[1],", ",voltage[2],", {}, r"dive.csv:1: two columns 'voltage\[2\]'"),
        ("10.1,", "13:50:40,", {}, "dive.csv:3: .*got '13:50:40'; seconds or a date"),
    ],
)
def test_a_mistake_is_named_with_its_line(
    read: Read, old: str, new: str, mapping: dict[str, str], message: str
) -> None:
    with pytest.raises(OrchestrationError, match=message):
        read(PLAIN.replace(old, new, 1), mapping)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (PLAIN.partition("\n")[2], "dive.csv:1: expected a first line of titles, got numbers"),
        ("time,depth,voltage[1],voltage[2]\n0,1,,\n1,,2,2\n2,1,,\n", "no overlap: expected readings"),
        ("time,depth,voltage[1],voltage[2]\n0,1,,\n1,1,,\n", "no overlap"),
        ("time,depth,voltage[1],voltage[2]\n0,1,1,1\n1,1,2,2\n", "does not move: all 2 readings are 1 m"),
        (
            "time,z,voltage[1],voltage[2]\n0,0.1,1,1\n1,-1,2,2\n2,-3,2,2\n".replace("z", "depth"),
            "the depth is -1.3 m in the mean: .*if depth is negative under water, change the sign",
        ),
    ],
)
def test_data_that_say_nothing_of_the_vehicle_are_refused(read: Read, text: str, message: str) -> None:
    with pytest.raises(OrchestrationError, match=message):
        read(text)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("dives.csv", "dives.csv: expected a CSV file, got no file; nearest is 'dive.csv'"),
        ("logs", "logs: expected a CSV file, got a folder; known: 'one.csv'"),
        ("none/dive.csv", "none/dive.csv: expected a CSV file, got no file; no other is there"),
    ],
)
def test_a_missing_file_names_those_that_are_there(
    tmp_path: Path, vehicle: Vehicle, name: str, message: str
) -> None:
    (tmp_path / "logs").mkdir()
    for file in ("dive.csv", "logs/one.csv"):
        (tmp_path / file).touch()
    with pytest.raises(OrchestrationError) as caught:
        read_dive(tmp_path / name, vehicle)
    assert str(caught.value).replace("\\", "/") == f"{tmp_path.as_posix()}/{message}"
