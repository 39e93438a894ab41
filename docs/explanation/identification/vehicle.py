"""The paper's eight figures, the numbers that it leaves open, and runs of the shipped FMUs.

Source: Maalouf, Chemori and Creuze (NOLCOS 2013), Tables 1 and 2.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orchestration import Ensemble, Experiment, evaluate, load_scenario

Columns = dict[str, np.ndarray]
"""Name -> value of every run, shape (runs,)."""
Figure = tuple[str, str]
"""(scenario, metric)"""

VALUES: dict[Figure, float] = {
    ("nominal-l1", "settling_time"): 65.0,
    ("nominal-extended", "settling_time"): 45.0,
    ("nominal-l1", "rmse"): 12.1,
    ("nominal-extended", "rmse"): 4.35,
    ("buoyancy-l1", "settling_time"): 68.0,
    ("buoyancy-extended", "settling_time"): 45.0,
    ("buoyancy-l1", "rmse"): 13.8,
    ("buoyancy-extended", "rmse"): 4.86,
}
"""The eight figures, in s and cm."""
SCENARIOS = tuple(dict.fromkeys(name for name, _ in VALUES))
SEEDS = (1, 2, 3, 4, 5)
LARGEST_OVERSHOOT_PCT = 1.0  # "no significant overshoot", section 5.2
HOLD = (100.0, 140.0)  # s, at 0.8 m


def half_a_digit(figure: Figure) -> float:
    """Returns what rounding to the printed digits can hide: of 65 s, 0.5 s."""
    name, metric = figure
    return 0.5 if metric == "settling_time" else 0.05 if name.endswith("-l1") else 0.005


@dataclass(frozen=True)
class Free:
    """A number that the paper leaves open, and its range, even in the logarithm or in the value."""

    name: str
    unit: str
    low: float
    high: float
    logarithmic: bool = True

    def value(self, share: Any) -> Any:
        """Returns the quantile of a share, 0..1, or of an array of them."""
        if self.logarithmic:
            return self.low * (self.high / self.low) ** share
        return self.low + (self.high - self.low) * share

    def position(self, value: Any) -> Any:
        """Returns the share of which a value is the quantile."""
        if self.logarithmic:
            return np.log(value / self.low) / np.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


FREQUENCY = "adaptation_frequency"
CHANGE = "plant.buoyancy_change"
K_Z, K_P, K_I = (f"controller.{name}_gain" for name in ("depth_feedback", "proportional", "integral"))
FREE = (
    # 3 kg and the added mass of a box
    Free("plant.inertia", "kg", 5.0, 7.0, logarithmic=False),
    Free("plant.linear_damping", "N.s/m", 1.0, 10.0),
    # 0.5 rho C_d A
    Free("plant.quadratic_damping", "N.s2/m2", 5.0, 20.0),
    # published: -1.2 and +0.2
    Free("plant.net_weight", "N", -1.25, -1.15, logarithmic=False),
    Free(CHANGE, "N", 0.15, 0.25, logarithmic=False),
    Free(K_Z, "N/m", 0.05, 20.0),
    # A_m below 6 rad/s
    Free("controller.rate_feedback_gain", "N.s/m", 0.5, 30.0),
    Free("controller.filter_bandwidth", "rad/s", 0.05, 2.0),
    # of the adaptation loop at phi = 0
    Free(FREQUENCY, "rad/s", 0.1, 6.0),
    Free("controller.sigma_bound", "N", 0.3, 10.0),
    Free("controller.theta_bound[1]", "N", 0.3, 10.0),
    Free(K_P, "N/m", 0.05, 50.0),
    Free(K_I, "N/(m.s)", 1e-4, 0.1),
)
BY_NAME = {free.name: free for free in FREE}
MODEL_INERTIA, MODEL_DAMPING = 5.5, 2.5  # kg, N.s/m: of the controller's design


def variables(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what the FMUs are given: the adaptation gain in place of its frequency at phi = 0.

    Gamma = frequency^2 / (B_m' P B_m), A_m' P + P A_m = -I
    """
    given = {name: value for name, value in values.items() if name != FREQUENCY}
    if FREQUENCY in values:
        c_1 = values[K_Z] / MODEL_INERTIA
        c_2 = (MODEL_DAMPING + values["controller.rate_feedback_gain"]) / MODEL_INERTIA
        b_p_b = 0.5 * (1.0 + 1.0 / c_1) / c_2 / MODEL_INERTIA**2
        given["controller.adaptation_gain"] = values[FREQUENCY] ** 2 / b_p_b
    return given


