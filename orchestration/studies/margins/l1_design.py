"""The design of our L1 controllers and of plants, read from their model descriptions and a scenario's values.

A controller of another name is not judged: its law is not known. Nor is a vehicle whose description names no
inertia.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from controller_fmu.design import Extension, FilterOrder, Regressor, lipschitz_constant
from fmus.fmi.model_description import ModelDescription, ScalarVariable
from orchestration.scenarios.scenario import Scenario
from orchestration.scenarios.toml_file import TomlFile
from orchestration.scenarios.vehicle import VehicleValues, description_file, description_of
from orchestration.studies.margins.l1_loop import Law, Observer, Pair, Plant
from orchestration.system.prepared_run import values_of

Values = Mapping[str, Any]
"""Variable -> value; of an enumeration, the name of its item."""


@dataclass(frozen=True)
class Design:
    """The design of a loop of an L1 controller.

    law: with its adaptation at rest, at the depth of the hold
    lipschitz: L of the uncertainty; omegas: lowest and highest input gain of the box
    frozen_gains: of the nonlinear P, ascending; empty for other extensions. The law has the small-error gain
    gain_unit: of K_P
    has_rest: whether the adaptation has a gain at rest, by which the loop without the limit is linear
    controller: the component; adaptation_gain: Gamma, not a number of a law that has none
    largest_parameters: of |theta|^2 + sigma^2 + (omega - omega_0)^2
    """

    law: Law
    plant: Plant
    lipschitz: float
    omegas: Pair
    frozen_gains: tuple[float, ...]
    gain_unit: str
    has_rest: bool
    controller: str
    adaptation_gain: float
    largest_parameters: float

    @property
    def has_gain(self) -> bool:
        """Whether the law has an adaptation gain."""
        return 0.0 < self.adaptation_gain < math.inf

    @property
    def extension(self) -> Extension:
        return Extension(self.law.c, self.law.proportional_gain, self.law.integral_gain)


def design_of(chosen: Scenario, largest_reference: float, rest: float) -> Design | None:
    """Returns the design of the scenario's L1 controller and plant; None if one of them is not ours.

    largest_reference: largest |r| of the run; rest: the value that is held, not a number if none is
    """
    prepared, named = chosen.prepared, chosen.resolved.get("components", chosen.system.components)
    described = {name: d.modelName or "" for name, d in prepared.system.descriptions.items()}
    controllers = [name for name, model in described.items() if model in _LAWS]
    linear = {name: _linear_plant(str(named[name]), d) for name, d in prepared.system.descriptions.items()}
    plants = {name: plant for name, plant in linear.items() if plant}
    if len(controllers) != 1 or len(plants) != 1:
        return None
    values, ((name, plant_of),) = values_of(prepared, controllers[0]), plants.items()
    plant = values_of(prepared, name)
    law = _LAWS[described[controllers[0]]](values, rest, largest_reference if math.isnan(rest) else abs(rest))
    bound = _pair(values, "theta_bound")
    centre, half_width = values["input_gain"], values["input_gain_uncertainty"]
    linear_plant = plant_of(plant, values)
    if linear_plant is None:
        return None
    theta = bound[:1] if values["regressor"] == "infinity_norm" else bound
    largest = (*theta, values["sigma_bound"], half_width)
    is_gradient = values.get("adaptation_law", "projection") == "projection"
    return Design(
        law=law,
        plant=linear_plant,
        lipschitz=lipschitz_constant(Regressor[str(values["regressor"]).upper()], bound),
        omegas=(centre - half_width, centre + half_width),
        frozen_gains=_frozen_gains(values, largest_reference),
        gain_unit=prepared.system.ports[f"{controllers[0]}.proportional_gain"].variable.unit or "",
        has_rest=is_gradient and math.isfinite(law.kappa),
        controller=controllers[0],
        adaptation_gain=values["adaptation_gain"] if is_gradient else math.nan,
        largest_parameters=sum(x**2 for x in largest),
    )


def _pair(values: Values, name: str) -> Pair:
    return values[f"{name}[1]"], values[f"{name}[2]"]


def _matrix(values: Values, name: str) -> tuple[Pair, Pair]:
    first, second = ((values[f"{name}[{row},1]"], values[f"{name}[{row},2]"]) for row in (1, 2))
    return first, second


def _common(values: Values, rest: float, reference: float) -> dict[str, Any]:
    """Returns values common to these laws; nonlinear P is linear about e = 0, where |r| is `reference`."""
    slope = _small_error_gain(values, _threshold(values, reference))
    pi = values["augmentation"] == "pi"
    proportional = values["proportional_gain"] if pi else 0.0
    by_state = values["regressor"] == "state"
    # at rest the regressor is (rest, 0): theta_hat of it, where it may adapt, and sigma_hat
    theta = rest**2 if values["theta_bound[1]"] > 0.0 else 0.0
    sigma = 1.0 if values["sigma_bound"] > 0.0 else 0.0
    kappa = values["adaptation_gain"] * (theta + sigma)
    return {
        "q": _pair(values, "lyapunov_weight"),
        "filter_order": FilterOrder[str(values["filter_order"]).upper()],
        "bandwidth": values["filter_bandwidth"],
        "omega_hat": values["input_gain"],
        "proportional_gain": slope if values["augmentation"] == "nonlinear_p" else proportional,
        "integral_gain": values["integral_gain"] if pi else 0.0,
        "kappa": math.inf if math.isnan(kappa) or kappa <= 0.0 or by_state else kappa,
    }


def _depth_law(values: Values, rest: float, reference: float) -> Law:
    """Returns the law of L1DepthController: (13) of Maalouf et al. (2013)."""
    inertia, k_m = values["model_inertia"], (values["depth_feedback_gain"], values["rate_feedback_gain"])
    observer = Observer(values["observer_alpha"], values["observer_beta"], values["observer_period"])
    return Law(
        a_m=((0.0, 1.0), (-k_m[0] / inertia, -(values["model_damping"] + k_m[1]) / inertia)),
        b=(0.0, 1.0 / inertia),
        c=(1.0, 0.0),
        k_m=k_m,
        observer=observer if values["velocity_source"] == "alpha_beta_observer" else None,
        **_common(values, rest, reference),
    )


def _general_law(values: Values, rest: float, reference: float) -> Law:
    """Returns the law of L1Controller: its matrices are parameters."""
    return Law(
        a_m=_matrix(values, "state_matrix"),
        b=_pair(values, "input_vector"),
        c=_pair(values, "output_vector"),
        k_m=_pair(values, "feedback_gain"),
        **_common(values, rest, reference),
    )


def _linear_plant(
    fmu: str, description: ModelDescription
) -> "Callable[[Values, Values], Plant | None] | None":
    """Returns what gives the linear plant of a component; None for one that is no plant, or not known.

    fmu: as the scenario names it, beside which the description of a vehicle stands
    """
    model = description.modelName or ""
    if model == "ExamplePlant":
        return _example
    described = (description_file(vehicle) for vehicle in (fmu, model))
    file = next((file for file in described if description_of(file).variables.inertia), None)
    return partial(_vehicle, file, {v.name: v for v in description.modelVariables}) if file else None


def _vehicle(
    file: TomlFile, variables: Mapping[str, ScalarVariable], values: Values, controller: Values
) -> Plant | None:
    """Returns a vehicle at rest: linear damping alone, but for a vertical current.

    Each thruster takes half of the control, divided by the gain, or the factor of the table, that the
    controller assumes. None if the thrusters follow a table that the controller does not invert.
    """
    vehicle = VehicleValues(file, variables, {}, values)
    actuators = vehicle.actuators
    if actuators.table and not controller.get("thruster_tabulated"):
        return None
    inertia, damping, drag = vehicle.heave
    damping += 2.0 * drag * abs(vehicle.interface("current_velocity", 0.0))
    gains = (1.0,)
    if actuators.in_volts and np.isfinite(actuators.gains).all():
        assumed = _pair(controller, "thruster_scale" if actuators.table else "thruster_gain")
        gains = tuple(0.5 * gain / divisor for gain, divisor in zip(vehicle.gains, assumed, strict=False))
    lags = vehicle.lags
    # the force of a vehicle without gains has one lag
    if len(lags) != len(gains):
        lags = (max(lags, default=0.0),) * len(gains)
    return Plant(((0.0, 1.0), (0.0, -damping / inertia)), (0.0, 1.0 / inertia), gains, lags)


def _example(values: Values, controller: Values) -> Plant:
    """Returns ExamplePlant, theta in its state matrix."""
    (a_1, a_2), b = _matrix(values, "state_matrix"), _pair(values, "input_vector")
    theta = _pair(values, "theta")
    rows = [
        (row[0] + gain * theta[0], row[1] + gain * theta[1]) for row, gain in zip((a_1, a_2), b, strict=True)
    ]
    return Plant((rows[0], rows[1]), b, (values["omega"],))


_LAWS: dict[str, Callable[[Values, float, float], Law]] = {
    "L1DepthController": _depth_law,
    "L1Controller": _general_law,
}


def _threshold(values: Values, reference: float) -> float:
    """Returns delta of the nonlinear P where |r| is `reference`."""
    delta, floor = values["nonlinear_threshold"], values["threshold_floor"]
    return max(delta if values["threshold"] == "fixed" else delta * reference, floor)


def _small_error_gain(values: Values, delta: float) -> float:
    return values["small_error_gain"] / delta ** (1.0 - values["nonlinear_exponent"])


def _frozen_gains(values: Values, largest_reference: float) -> tuple[float, ...]:
    """Returns -u_p / e of the nonlinear P just above and below the largest delta and the smallest one."""
    if values["augmentation"] != "nonlinear_p":
        return ()
    widest, narrowest = _threshold(values, largest_reference), _threshold(values, 0.0)
    names, power = ("large_error_gain", "small_error_gain"), 1.0 - values["nonlinear_exponent"]
    return tuple(sorted({values[name] / delta**power for name in names for delta in (widest, narrowest)}))
