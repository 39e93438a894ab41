"""Directional derivatives of FMI 2.0, against closed forms and differences."""

from typing import Any

import numpy as np
import pytest

from fmus.generate import builder
from tests.shared_builds import Fmus, slow_but

from .session import LAST_TIME, OK, Session


def along(session: Session, unknowns: tuple[str, ...], knowns: dict[str, float]) -> list[float]:
    """Returns the derivatives of unknowns along a direction."""
    references = session.of(*unknowns), session.of(*knowns)
    return session("directional_derivative", *references, [*knowns.values()], "+").numbers


def test_a_known_that_is_named_twice_counts_twice(session: Session) -> None:
    """In both modes; d(product) = limit d(gain) + gain d(limit)."""
    knowns = session.begin().of("gain", "limit", "gain")
    for mode in ("initialization", "step"):
        answer = session("directional_derivative", session.of("product"), knowns, [1.0, 10.0, 2.0], "+")
        assert answer.numbers == [4.0 * 3.0 + 2.0 * 10.0], mode
        session("leave")


def test_derivatives_by_inputs_are_those_of_the_mode(session: Session) -> None:
    """x = start + force in initialization mode; later no output depends directly on an input."""
    unknowns, knowns = ("y", "square"), {"force": 1.0, "start": 0.0}
    assert along(session.begin(), unknowns, knowns) == [8.0, 2.0]
    assert session("leave").status == OK
    for _ in range(2):  # while stepping, then terminated
        assert along(session, unknowns, knowns) == [0.0, 0.0]
        assert session("get_status", "R", LAST_TIME, "+").numbers == [0.0]
        session("terminate")


@pytest.mark.parametrize("name", slow_but(("RovDepthPlant",), builder.block_names()))
def test_derivatives_of_the_initialization_are_slopes(built: Fmus, load: Any, name: str) -> None:
    """Against central differences, whose error is some 1e-6 of the slope at a relative step of 1e-5."""
    block, fmu = builder.load_block(name), load(built[name])
    fmu.slave.setupExperiment(startTime=1.0)  # away from the corners of ramps
    fmu.slave.enterInitializationMode()
    real = [v for v in block.variables if v.type == "Real"]
    unknowns = [v.value_reference for v in real if not v.settable]
    for v in real:
        if v.causality == "input" and v.maximum is None:
            fmu[v.name] = 0.3  # away from the corners of |x|
    for known in (v for v in real if v.settable):
        start = fmu[known.name]
        step = 1e-5 * max(abs(start), 1e-2)
        moved = start + step, start - step
        if any(map(known.refuse, moved)) or "samp" in known.name or known.name == "sensor_noise":
            continue
        given = fmu.slave.getDirectionalDerivative(unknowns, [known.value_reference], [1.0])
        reached = []
        for value in (*moved, start):
            fmu[known.name] = value
            reached.append(np.array(fmu.slave.getReal(unknowns)))
        assert given == pytest.approx((reached[0] - reached[1]) / (2 * step), rel=1e-5, abs=1e-5), known.name
