"""Logs of dives: commands over time, as signals for a vehicle, and readings of the depth to compare with."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from fmus.errors import nearest
from orchestration.errors import OrchestrationError
from orchestration.scenarios.data_file import DataFile, read_data_file
from orchestration.studies.vehicle import PREFIX, Vehicle
from orchestration.system.signals import Table

DATA = "data"  # before the name of a column, as a component
TIME, DEPTHS = "time", ("measured_depth", "depth")
UNIT_OF_TIMES = "if the times are not in s, their title needs the unit, as in time [us]"
LONG_GAP = 1.0  # s; the shortest gap in the commands that causes a message


@dataclass(frozen=True)
class Dive:
    """A dive: from the first row in which all commands are known to the last one.

    commands: input of the vehicle -> its values, each held until the next, from 0 s
    units: of the commands; times, depths: of the readings, shape (n,) [s] and [m]
    gaps: (start, end) of those in the commands that are longer than `LONG_GAP` [s]
    """

    name: str
    commands: Mapping[str, Table]
    units: Mapping[str, str]
    times: np.ndarray
    depths: np.ndarray
    gaps: tuple[tuple[float, float], ...] = ()


def read_dive(path: Path, vehicle: Vehicle, mapping: Mapping[str, str] | None = None) -> Dive:
    """Reads the log of a dive.

    mapping: time, measured_depth or an input of the vehicle -> title of its column; by default the same name,
    or that after "plant."
    Raises OrchestrationError for a column that is missing or has another unit, times that do not ascend, two
    depths at one time, a depth that is negative under water, and readings that say nothing of the vehicle.
    """
    file, mapping = read_data_file(path), mapping or {}
    columns = _columns(file, vehicle, mapping)
    units = [_unit(name, vehicle) for name in columns]
    indices = [file.titles.index(title) for title in columns.values()]
    own = next(iter(vehicle.variables.values())).units
    times = file.times(indices[0])
    changes = [file.conversion(i, unit, own) for i, unit in zip(indices[1:], units[1:], strict=True)]
    read = file.numbers(*indices[1:], gaps=True).T
    depths, *commands = (change(column) for change, column in zip(changes, read, strict=True))
    known = np.isfinite(commands)
    starts = [int(np.argmax(row)) if row.any() else len(row) for row in known]
    ends = [int(np.flatnonzero(row)[-1]) if row.any() else -1 for row in known]
    # without a command in the log all are set, and known at all times
    first, last = max(starts, default=0), max(ends, default=len(times) - 1)
    readings = np.flatnonzero(np.isfinite(depths))
    readings = readings[(readings >= first) & (readings <= last)]
    if not len(readings):
        raise OrchestrationError(
            f"{path}: no overlap: expected readings of the depth while commands are known"
        )
    _check_depths(file, columns[DEPTHS[0]], readings, times[readings], depths[readings])
    readings = readings[np.diff(times[readings], append=np.inf) > 0.0]
    times = times - times[first]
    signals: dict[str, Table] = {}
    for name, values, row in zip(list(columns)[2:], commands, known, strict=True):
        latest = np.maximum.accumulate(np.where(row, np.arange(len(row)), 0))
        signals[name] = Table(times[first:], values[latest][first:], hold=True)
    commanded = times[known.all(axis=0) & (times >= 0.0)].tolist()
    gaps = tuple((a, b) for a, b in pairwise(commanded) if b - a > LONG_GAP)
    own_units = dict(zip(columns, units, strict=True))
    return Dive(path.stem, signals, own_units, times[readings], depths[readings], gaps)


def _columns(file: DataFile, vehicle: Vehicle, mapping: Mapping[str, str]) -> dict[str, str]:
    """Returns time, depth, and each input of the vehicle that has a column -> its title."""
    if not file.titles:
        raise OrchestrationError(f"{file.start}: expected a first line of titles, got numbers")
    inputs = {name: v for name, v in vehicle.variables.items() if v.causality == "input"}
    known = [TIME, *DEPTHS, *inputs, *vehicle.mapping]
    for name, title in mapping.items():
        if name not in known:
            raise OrchestrationError(f"--map {DATA}.{name}={title}: {nearest(name, known)}")
        file.index(title)

    def column(*names: str) -> str:
        own = [mapping[name] for name in names if name in mapping]
        titles = [prefix + name for name in names for prefix in ("", PREFIX) if prefix + name in file.titles]
        return next(iter([*own, *titles]), "")

    # a name of the interface that stands for another variable is not the variable of that name
    names = {name: [name] for name in inputs.keys() - vehicle.mapping.keys()}
    for name, own in vehicle.mapping.items():
        names.setdefault(own, []).append(name)
    columns = {TIME: column(TIME), DEPTHS[0]: column(*DEPTHS)}
    columns |= {name: column(*names.get(name, [])) for name in inputs}
    commands = [vehicle.variable(name) for name in vehicle.inputs]
    needed = [TIME, DEPTHS[0], *(n.removeprefix(PREFIX) for n in commands if n not in vehicle.settings)]
    for name in needed:
        if not columns[name]:
            raise OrchestrationError(
                f"{file.start}: no column {name}: name it by --map {DATA}.{name}=COLUMN; "
                f"its columns are {', '.join(file.titles)}"
            )
    return {name: column for name, column in columns.items() if column}


def _unit(name: str, vehicle: Vehicle) -> str:
    return {TIME: "s", DEPTHS[0]: "m"}.get(name) or vehicle.variables[name].unit or ""


def _check_depths(
    file: DataFile, title: str, rows: np.ndarray, times: np.ndarray, depths: np.ndarray
) -> None:
    """Refuses a depth that does not change, two at one time, and a height in the place of the depth."""
    if np.ptp(depths) == 0.0:
        raise OrchestrationError(
            f"{file.path}: the vehicle does not move: all {len(depths)} readings are {depths[0]:g} m"
        )
    for i in np.flatnonzero((np.diff(times) == 0.0) & (np.diff(depths) != 0.0))[:1]:
        raise OrchestrationError(
            f"{file.path}:{file.rows[rows[i + 1]][0]}: repeated time {times[i]:.9g} s with another depth, "
            f"{depths[i + 1]:g} m after {depths[i]:g} m: expected one; of two sensors, keep the rows of one"
        )
    if depths.mean() < 0.0:
        raise OrchestrationError(
            f"{file.path}: the depth is {depths.mean():.3g} m in the mean: expected it positive below the "
            f"surface; if {title} is negative under water, change the sign of its numbers"
        )


def held_over(dive: Dive) -> Iterator[str]:
    """Yields a message about the gaps in the commands of a dive, if it has any."""
    if dive.gaps:
        start, end = max(dive.gaps, key=lambda gap: gap[1] - gap[0])
        longest = f", the longest of {len(dive.gaps)} gaps" if len(dive.gaps) > 1 else ""
        # seconds are wrong where all rows are far apart
        is_doubtful = bool((np.diff(dive.times) > LONG_GAP).all())
        unit = f"; {UNIT_OF_TIMES}" * is_doubtful
        held = f"they are held; if they changed, make it two files{unit}"
        yield f"{dive.name}: no commands from {start:.6g} s to {end:.6g} s{longest}: {held}"
