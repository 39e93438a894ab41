"""Block ExamplePlant: the paper's illustrative example, whose theta the controller does not know.

    x' = A_m x + B_m (omega u + theta' x + sigma),   y = C x

Source: Maalouf et al. (2013), section 3.3; Hovakimyan and Cao (2010), page 29. Dimensionless but for time.
"""

from dataclasses import dataclass

from fmus.block import Block, NoValues, variable
from fmus.block.guide import Experiment, Guide, Source

Vector = tuple[float, float]
_BOOK = "Hovakimyan and Cao (2010), page 29, and public MATLAB programs; not printed in the paper"


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(
        1e-3, "Longest internal step", unit="s", min=1e-7, max=10.0, variability="fixed"
    )
    state_matrix: tuple[Vector, Vector] = variable(((0.0, 1.0), (-1.0, -1.4)), "A_m", source=_BOOK)
    input_vector: Vector = variable((0.0, 1.0), "B_m", source=_BOOK)
    output_vector: Vector = variable((1.0, 0.0), "C", source=_BOOK)
    theta: Vector = variable((4.0, -4.5), "Unknown parameter theta", source=_BOOK)
    omega: float = variable(1.0, "Unknown input gain omega", source="published: omega = 1")
    initial_state: Vector = variable(
        (0.0, 0.0), "x at the start", variability="fixed", source="assumed: not published"
    )


@dataclass(frozen=True)
class Inputs:
    control: float = variable(0.0, "Control u")
    disturbance: float = variable(0.0, "Disturbance sigma, matched with the input")


@dataclass(frozen=True)
class Continuous:
    x: Vector = variable((0.0, 0.0), "State x")


@dataclass(frozen=True)
class Outputs:
    state: Vector = variable((0.0, 0.0), "State x")
    output: float = variable(0.0, "Output y = C x")


def derivative(
    t: float, state: Continuous, inputs: Inputs, p: Parameters, calculated: NoValues
) -> Continuous:
    """Returns x'."""
    x = state.x
    (a_11, a_12), (a_21, a_22) = p.state_matrix
    uncertainty = p.theta[0] * x[0] + p.theta[1] * x[1] + inputs.disturbance
    forcing = p.omega * inputs.control + uncertainty
    return Continuous(
        (
            a_11 * x[0] + a_12 * x[1] + p.input_vector[0] * forcing,
            a_21 * x[0] + a_22 * x[1] + p.input_vector[1] * forcing,
        )
    )


def initial_state(t: float, inputs: Inputs, p: Parameters, calculated: NoValues) -> Continuous:
    return Continuous(p.initial_state)


def output(t: float, state: Continuous, p: Parameters, calculated: NoValues) -> Outputs:
    x, c = state.x, p.output_vector
    return Outputs(state=x, output=c[0] * x[0] + c[1] * x[1])


GUIDE = Guide(
    equations="""\
x' = A_m x + B_m (omega u + theta^T x + sigma)
y  = C x
""",
    conventions=(
        "Quantities are dimensionless, time is in s. The disturbance sigma enters where the control u does.",
    ),
    tuning=(
        "theta and omega are unknown to a controller: change them to test its robustness.",
        "internal_step is the step of a classical Runge-Kutta method of fourth order; it should be short"
        " against the fastest eigenvalue of A_m + B_m theta^T.",
    ),
    limits=(
        "Without control the start values are unstable: A_m + B_m theta^T has an eigenvalue of +0.47, so"
        " an open loop grows without bound.",
        "The control is held over a communication step; a fast controller needs a short one.",
        "x(0) = 0 is assumed, the paper does not say.",
    ),
    sources=(
        Source(
            "Maalouf, Chemori and Creuze: A new extension of the L1 adaptive controller to drastically"
            " reduce the tracking time lags, NOLCOS 2013, section 3.3.",
            "https://hal-lirmm.ccsd.cnrs.fr/lirmm-00841558",
        ),
        Source("N. Hovakimyan and C. Cao: L1 Adaptive Control Theory, SIAM, 2010, page 29."),
    ),
    experiment=Experiment(
        stop_time=2.0,
        stimuli=(
            ("control", ((0.2, 0.0), (0.4, 1.0), (1.0, 1.0), (1.5, -2.0))),
            ("disturbance", ((1.2, 0.0), (1.4, 0.5))),
        ),
    ),
)


BLOCK = Block.of_module(
    __name__,
    "ExamplePlant",
    "Second-order plant with unknown state feedback: the paper's illustrative example",
    stop_time=94.25,
    step_size=1e-3,
    license="MIT",
)