class Vehicle:
    """The shipped FMUs in the task of a scenario, many runs at once; a context manager.

    noise: whether the sensor has noise and resolution; runs: how many there were
    windows: of time [s], name -> begin, end: the figures have the mean error of depth in it [mm]
    """

    def __init__(
        self,
        task: str = "nominal-extended",
        noise: bool = True,
        windows: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        loaded = load_scenario(task)
        exact = {} if noise else {"plant.sensor_noise": 0.0, "plant.sensor_resolution": 0.0}
        self._experiment = replace(
            loaded.experiment,
            record=("plant.depth", "controller.depth_reference"),
            parameters={**loaded.experiment.parameters, **exact},
        )
        self._metrics = {name: loaded.metrics[name] for name in ("settling_time", "rmse", "overshoot")}
        self._ensemble = Ensemble(loaded.system)
        self._windows = dict(windows or {})
        self.runs = 0

    def __enter__(self) -> "Vehicle":
        return self

    def __exit__(self, *error: object) -> None:
        self._ensemble.close()

    def figures(self, names: str | list[str], values: Mapping[str, Any]) -> Columns:
        """Returns settling time [s], RMSE [cm], overshoot [%] and spread of depth in hold [mm] of every run.

        names: scenario of each run, or of all; values: variable -> value of each run, or of all
        A run that does not settle has not a number there; one that fails has it everywhere.
        """
        given = variables(values)
        count = max(1 if isinstance(names, str) else len(names), *map(np.size, given.values()), 1)
        scenarios = [names] * count if isinstance(names, str) else names
        added = np.array([name.startswith("buoyancy") for name in scenarios])
        given = {name: np.broadcast_to(value, count) for name, value in given.items()}
        given[CHANGE] = np.where(added, given.get(CHANGE, 0.2), 0.0)
        given["controller.augmentation"] = np.array(
            ["none" if n.endswith("-l1") else "pi" for n in scenarios]
        )
        self.runs += count
        parts = [
            self._part({name: column[begin : begin + 512].tolist() for name, column in given.items()})
            for begin in range(0, count, 512)
        ]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _part(self, columns: dict[str, list[Any]]) -> Columns:
        runs = [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
        result = self._ensemble.run([self._with(values) for values in runs])
        figures = {name: np.full(len(result.counts), np.nan) for name in (*self._metrics, "hold_spread")}
        for name, column in evaluate(result.recordings(), self._metrics).items():
            figures[name][result.complete] = column
        held = (result.time >= HOLD[0]) & (result.time <= HOLD[1])
        figures["hold_spread"] = 1e3 * np.std(result["plant.depth"][:, held], axis=1)
        for name, (begin, end) in self._windows.items():
            within = (result.time >= begin) & (result.time <= end)
            error = result["plant.depth"][:, within] - result["controller.depth_reference"][..., within]
            figures[name] = 1e3 * np.mean(error, axis=-1)
        return figures

    def _with(self, values: Mapping[str, Any]) -> Experiment:
        """Returns the experiment with these values of parameters and constant inputs."""
        given = self._experiment
        inputs = {name: values.get(name, value) for name, value in given.inputs.items()}
        parameters = {name: value for name, value in values.items() if name not in inputs}
        return replace(given, parameters={**given.parameters, **parameters}, inputs=inputs)

    def of_all_seeds(self, values: Mapping[str, float], seeds: tuple[int, ...] = SEEDS) -> Columns:
        """Returns the figures of all four scenarios by "SCENARIO METRIC", a value for each seed."""
        names = [name for name in SCENARIOS for _ in seeds]
        measured = self.figures(names, {**values, "plant.sensor_seed": [*seeds] * len(SCENARIOS)})
        return {
            f"{name} {metric}": column.reshape(len(SCENARIOS), -1)[i]
            for i, name in enumerate(SCENARIOS)
            for metric, column in measured.items()
        }
