"""The gains of a design with the reason of each, their check by runs, and the parameter file that holds them.

The runs are every corner of the ranges, draws within them, and the start values.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import tomli_w

from fmus.files import write_text_atomically
from fmus.fmi.variable_types import FmiValue
from orchestration.many.job import Failure
from orchestration.many.run_many import run_many
from orchestration.results.metrics import evaluate
from orchestration.results.recording import Recording
from orchestration.scenarios.changes import with_values
from orchestration.scenarios.scenario import Scenario
from orchestration.studies.design import rules
from orchestration.studies.design.rules import Conditions, Gain, L1Design, PidDesign, beta_of
from orchestration.studies.design.vehicle_data import Range, VehicleData

TABLE = "thruster_table_"
"""Beginning of the names of a table's points."""
_UNITS = {
    "thruster_gain": "N/V",
    "thruster_tabulated": "1",
    "thruster_scale": "1",
    "thruster_table_voltage": "V",
    "thruster_table_force": "N",
    "voltage_limit": "V",
}
_DIGITS = 4  # also of the values that are run: the checked gains are the written ones


def l1_gains(design: L1Design, data: VehicleData, conditions: Conditions) -> list[Gain]:
    """Returns the parameters of L1DepthController, for the paper's law and for its PI extension."""
    w_m, (k_1, k_2), (k_p, k_i) = design.bandwidth, design.state_feedback, design.extension
    q_1, q_2 = design.lyapunov_weight
    ratio = design.inertia / data.inertia[0]
    left = f"{design.phase:.3g} deg or {1e3 * design.delay:.0f} ms are left in the worst corner"
    bound = rules.SIGMA * ratio * data.largest_weight
    return [
        *_model(data, design.inertia, design.damping),
        *_observer(design.alpha, data, f"2 w_m + w = {2 * w_m + design.filter:.3g} rad/s", design.noise),
        _gain("depth_feedback_gain", k_1, "N/m", f"M w_m^2, w_m = {w_m:.3g} rad/s; {left}"),
        _gain("rate_feedback_gain", k_2, "N.s/m", f"2 M w_m - D, w_m = {w_m:.3g} rad/s"),
        _gain(
            "filter_bandwidth",
            design.filter,
            "rad/s",
            f"smallest from w_m on with |G|_L1 L at most {rules.NORM:g}; here it is {design.norm:.3g}",
        ),
        _gain("lyapunov_weight[1]", q_1, "1", "w_m^2 / 9: the fast loop has damping 1.8 w_m"),
        _gain("lyapunov_weight[2]", q_2, "1", "scale of P, which Gamma takes out"),
        _gain(
            "adaptation_gain",
            design.adaptation_gain,
            "1",
            f"the fast loop makes {rules.TURN:g} of a turn in a sample of {data.period:g} s at "
            f"{conditions.depth:.3g} m",
        ),
        _gain("theta_bound[1]", design.lipschitz, "N", f"L over the ranges: {_ranges(data)}"),
        _gain(
            "sigma_bound",
            bound,
            "N",
            f"{rules.SIGMA:g} times the net weight, {_text(data.net_weight)} N, at the least inertia",
        ),
        _gain("proportional_gain", k_p, "N/m", f"M w_m^2 / 3: poles at 2 w_m / 3; {left}"),
        _gain("integral_gain", k_i, "N/(m.s)", "8 M w_m^3 / 27: three poles at 2 w_m / 3"),
    ]


def pid_gains(design: PidDesign, data: VehicleData) -> list[Gain]:
    """Returns the parameters of PidDepthController."""
    w, (k_p, k_i, k_d) = design.bandwidth, design.gains
    left = f"{design.phase:.3g} deg or {1e3 * design.delay:.0f} ms are left in the worst corner"
    return [
        *(gain for gain in _model(data, design.inertia, design.damping) if gain.name != "model_inertia"),
        *_observer(design.alpha, data, f"3 w = {3 * w:.3g} rad/s", design.noise),
        _gain("kp", k_p, "N/m", f"3 M w^2: three poles at w = {w:.3g} rad/s; {left}"),
        _gain("ki", k_i, "N/(m.s)", f"M w^3, M = {design.inertia:.4g} kg"),
        _gain("kd", k_d, "N.s/m", "3 M w - D"),
    ]


def _model(data: VehicleData, inertia: float, damping: float) -> list[Gain]:
    thrust = f"of {data.name}, together {data.force_limit:.4g} N at {data.voltage_limit:.4g} V"
    return [
        _gain(
            "model_inertia",
            inertia,
            "kg",
            f"puts omega = thrust M / inertia about 1: {_text(data.inertia)} kg, thrust {_text(data.gain)}",
        ),
        _gain("model_damping", damping, "N.s/m", f"middle of {_text(data.damping)}, at most what A_m damps"),
        *(
            Gain(name, value, _UNITS[name.partition("[")[0]], f"designed: {thrust}")
            for name, value in _told(data).items()
        ),
    ]


def _told(data: VehicleData) -> dict[str, float]:
    """Returns the parameters by which a controller with voltages knows the thrusters."""
    points = len(data.actuators.table.voltages) if data.actuators.table else 0
    told = data.actuators.parameters(data.voltage_limit, points) | {"voltage_limit": data.voltage_limit}
    return {name: value for name, value in told.items() if name.partition("[")[0] in _UNITS}


