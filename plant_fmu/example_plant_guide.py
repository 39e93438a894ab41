"""What the documentation of ExamplePlant says besides its variables."""

from fmus.block.guide import Experiment, Guide, Source

GUIDE = Guide(
    equations="""\
x' = A_m x + B_m (omega u + theta^T x + sigma)
y  = C x
""",
    conventions=(
        "Dimensionless but for time; control is u, disturbance is sigma, which enters where the control"
        " does.",
    ),
    tuning=(
        "theta and omega are what a controller does not know; change them to see how much it bears.",
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
