# %% [markdown]
# # A depth sensor that fails
#
# Each fault changes what one input receives. The depth sensor freezes for 2 s during the dive, drifts
# for 40 s at constant depth, and loses one sample in five throughout.
#
# It needs the FMUs that `l1-depth build --cache` builds.

# %%
from dataclasses import replace

import matplotlib.pyplot as plt

from orchestration import Drift, DropOut, Fault, Freeze, load_scenario, simulate

chosen = load_scenario("nominal-extended")
sensor = "controller.measured_depth"
faults = (
    Fault(sensor, Freeze(), start=20.0, end=22.0),  # s
    Fault(sensor, Drift(rate=0.002), start=120.0, end=160.0),  # m/s
    Fault(sensor, DropOut(probability=0.2, seed=1)),
)
healthy = simulate(chosen.system, replace(chosen.experiment, stop_time=200.0))
faulty = simulate(chosen.system, replace(chosen.experiment, stop_time=200.0, faults=faults))

# %%
figure, axes = plt.subplots(layout="constrained")
axes.plot(healthy.time, healthy["plant.depth"], label="healthy sensor")
axes.plot(faulty.time, faulty["plant.depth"], label="faulty sensor")
for fault in faults[:2]:
    axes.axvspan(fault.start, fault.end, color="0.9")
axes.set(xlabel="time [s]", ylabel="depth [m]")
axes.invert_yaxis()
axes.legend()
plt.show()

difference = abs(faulty["plant.depth"] - healthy["plant.depth"])
print(f"largest difference of depth {100.0 * difference.max():.0f} cm")
