# %% [markdown]
# # The paper's loop on FMPy alone
#
# A master algorithm in forty lines: at each communication point outputs go to inputs, then both FMUs step.
# It imports nothing of this project, whose `l1-depth build L1DepthController RovDepthPlant` writes the FMUs.

# %%
from shutil import rmtree

import matplotlib.pyplot as plt
import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

times = 0.02 * np.arange(15501)  # s
reference = np.interp(times, [0, 40, 140, 180, 250, 310], [0, 0.8, 0.8, 0.4, 0.4, 0.6])  # m


def load(name: str) -> tuple[FMU2Slave, dict[str, int]]:
    """Returns an instance of an FMU, and the value references of its variables."""
    archive = f"fmus-built/{name}.fmu"
    description, folder = read_model_description(archive), extract(archive)
    fmu = FMU2Slave(instanceName=name, guid=description.guid, modelIdentifier=name, unzipDirectory=folder)
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0, stopTime=times[-1])
    fmu.enterInitializationMode()
    return fmu, {variable.name: variable.valueReference for variable in description.modelVariables}


plant, vehicle = load("RovDepthPlant")
controller, law = load("L1DepthController")
sensors = [vehicle[name] for name in ("measured_depth", "depth_rate")]
inputs = [law[name] for name in ("measured_depth", "measured_depth_rate", "depth_reference")]
demands, voltages = ([of["voltage[1]"], of["voltage[2]"]] for of in (law, vehicle))


def exchange(point: int) -> None:
    """Sets the inputs of both FMUs to what the other one gave, and to the reference."""
    measured, demanded = plant.getReal(sensors), controller.getReal(demands)
    controller.setReal(inputs, [*measured, reference[point]])
    plant.setReal(voltages, demanded)


# %%
for _ in range(2):  # the initial voltages follow from the initial measurement
    exchange(0)
for fmu in (plant, controller):
    fmu.exitInitializationMode()
depth = np.empty(times.shape)
for point, time in enumerate(times):
    exchange(point)
    (depth[point],) = plant.getReal([vehicle["depth"]])
    if point + 1 < len(times):
        for fmu in (plant, controller):
            fmu.doStep(time, times[point + 1] - time)
for fmu in (plant, controller):
    fmu.terminate()
    fmu.freeInstance()
    rmtree(fmu.unzipDirectory)
print(f"RMSE {100.0 * np.sqrt(np.mean((depth - reference) ** 2)):.2f} cm")

# %%
figure, axes = plt.subplots(layout="constrained")
axes.plot(times, depth, label="depth")
axes.plot(times, reference, "k--", linewidth=0.8, label="reference")
axes.set(xlabel="time [s]", ylabel="depth [m]")
axes.invert_yaxis()
axes.legend()
plt.show()
