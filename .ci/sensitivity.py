"""Which guessed number of a vehicle moves the ranking of the controllers, for docs/explanation/comparison.md.

    l1-depth build --cache
    python .ci/sensitivity.py docs/explanation/sensitivity.json

Every controller of the protocol, tuned, runs the nominal case on vehicles whose guessed numbers are drawn:
from the distributions of the vehicle's description (orchestration/scenarios/vehicles/), and the thrusters'
additional lag evenly up to 0.1 s, the delay margin that the gains were tuned to. On each vehicle the
controllers are ranked by RMSE, those that failed behind the others. The index of a number is its total Sobol'
index, over all ranks together: the share of their variance that is left when everything but this number is
known, summed over the controllers (Gamboa, Janon, Klein and Lagnoux 2014, Electronic Journal of Statistics
8:575, generalise the first-order index so).
"""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata, sobol_indices

from fmus.operating_system import usable_processors
from orchestration.many.job import Failure
from orchestration.many.local_runs import LocalRuns
from orchestration.many.run_many import in_order
from orchestration.studies.score.closed_loop import ClosedLoop, ClosedLoopRun, tuned
from orchestration.studies.score.protocol import Case, Protocol, read_protocol
from orchestration.studies.score.run_metrics import declared, failures, metrics_of
from orchestration.studies.vehicle import Vehicle
from orchestration.sweep.distributions import Distribution, uniform

VEHICLES = ("RovDepthPlant", "RovHeavePitchPlant", "BlueRov2Plant")
SAMPLES = 64  # a power of 2, of each of the two sets of vehicles that Saltelli's method mixes
REPETITIONS = 3  # with other samples; their spread is that of the indices
_ERROR = "rmse"
_LARGEST_LAG_S = 0.1


class Law:
    """The distribution of a number as SciPy asks for it."""

    def __init__(self, distribution: Distribution) -> None:
        self.distribution = distribution

    def ppf(self, uniforms: np.ndarray) -> np.ndarray:
        """Returns the values of uniform numbers."""
        return np.reshape(self.distribution.quantile(np.ravel(uniforms).tolist()), np.shape(uniforms))


def guessed(protocol: Protocol) -> dict[str, tuple[list[str], Law]]:
    """Returns name -> variables and distribution of the numbers that no source gives."""
    numbers = {
        name: (list(entry.variables), Law(protocol.law(name)))
        for name, entry in protocol.vary.items()
        if name != "sensor_seed"
    }
    lags = protocol.vehicle.described.disturbances["thruster-lag"].parameters
    numbers["thruster_lag"] = (list(lags), Law(uniform(0.0, _LARGEST_LAG_S)))
    return numbers


def errors(protocol: Protocol, cases: list[Case]) -> np.ndarray:
    """Returns the RMSE [cm] of each controller of the protocol in each case, infinite where it failed."""
    names = (_ERROR, "settling_time", *protocol.tables.failure)
    compute = [partial(metrics_of, metrics=declared(case, protocol, names)) for case in cases]
    runs = [ClosedLoopRun(*pair) for pair in zip(cases, compute, strict=True)]
    with LocalRuns(usable_processors()) as local:
        loops = (
            ClosedLoop(tuned(protocol, name), protocol, partial(in_order, local))
            for name in protocol.controllers
        )
        return np.array([[_error(result, protocol) for result in loop.results(runs)] for loop in loops])


def _error(result: Mapping[str, float] | Failure, protocol: Protocol) -> float:
    if isinstance(result, Failure) or failures(result, protocol):
        return math.inf
    return result[_ERROR]


def indices(protocol: Protocol, samples: int = SAMPLES, repetitions: int = REPETITIONS) -> dict[str, Any]:
    """Returns the index of each number, and how the controllers rank on all the vehicles that were drawn.

    In the index, controllers that fail on one vehicle share the mean of their ranks; first: the share of the
    vehicles on which a controller did not fail and none has a smaller error.
    """
    numbers, drawn_errors = guessed(protocol), list[np.ndarray]()
    laws = [law for _, law in numbers.values()]

    def ranks(drawn: np.ndarray) -> np.ndarray:
        cases = [_case(protocol, numbers, vehicle) for vehicle in drawn.T]
        drawn_errors.append(errors(protocol, cases))
        return rankdata(drawn_errors[-1], axis=0)

    shares = list[np.ndarray]()
    for seed in range(repetitions):
        before = len(drawn_errors)
        total: Any = sobol_indices(func=ranks, n=samples, dists=laws, rng=np.random.default_rng(seed))
        variance = rankdata(np.hstack(drawn_errors[before : before + 2]), axis=0).var(axis=1)
        shares.append(variance @ np.nan_to_num(total.total_order) / variance.sum())
        print(f"{protocol.vehicle.name}: {seed + 1} of {repetitions}", flush=True)
    every = np.hstack(drawn_errors)
    quantiles = np.quantile(rankdata(every, axis=0), (0.5, 0.05, 0.95), axis=1).T.tolist()
    first = (np.isfinite(every) & (every == every.min(axis=0))).mean(axis=1)
    return {
        "vehicles": every.shape[1],
        "all_failed": float(np.isinf(every).all(axis=0).mean()),
        "indices": {
            name: {"mean": column.mean(), "low": column.min(), "high": column.max()}
            for name, column in zip(numbers, np.array(shares).T, strict=True)
        },
        "ranks": {
            name: dict(zip(("median", "p5", "p95", "first"), (*row, share), strict=True))
            for name, row, share in zip(protocol.controllers, quantiles, first.tolist(), strict=True)
        },
    }


def _case(protocol: Protocol, numbers: Mapping[str, tuple[list[str], Law]], vehicle: np.ndarray) -> Case:
    """Returns the nominal case on a vehicle with these numbers."""
    given = dict(protocol.nominal.values)
    for (variables, _), value in zip(numbers.values(), vehicle.tolist(), strict=True):
        given |= dict.fromkeys(variables, value)
    return replace(protocol.nominal, values=given)


def study(path: Path, vehicles: Sequence[str] = VEHICLES) -> None:
    """Writes the indices of each vehicle to a file."""
    protocols = {name: read_protocol(vehicle=Vehicle.of(name)) for name in vehicles}
    document = {name: indices(protocol) for name, protocol in protocols.items()}
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    study(Path(sys.argv[1]), sys.argv[2:] or VEHICLES)
