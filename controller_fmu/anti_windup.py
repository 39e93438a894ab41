"""Anti-windup by conditional integration: an integrator holds where its change would widen a saturation.

The saturation error is the delivered minus the demanded control, exactly 0 without saturation.
Source: Astrom and Hagglund, Advanced PID Control (2006), chapter 3 (windup).
"""

from fmus.numerics import where


def widens(saturation_error: float, change: float) -> bool:
    """Whether a change of the demand would widen the saturation error."""
    return saturation_error * change < 0.0


def integrate_error(h: float, integral: float, error: float, saturation_error: float) -> float:
    """Returns int e dt after h s with the error held; the demand falls as the integral grows.

    error: e, or e times a gain that may change during a run
    """
    return integral + where(widens(saturation_error, -error), 0.0, h * error)
