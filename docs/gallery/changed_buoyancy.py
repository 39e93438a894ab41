# %% [markdown]
# # Many runs of loaded FMUs
#
# A `Simulator` loads the FMUs once. Here it runs the nominal experiment for eleven changes of buoyancy, with
# and without the extension.
#
# It needs the FMUs that `l1-depth build --cache` builds.

# %%
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from orchestration import Simulator, evaluate, load_scenario

changes = np.linspace(-0.5, 0.5, 11)  # N, positive lifts
figure, axes = plt.subplots(layout="constrained")
for name, label in (("nominal-l1", "L1"), ("nominal-extended", "extended L1 (PI)")):
    chosen = load_scenario(name)
    rmse = []  # cm
    with Simulator(chosen.system) as simulator:
        for change in changes:
            inputs = {**chosen.experiment.inputs, "plant.buoyancy_change": float(change)}
            recording = simulator.run(replace(chosen.experiment, inputs=inputs))
            rmse.append(evaluate(recording, chosen.metrics)["rmse"])
    axes.plot(changes, rmse, "o-", label=label)
    print(f"{label}: RMSE from {min(rmse):.1f} to {max(rmse):.1f} cm")
axes.set(xlabel="change of buoyancy [N]", ylabel="RMSE [cm]", ylim=(0.0, None))
axes.legend()
plt.show()

# %% [markdown]
# One of the runs, the last:

# %%
recording.plot("plant.depth", "plant.total_force")
