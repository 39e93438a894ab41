"""A vehicle fitted to logs of dives: parameters whose simulated depth is nearest to the measured depth.

The vehicle's FMU is driven by the measured commands. A residual is the simulated depth, without the sensor,
minus the measured one, where there is a reading; between two communication points the depth is a straight
line. The depth at the start is free in every dive, unless it is set.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import nearest
from fmus.fmi.description import has_start_value, start_value
from orchestration.errors import OrchestrationError
from orchestration.many.job import Failure, Job, Run
from orchestration.many.local_runs import LocalRuns
from orchestration.many.run_many import in_order, recordings_of
from orchestration.results import files
from orchestration.results.metric_units import with_units
from orchestration.results.recording import Recording
from orchestration.scenarios.changes import values_of_settings, with_values
from orchestration.scenarios.fmu_files import fmu_file
from orchestration.scenarios.free_parameter import FreeParameter, check_once, parse
from orchestration.scenarios.layers import Layer
from orchestration.studies.fit.dive import DATA, DEPTHS, UNIT_OF_TIMES, Dive
from orchestration.studies.fit.least_squares import (
    LEVEL,
    Analysis,
    LeastSquares,
    ParameterEstimate,
    Values,
    analysed,
    coordinate,
    values_at,
)
from orchestration.studies.vehicle import DEPTH, PREFIX, Vehicle
from orchestration.system.experiment import Experiment, suggested_times
from orchestration.system.system import System

# of the coordinates: about 1e-4 of a value between limits of seven decades
_DIFFERENCE = 1e-5
_EVALUATIONS = 100  # for each free parameter
_MOST_STEPS = 2e7  # of a dive: four days at 0.02 s
# of each dive, to which the search fits first: errors of the depth grow with time and cause local minima
_SHARES = (1 / 8, 1 / 4, 1 / 2)
_FEWEST, _ROUGHLY = 50, {"x_scale": "jac", "ftol": 1e-2, "max_nfev": 10}
_MEASURED, _RESIDUAL = f"{DATA}.{DEPTHS[0]}", f"{DATA}.residual"


@dataclass(frozen=True)
class VehicleFit:
    """A fit of a vehicle.

    recordings: of each dive at the times of its readings: simulated and measured depth, their difference and
    the commands; ended: why the search ended before it converged, or empty
    """

    vehicle: Vehicle
    dives: Sequence[Dive]
    analysis: Analysis
    recordings: Mapping[str, Recording]
    ended: str

    @property
    def of_vehicle(self) -> Iterator[tuple[str, ParameterEstimate]]:
        """Each fitted variable, "plant.NAME", with its estimate; without depths at the start of dives."""
        for estimate in self.analysis.estimates:
            if not estimate.free.name.startswith(f"{DATA}."):
                yield from ((PREFIX + name, estimate) for name in estimate.free.variables)

    @property
    def metrics(self) -> dict[str, dict[str, str]]:
        """The metric of a recording, as a scenario declares it."""
        return {"rmse": {"function": "rmse", "signal": self.vehicle.variable(DEPTH), "reference": _MEASURED}}

    @property
    def rmse(self) -> dict[str, float]:
        """Dive -> root mean square of the residuals [m]."""
        return {name: float(np.sqrt(np.mean(one[_RESIDUAL] ** 2))) for name, one in self.recordings.items()}

    def parameters(self) -> dict[str, Any]:
        """Returns the document of a parameter file: value, unit, interval and source of each variable."""
        readings = sum(len(dive.times) for dive in self.dives)
        source = f"fitted to {readings} readings of the depth in {', '.join(d.name for d in self.dives)}"
        return {
            "fit": {"rmse": {name: {"value": value, "unit": "m"} for name, value in self.rmse.items()}},
            "parameters": {
                name: {
                    "value": one.value,
                    "unit": one.free.unit,
                    "source": f"{source}{f'; {one.note}' if one.note else ''}",
                    **({} if one.note else {"interval": [one.low, one.high], "level": LEVEL}),
                }
                for name, one in self.of_vehicle
            },
        }

    def write(self, name: str, file: Path) -> list[Path]:
        """Writes the recording of a dive and, as `l1-depth run` does, its .json; returns both files."""
        recording, values = self.recordings[name], {"rmse": self.rmse[name]}
        units, title = {"rmse": "m"}, f"{self.vehicle.name} fitted to {name}"
        for variable, one in self.of_vehicle:
            values[variable], units[variable] = one.value, one.free.unit
        scenario = {**self.parameters(), "metrics": self.metrics, "title": title}
        digest, metrics = files.write(file, recording), with_units(values, units)
        return [file, files.write_document(file, digest, scenario, recording.provenance, metrics)]


def free_parameters(texts: Sequence[str], vehicle: Vehicle) -> list[FreeParameter]:
    """Returns the parameters of options --free NAME,NAME=LOW:HIGH.

    A name belongs to a parameter, an array (all its elements) or the description of the vehicle.
    The default limits are the limits of the FMU; the start is its start value, or a value that is set.
    Raises OrchestrationError for a name without a parameter of type Real, and for limits beyond its range.
    """
    result = [_of_vehicle(free, vehicle) for free in parse(texts)]
    check_once(result)
    if not result:
        raise OrchestrationError("nothing to fit: expected --free NAME,NAME")
    return result


def _of_vehicle(given: FreeParameter, vehicle: Vehicle) -> FreeParameter:
    name, variables = given.name.removeprefix(PREFIX), vehicle.variables
    described = {key: [x] if isinstance(x, str) else x for key, x in vehicle.described.variables if x}
    elements = [own for own in variables if own.partition("[")[0] == name and own != name]
    own = [name] if name in variables else elements or described.get(name) or []
    settable = {n: v for n, v in variables.items() if has_start_value(v) and v.type == "Real"}
    for one in own or [name]:
        if one not in settable:
            variable = variables.get(one)
            got = f", got {variable.causality} of type {variable.type}" if variable else ""
            raise OrchestrationError(
                f"--free {name}: expected a parameter of type Real{got}; {nearest(one, settable)}"
            )
    first = settable[own[0]]
    free = replace(given, name=name, variables=tuple(own)).within(first)
    start = float(_settings(vehicle)["parameters"].get(PREFIX + own[0], start_value(first)))
    return replace(free, start=free.limited(start))


def _settings(vehicle: Vehicle) -> dict[str, dict[str, Any]]:
    """Returns the parameters and constant inputs that are set, as the FMU takes them."""
    layers = [Layer({"components": {"plant": vehicle.fmu}})]
    tables = values_of_settings(vehicle.settings, layers, lambda fmu: vehicle.variables)
    return {"parameters": {}, "inputs": {}, **tables}


class _Runs:
    """The runs of a vehicle through some dives, by values of its free parameters.

    free: those given, and the depth at the start of each dive if it is not set
    make: makes the runs of a job
    """

    def __init__(
        self,
        vehicle: Vehicle,
        dives: Sequence[Dive],
        free: Sequence[FreeParameter],
        step_size: float | None,
        make: Callable[[Job, Sequence[Run]], Iterator[Any]],
    ) -> None:
        self.system, self.dives, self._make = System({"plant": fmu_file(vehicle.fmu)}), dives, make
        self.depth = vehicle.variable(DEPTH)
        settings = _settings(vehicle)
        step = suggested_times(self.system, 1.0, step_size)[1]
        if not 0.0 < step < math.inf:
            raise OrchestrationError(f"step size {step!r} s: expected a finite number, more than 0")
        for dive in dives:
            if (count := dive.times[-1] / step) > _MOST_STEPS:
                got = f"{dive.name}: {dive.times[-1]:.6g} s are {count:.3g} communication steps"
                raise OrchestrationError(f"{got}: expected at most {_MOST_STEPS:g}; {UNIT_OF_TIMES}")
        self._experiments = [
            Experiment(
                # a quotient that rounding lifts above an integer must not add a step
                stop_time=step * max(1, math.ceil(dive.times[-1] / step * (1.0 - 1e-12))),
                step_size=step,
                signals={PREFIX + name: signal for name, signal in dive.commands.items()},
                record=[self.depth],
                open_inputs="start",
                parameters=settings["parameters"],
                inputs={n: v for n, v in settings["inputs"].items() if n[len(PREFIX) :] not in dive.commands},
            )
            for dive in dives
        ]
        start_depth = vehicle.variable(vehicle.start_depth)
        own = start_depth.removeprefix(PREFIX)
        is_given = start_depth in settings["parameters"] or any(own in one.variables for one in free)
        self._at_starts = [
            FreeParameter(
                f"{DATA}.{own} of {dive.name}", start=float(dive.depths[0]), unit="m", variables=(own,)
            )
            for dive in dives
            if vehicle.has(vehicle.start_depth) and not is_given
        ]
        self.free, self._of_all = [*free, *self._at_starts], free

    def recorded(self, points: Sequence[Values]) -> list[list[Recording | Failure]]:
        """Returns for each point the recording of every dive."""
        runs = [
            Run(None, self._experiment(dive, point), recordings_of)
            for dive in range(len(self.dives))
            for point in points
        ]
        results = [done.result for done in self._make(Job(self.system, self._experiments[0]), runs)]
        return [results[i :: len(points)] for i in range(len(points))]

    def _experiment(self, dive: int, point: Values) -> Experiment:
        chosen = [*self._of_all, *self._at_starts[dive : dive + 1]]
        values = {PREFIX + own: point[one.name] for one in chosen for own in one.variables}
        return with_values(self._experiments[dive], values)

    def residuals(self, points: Sequence[Values]) -> Iterator[np.ndarray]:
        """Yields the simulated depth minus the measured one at each point, all dives in a row [m].

        OrchestrationError for values with which the vehicle cannot run.
        """
        for point, recordings in zip(points, self.recorded(points), strict=True):
            pairs = zip(self.dives, recordings, strict=True)
            yield np.concatenate([self.simulated(*pair, point) - pair[0].depths for pair in pairs])

    def simulated(self, dive: Dive, run: Recording | Failure, point: Values) -> np.ndarray:
        """Returns the simulated depth at the times of the readings, shape (n,)."""
        reason = run.reason if isinstance(run, Failure) else ""
        depth = np.empty(0) if isinstance(run, Failure) else np.interp(dive.times, run.time, run[self.depth])
        if reason or not np.isfinite(depth).all():
            values = ", ".join(f"{name} = {value:.4g}" for name, value in point.items())
            raise OrchestrationError(
                f"{dive.name}: no depth with {values}: {reason or 'not a number'}; "
                "give narrower limits by --free NAME=LOW:HIGH"
            )
        return depth

    def by_dive(self, residuals: np.ndarray) -> list[np.ndarray]:
        return np.split(residuals, np.cumsum([len(dive.times) for dive in self.dives])[:-1])


def fit_vehicle(
    vehicle: Vehicle,
    dives: Sequence[Dive],
    free: Sequence[FreeParameter],
    step_size: float | None = None,
    workers: int = 1,
    progress: Callable[[float], None] = lambda cost: None,
) -> VehicleFit:
    """Fits parameters of a vehicle to dives.

    step_size: communication step [s], by default the step of the FMU; progress: called after each evaluation
    Raises OrchestrationError for values with which the vehicle cannot run, and too few readings.
    """
    names = [dive.name for dive in dives]
    if twice := next((name for name in names if names.count(name) > 1), ""):
        raise OrchestrationError(f"two dives are called {twice}: expected files of different names")
    count = sum(len(dive.times) for dive in dives)
    most = _EVALUATIONS * (len(free) + len(dives))
    with LocalRuns(workers, expected=most * len(dives)) as local_runs:
        make = partial(in_order, local_runs)
        runs = _Runs(vehicle, dives, free, step_size, make)
        # the variance of the residuals, and so every interval, needs readings beyond the parameters
        if count <= len(runs.free):
            raise OrchestrationError(
                f"{count} readings: expected more than the {len(runs.free)} free parameters"
            )
        first = start = np.array([coordinate(one, one.start) for one in runs.free])
        for share in _SHARES:
            part = _Runs(vehicle, [_beginning(dive, share) for dive in dives], free, step_size, make)
            first = LeastSquares(part.free, part.residuals, _DIFFERENCE, most).run(first, **_ROUGHLY).best
        search = LeastSquares(runs.free, runs.residuals, _DIFFERENCE, most, progress)
        search.at([start, first])
        search.run(search.best, x_scale="jac")
        search.evaluations += 2 * len(runs.free)
        fits = zip(dives, runs.by_dive(search.residuals), strict=True)
        rates = [np.gradient(dive.depths + part, dive.times) for dive, part in fits]
        analysis = analysed(search, runs.by_dive, np.concatenate(rates))
        runs_at_best = runs.recorded([values_at(runs.free, search.best)])[0]
    parts = zip(dives, runs.by_dive(search.residuals), runs_at_best, strict=True)
    recordings = {part[0].name: _recording(runs.depth, *part) for part in parts}
    return VehicleFit(vehicle, dives, analysis, recordings, search.ended)


def _beginning(dive: Dive, share: float) -> Dive:
    """Returns a share of the readings of a dive, the first ones, at least `_FEWEST` of them."""
    count = max(_FEWEST, math.ceil(share * len(dive.times)))
    return replace(dive, times=dive.times[:count], depths=dive.depths[:count])


def _recording(depth: str, dive: Dive, residuals: np.ndarray, run: Recording | Failure) -> Recording:
    """Returns the simulated and the measured depth, their difference and the commands, at the readings."""
    commands = {PREFIX + name: signal.at(dive.times) for name, signal in dive.commands.items()}
    columns = {depth: dive.depths + residuals, _MEASURED: dive.depths, _RESIDUAL: residuals, **commands}
    units = ("m", "m", "m", *(dive.units[name] for name in dive.commands))
    provenance = {} if isinstance(run, Failure) else run.provenance
    return Recording(tuple(columns), units, dive.times, np.column_stack([*columns.values()]), provenance)
