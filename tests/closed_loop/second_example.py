"""The illustrative example once more: the equations that second_example.c integrates, and their numbers.

    plant     x' = A_m x + b (u + theta' x),   y = x_1,   u = u_a + u_p + u_f,   x(0) = 0
    law       x_hat' = A_m x_hat + b (omega_hat u + theta_hat' x),   x_tilde = x_hat - x
              theta_hat_i' = G Proj(theta_hat_i, -(x_tilde' P b) x_i)
              omega_hat'   = G Proj(omega_hat, -(x_tilde' P b) u_w),   u_w = u - u_p, or u
              u_a'   = -w (omega_hat u_a + theta_hat' x - v),   v = r
    or        u_p = -K_P e - K_I int e,   e = y - r;   u_p = -a_1 |e|^alpha sgn(e) if |e| > delta,
              else -a_2 e / delta^(1 - alpha),   delta = max(ratio |r|, floor)
    or        v = f = r'' + 1.4 r' + r;   u_f = f, v = (1 - omega_hat) f
    or        x_hat' = A_m x + A_s x_tilde + b u + s,   s = -Phi^-1 e^(A_s Ts) x_tilde every Ts,
              Phi = A_s^-1 (e^(A_s Ts) - I);   s_2 in place of theta_hat' x in the filter

Source: Maalouf et al. (2013), section 3; Hovakimyan and Cao (2010), page 29 and chapter 3.
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fmus.native import compiled_library

NUMBERS: dict[str, float] = {
    "amplitude": 100.0, "frequency": 0.2, "theta1": 4.0, "theta2": -4.5, "gain": 1e4, "bound": 10.0,
    "eps": 0.1, "omega_box": 0.0, "bandwidth": 160.0, "rate": -1.0, "period": 1e-3, "kp": 0.0, "ki": 0.0,
    "a1": 25.0, "a2": 100.0, "alpha": 0.1, "ratio": 0.1, "floor": 1.0,
}  # fmt: skip
CHOICES = ("augmentation", "feedforward", "piecewise", "learns_from_both")


class _Case(ctypes.Structure):
    _fields_ = (*((name, ctypes.c_double) for name in NUMBERS), *((name, ctypes.c_int) for name in CHOICES))


def second_example(
    duration: float, every: float, step: float, **changes: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Time, y and u every `every` seconds, and max |x_tilde| over all steps."""
    rows, steps = round(duration / every), round(every / step)
    table = np.empty((rows + 1, 2))
    case = _Case(**{**NUMBERS, **changes})
    largest = _library().second_example(
        ctypes.byref(case), ctypes.c_double(step), ctypes.c_longlong(rows), ctypes.c_longlong(steps),
        ctypes.c_void_p(table.ctypes.data),
    )  # fmt: skip
    return every * np.arange(rows + 1), table[:, 0], table[:, 1], largest


@cache
def _library() -> ctypes.CDLL:
    source = Path(__file__).with_suffix(".c")
    library = compiled_library.load(source)
    library.second_example.restype = ctypes.c_double
    return library
