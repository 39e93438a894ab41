"""The block of `native_block` in a session, its variables called by their names."""

from .native_block import EVERYTHING
from .native_model import OK
from .native_session import Session

REFERENCES = {v.name: v.value_reference for v in EVERYTHING.variables}


def write(session: Session, **values: float) -> int:
    """Set Reals; the status."""
    references = [REFERENCES[name] for name in values]
    return session("set", 0, "R", references, [float(value) for value in values.values()]).status


def read(session: Session, *names: str) -> list[float]:
    answer = session("get", 0, "R", [REFERENCES[name] for name in names], "+")
    assert answer.status == OK
    return [float.fromhex(value) for value in answer.values]


def step(session: Session, t: float, h: float) -> int:
    return session("step", 0, t, h).status


def internal_steps(session: Session) -> int:
    return int(float.fromhex(session("get", 0, "I", [REFERENCES["steps"]], "+").values[0]))
