# %% [markdown]
# # Where the lag goes
#
# The nominal experiment of the paper with plain L1 and with the PI extension. The vehicle follows straight
# ramps. Without the extension it lags behind them. With it the largest error is less than half as large.
#
# It needs the FMUs that `l1-depth build --cache` builds.

# %%
import matplotlib.pyplot as plt

from orchestration import load_scenario, simulate

figure, (depth_axes, error_axes) = plt.subplots(2, 1, sharex=True, layout="constrained")
for name, label in (("nominal-l1", "L1"), ("nominal-extended", "extended L1 (PI)")):
    chosen = load_scenario(name)
    recording = simulate(chosen.system, chosen.experiment)
    depth, reference = recording["plant.depth"], recording["controller.depth_reference"]  # m
    depth_axes.plot(recording.time, depth, label=label)
    error_axes.plot(recording.time, 100.0 * (depth - reference), label=label)
    print(f"{label}: largest error {100.0 * abs(depth - reference).max():.1f} cm")
depth_axes.plot(recording.time, reference, "k--", linewidth=0.8, label="reference")
depth_axes.set_ylabel("depth [m]")
depth_axes.invert_yaxis()
depth_axes.legend()
error_axes.set(xlabel="time [s]", ylabel="tracking error [cm]")
plt.show()
