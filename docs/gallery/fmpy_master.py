# %% [markdown]
# # The paper's loop on FMPy alone
#
# A master algorithm in fifty lines: at each communication point outputs go to inputs, then both FMUs step.
# It imports nothing of this project; `l1-depth build L1DepthController RovDepthPlant` writes the FMUs.

# %%
from shutil import rmtree

import matplotlib.pyplot as plt
import numpy as np
from fmpy import extract, read_model_description
from fmpy.simulation import instantiate_fmu

times = 0.02 * np.arange(15501)  # s
reference = np.interp(times, [0, 40, 140, 180, 250, 310], [0, 0.8, 0.8, 0.4, 0.4, 0.6])  # m


def load(name: str, *groups: list[str]) -> tuple:
    """Returns an FMU in initialization mode, and the value references of each group of variables."""
    description = read_model_description(f"fmus-built/{name}.fmu")
    fmu = instantiate_fmu(extract(f"fmus-built/{name}.fmu"), description, "CoSimulation")
    fmu.setupExperiment(startTime=0.0, stopTime=times[-1])
    fmu.enterInitializationMode()
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    return fmu, *([references[variable] for variable in group] for group in groups)


voltages, sensors = ["voltage[1]", "voltage[2]"], ["measured_depth", "depth_rate"]
plant, to_plant, from_plant, true_depth = load("RovDepthPlant", voltages, sensors, ["depth"])
inputs = ["measured_depth", "measured_depth_rate", "depth_reference"]
controller, to_controller, from_controller = load("L1DepthController", inputs, voltages)


def exchange(point: int) -> None:
    """Sets each FMU's inputs from the outputs of the other and from the reference."""
    measured, demanded = plant.getReal(from_plant), controller.getReal(from_controller)
    controller.setReal(to_controller, [*measured, reference[point]])
    plant.setReal(to_plant, demanded)


# %%
for _ in range(2):  # the first pass sets the measurement, the second the voltages
    exchange(0)
for fmu in (plant, controller):
    fmu.exitInitializationMode()
depth = np.empty(times.shape)
for point, time in enumerate(times):
    exchange(point)
    (depth[point],) = plant.getReal(true_depth)
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
