# %% [markdown]
# # Orders of the master algorithms
#
# Two second-order systems exchange one signal each. The error at the end is proportional to the communication
# step size with held inputs, to its square with extrapolated ones.
#
# It needs the FMUs that `l1-depth build --cache` builds.

# %%
import matplotlib.pyplot as plt

from orchestration import System, load_scenario, simulate

plant = load_scenario("example-l1").system.components["plant"]
system = System(
    {"first": plant, "second": plant},
    [("first.output", "second.control"), ("second.output", "first.control")],
)


def final_output(step_size: float, **algorithm: object) -> float:
    """Returns the output of the second system after 4 s."""
    recording = simulate(
        system,
        stop_time=4.0,  # s
        step_size=step_size,  # s
        parameters={"first.theta[1]": 0.0, "second.theta[1]": 0.0},  # no negative stiffness: stable
        inputs={"first.disturbance": 1.0, "second.disturbance": 0.0},
        **algorithm,
    )
    return float(recording["second.output"][-1])


exact = final_output(0.0005, extrapolation=1)
step_sizes = [0.02, 0.04, 0.08, 0.16]  # s
figure, axes = plt.subplots(layout="constrained")
for label, algorithm in (
    ("Jacobi", {"algorithm": "jacobi"}),
    ("Gauss-Seidel", {"algorithm": "gauss-seidel"}),
    ("Jacobi, extrapolation = 1", {"algorithm": "jacobi", "extrapolation": 1}),
):
    errors = [abs(final_output(step_size, **algorithm) - exact) for step_size in step_sizes]
    axes.loglog(step_sizes, errors, "o-", label=label)
    print(f"{label}: error {errors[0]:.1e} at 20 ms, {errors[-1]:.1e} at 160 ms")
axes.set(xlabel="communication step size [s]", ylabel="error of the output")
axes.legend()
plt.show()