def _observer(alpha: float, data: VehicleData, crossover: str, noise: float) -> list[Gain]:
    return [
        _gain(
            "observer_alpha",
            alpha,
            "1",
            f"takes {rules.OBSERVER_PHASE:g} deg at {crossover}; noise of the demand {noise:.2g} N",
        ),
        _gain("observer_beta", beta_of(alpha), "1", "alpha^2 / (2 - alpha), Benedict and Bordner (1962)"),
        _gain("observer_period", data.period, "s", f"the sensor of {data.name}"),
    ]


def _gain(name: str, value: float, unit: str, reason: str) -> Gain:
    return Gain(name, float(f"{value:.{_DIGITS}g}"), unit, f"designed: {reason}")


def _text(ends: Range) -> str:
    return f"{ends[0]:.4g}" if ends[0] == ends[1] else f"{ends[0]:.4g} to {ends[1]:.4g}"


def _ranges(data: VehicleData) -> str:
    return (
        f"inertia {_text(data.inertia)} kg, damping {_text(data.damping)} N.s/m and "
        f"{_text(data.drag)} N.s2/m2, thrust {_text(data.gain)}"
    )


RMSE, SETTLING = "rmse", "settling_time"
Values = Mapping[str, FmiValue]


@dataclass(frozen=True)
class DesignCheck:
    """Results of the runs of a controller.

    values: of each run; the first has none, the start values
    rmse: of each run [cm], not a number if it failed; settling: its settling time [s], not a number if none
    """

    title: str
    values: Sequence[Values]
    rmse: Sequence[float]
    settling: Sequence[float]
    reasons: Mapping[int, str]

    @property
    def worst(self) -> int:
        """The index of the run that failed, or has the largest RMSE."""
        return max(range(len(self.rmse)), key=lambda i: (i in self.failed, _size(self.rmse[i])))

    @property
    def longest_settling(self) -> float:
        """The longest settling time [s], not a number if a run does not settle."""
        return max(self.settling, key=_size)

    @property
    def failed(self) -> list[int]:
        """The indices of the runs that did not settle, or failed."""
        return [i for i, time in enumerate(self.settling) if math.isnan(time)]

    def values_text(self, index: int) -> str:
        """Returns the values of a run in words."""
        values = self.values[index].items()
        return ", ".join(f"{name} = {value:.4g}" for name, value in values) or "the start values"

    def failures(self) -> list[str]:
        """Returns a sentence for each run that did not settle."""
        return [
            f"{self.title}: {self.reasons.get(i, 'does not settle')} at {self.values_text(i)}"
            for i in self.failed
        ]


def _size(number: float) -> float:
    return math.inf if math.isnan(number) else number


def check(
    title: str,
    scenario: Scenario,
    gains: Sequence[Gain],
    values: Sequence[Values],
    progress: Callable[[], object] = lambda: None,
) -> DesignCheck:
    """Runs a scenario with the gains of a design at the start values and at others."""
    own = {f"controller.{gain.name}": gain.value for gain in gains}
    values = [{}, *values]
    experiments = [with_values(scenario.experiment, {**own, **of_run}) for of_run in values]
    metrics = {name: scenario.metrics[name] for name in (RMSE, SETTLING)}
    rows, reasons = list[Mapping[str, float]](), dict[int, str]()
    for i, result in enumerate(run_many(scenario.system, experiments, reduce=partial(_reduced, metrics))):
        if isinstance(result, Failure):
            reasons[i] = result.reason
        rows.append({} if isinstance(result, Failure) else result)
        progress()
    columns = ([row.get(name, math.nan) for row in rows] for name in (RMSE, SETTLING))
    rmse, settling = columns
    return DesignCheck(title, values, rmse, settling, reasons)


def _reduced(metrics: Mapping[str, Mapping[str, Any]], runs: Recording) -> list[dict[str, float]]:
    """Returns the metrics of each run; one that was terminated has none."""
    rows = (runs.run(i) for i in range(len(runs.values)))
    return [{} if "terminated" in run.provenance else evaluate(run, metrics) for run in rows]


def write(
    path: Path, gains: Sequence[Gain], phase: float, delay: float, checks: Sequence[DesignCheck]
) -> None:
    """Writes a parameter file, with the results of the check."""
    document: dict[str, Any] = {
        "design": {
            "phase_margin_deg": float(f"{phase:.{_DIGITS}g}"),
            "delay_margin_s": float(f"{delay:.{_DIGITS}g}"),
            "checked": [_checked(one) for one in checks],
        },
        "parameters": {
            f"controller.{gain.name}": {"value": gain.value, "unit": gain.unit, "source": gain.source}
            for gain in gains
        },
    }
    write_text_atomically(path, tomli_w.dumps(document))


def _checked(one: DesignCheck) -> Mapping[str, Any]:
    return {
        "controller": one.title,
        "runs": len(one.rmse),
        "rmse_cm": round(one.rmse[0], 3),
        "worst_rmse_cm": round(one.rmse[one.worst], 3),
        "worst_settling_time_s": round(one.longest_settling, 2),
        "worst_values": one.values_text(one.worst),
    }
