"""Result files as `l1-depth run` and `l1-depth sweep` write them, of runs that nobody had to wait for."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from fmus.files import write_json_atomically
from orchestration.results import files
from orchestration.results.metric_units import with_units
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from orchestration.sweep import table
from orchestration.sweep.plan import plan

SIGNALS = {"plant.depth": "m", "plant.reference": "m", "plant.force": "N", "plant.ratio": ""}
SCENARIO: dict[str, Any] = {
    "title": "A made-up dive",
    "components": {"plant": "Vehicle"},
    "parameters": {"plant.mass": 5.5},
    "experiment": {"stop_time": 10.0, "step_size": 0.1},
    "metrics": {
        "rmse": {
            "function": "rmse",
            "signal": "plant.depth",
            "reference": "plant.reference",
            "scale": 100.0,
            "unit": "cm",
        },
        "settling_time": {"function": "settling_time", "signal": "plant.depth"},
    },
}
UNITS = {"rmse": "cm", "settling_time": "s"}
PROVENANCE = {
    "fmus": {"plant": {"guid": "1f2e-3d4c", "model": "Vehicle", "tool": "made up"}},
    "algorithm": "jacobi",
    "communication_step_size_s": 0.1,
}


def recording(points: int = 101, step: float = 0.1, phase: float = 0.0, signals: int = 4) -> Recording:
    """Cosines, the first four named and with units as above."""
    names = [*SIGNALS, *(f"plant.extra[{i}]" for i in range(1, signals - 3))][:signals]
    time = np.arange(points) * step
    values = [(i + 1) * np.cos(0.5 * time + 0.3 * i + phase * (i != 1)) for i in range(len(names))]
    units = tuple(SIGNALS.get(name, "N") for name in names)
    return Recording(tuple(names), units, time, np.column_stack(values), PROVENANCE)


def write_run(
    folder: Path,
    name: str,
    run: Recording | None = None,
    measured: dict[str, float] | None = None,
    ending: str = "csv",
    **scenario_keys: Any,
) -> Path:
    """NAME.csv or .parquet and NAME.json, whose path is returned."""
    run = run or recording()
    document = {
        "recording": f"{name}.{ending}",
        "sha256": files.write(folder / f"{name}.{ending}", run),
        "scenario": {**SCENARIO, **scenario_keys},
        "run": run.provenance,
        "metrics": with_units({"rmse": 4.35, "settling_time": 43.7} if measured is None else measured, UNITS),
    }
    write_json_atomically(folder / f"{name}.json", document)
    return folder / f"{name}.json"


FAILED = {7: "plant at t = 3 s: fmi2DoStep returned discard", 11: "no step finished for 10 s"}


def write_sweep(folder: Path, samples: int = 100, name: str = "monte-carlo", shift: float = 0.0) -> Path:
    """The table of the shipped Monte Carlo: its own samples, with metrics that nobody has simulated.

    shift: of the RMSE
    """
    planned = plan(scenario.load(scenario.find("monte-carlo"), {"sweep": {"samples": samples}}))
    columns = table.schema(planned, None)
    rows = []
    for sample in range(samples):
        values = planned.values(sample)
        mass, lift = (float(values[name]) for name in ("plant.inertia", "plant.buoyancy_change"))
        metrics = {name: i + mass for i, name in enumerate(planned.scenario.metrics)}
        metrics["rmse"] = shift - mass
        metrics["holding_thrust"] = 1.2 + lift + 0.1 * math.sin(sample)
        error = FAILED.get(sample)
        rows.append({"sample": sample, **values, **({} if error else metrics), "error": error})
    path = folder / f"{name}.sweep.parquet"
    table.write((json.dumps(row).encode() for row in rows), columns, path)
    return path
