# %% [markdown]
# # LQG with matrices
#
# Directional derivatives of the vehicle's FMU give a linear model of four states and two inputs. SciPy
# designs a regulator and a Kalman filter for it, and a Python class runs both in the loop.
#
# It needs the FMUs that `l1-depth build --cache` builds.

# %%
import tomllib
from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Model
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import root

from orchestration import evaluate, load_scenario, simulate

np.set_printoptions(precision=3, suppress=True)
scenario = load_scenario("nominal-extended")

# %% [markdown]
# ## Rest
#
# The FMU has its derivatives in model exchange. At rest the forces of both thrusters hold the vehicle against
# its buoyancy.

# %%
archive = str(scenario.system.components["plant"])
description = read_model_description(archive)
number = {variable.name: variable.valueReference for variable in description.modelVariables}
derivatives = [entry.variable.name for entry in description.derivatives]
states = [entry.variable.derivative.name for entry in description.derivatives]
inputs = ["voltage[1]", "voltage[2]"]

vehicle = FMU2Model(
    guid=description.guid,
    modelIdentifier=description.modelExchange.modelIdentifier,
    unzipDirectory=extract(archive),
    instanceName="vehicle",
)
vehicle.instantiate()
vehicle.setupExperiment()
vehicle.enterInitializationMode()
vehicle.exitInitializationMode()
vehicle.enterContinuousTimeMode()


def rates(x, u):
    """Returns x' of states x and inputs u."""
    vehicle.setReal([number[name] for name in inputs], list(u))
    vehicle.setReal([number[name] for name in states], list(x))
    return np.array(vehicle.getReal([number[name] for name in derivatives]))


def at_rest(voltage, force):
    """Returns states and inputs at a depth of 0.5 m, both thrusters alike."""
    return [0.5, 0.0, force, force], [voltage, voltage]


trim = root(lambda unknown: rates(*at_rest(*unknown))[1:3], [1.0, 1.0]).x
print(f"{trim[0]:.2f} V and {trim[1]:.2f} N of each thruster")

# %% [markdown]
# ## Linear model
#
# A column for each state and each input: x' = A x + B u for small motions about rest.


# %%
def jacobian(names):
    """Returns the derivatives of x' with respect to variables, a column for each."""
    rows = [number[name] for name in derivatives]
    return np.array([vehicle.getDirectionalDerivative(rows, [number[name]], [1.0]) for name in names]).T


a, b = jacobian(states), jacobian(inputs)
vehicle.terminate()
vehicle.freeInstance()
print(states, a, b, sep="\n")

# %% [markdown]
# ## Regulator and Kalman filter
#
# Both have the period of the depth sensor. The regulator weighs 1 cm of error like 1 V. The filter has one
# state more: an unknown force, which drifts. Its estimate takes the place of an integral.

# %%
PERIOD = 0.04  # s


def sampled(a, b):
    """Returns the matrices over one period, with the inputs held."""
    n, m = b.shape
    exponential = expm(PERIOD * np.block([[a, b], [np.zeros((m, n + m))]]))
    return exponential[:n, :n], exponential[:n, n:]


weight, effort = np.diag([0.01**-2, 0.0, 0.0, 0.0]), np.eye(2)
a_d, b_d = sampled(a, b)
p = solve_discrete_are(a_d, b_d, weight, effort)
k = np.linalg.solve(effort + b_d.T @ p @ b_d, b_d.T @ p @ a_d)

unknown_force = a[1, 2] * np.eye(4)[:, 1:2]  # it acts as the force of a thruster does
a_f, b_f = sampled(np.block([[a, unknown_force], [np.zeros((1, 5))]]), np.vstack([b, np.zeros((1, 2))]))
c = np.eye(1, 5)
process = np.diag([0.0, 0.001, 0.0, 0.0, 0.01]) ** 2  # of a sample: m/s and N
sensor = np.array([[0.002**2]])  # noise and resolution, m2
q = solve_discrete_are(a_f.T, c.T, process, sensor)
gain = (q @ c.T / (c @ q @ c.T + sensor)).ravel()
print("K", k, "gain of the filter", gain, sep="\n")

# %% [markdown]
# ## Controller
#
# A class in a file of its own is a controller, in scenarios as for `l1-depth run` and `score`. It reads its
# matrices from a second file. The FMU that is made of the class carries both.

# %%
np.savez("lqg.npz", a=a, b=b, a_f=a_f, b_f=b_f, gain=gain, k=k)
CONTROLLER = """
from pathlib import Path

import numpy as np


class Lqg:
    period = 0.04  # s
    inputs = ("depth_reference", "depth_reference_rate", "measured_depth")
    outputs = ("voltage[1]", "voltage[2]")

    def reset(self):
        with np.load(Path(__file__).with_name("lqg.npz")) as matrices:
            self.__dict__.update(matrices)
        self.x, self.u = np.zeros(5), np.zeros(2)

    def step(self, time, inputs):
        self.x = self.a_f @ self.x + self.b_f @ self.u
        self.x += self.gain * (inputs["measured_depth"] - self.x[0])

        # on the reference, the forces balance the damping and the unknown force
        depth, rate = inputs["depth_reference"], inputs["depth_reference_rate"]
        force = -0.5 * (self.a[1, 1] / self.a[1, 2] * rate + self.x[4])
        target = np.array([depth, rate, force, force])
        feedforward = -np.linalg.solve(self.b[2:], self.a[2:, 2:] @ target[2:])

        self.u = np.clip(feedforward - self.k @ (self.x[:4] - target), -12.0, 12.0)  # V
        return {"voltage[1]": self.u[0], "voltage[2]": self.u[1]}
"""
written = Path("lqg_controller.py").write_text(CONTROLLER, encoding="utf-8")

# %% [markdown]
# ## In the loop
#
# Sensor, noise and trajectory are those of the paper's nominal experiment. Extended L1 has the gains that are
# identified from the paper, then those tuned for this vehicle, of which LQG knows all numbers.

# %%
tuned = tomllib.loads((files("orchestration") / "studies/score/gains/l1-pi.toml").read_text(encoding="utf-8"))
controllers = {
    "extended L1": {"controller.augmentation": "pi"},
    "extended L1, tuned": {name: entry["value"] for name, entry in tuned["parameters"].items()},
    "LQG": {"controller": "lqg_controller.py:Lqg"},
}
figure, (depth_axes, error_axes) = plt.subplots(2, 1, sharex=True, layout="constrained")
for label, settings in controllers.items():
    chosen = load_scenario("nominal-extended", settings=settings)
    recording = simulate(chosen.system, chosen.experiment)
    depth, reference = recording["plant.depth"], recording["controller.depth_reference"]  # m
    depth_axes.plot(recording.time, depth, label=label)
    error_axes.plot(recording.time, 100.0 * (depth - reference), label=label)
    rmse, variation = evaluate(recording, chosen.metrics)["rmse"], np.diff(recording["plant.total_force"])
    print(f"{label}: RMSE {rmse:.2f} cm, total variation of the force {abs(variation).sum():.0f} N")
depth_axes.plot(recording.time, reference, "k--", linewidth=0.8, label="reference")
depth_axes.set_ylabel("depth [m]")
depth_axes.invert_yaxis()
depth_axes.legend()
error_axes.set(xlabel="time [s]", ylabel="tracking error [cm]")
plt.show()
