"""Studies of controllers and vehicles: score with tune and compare, margins, design, fit; each a command.

Users import `Controller` and `score_controllers` from here.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestration.studies.score.closed_loop import Controller
    from orchestration.studies.score.score import score_controllers

__all__ = ["Controller", "score_controllers"]


def __getattr__(name: str) -> Any:
    """Imports a name when it is asked for, as commands import this package for their help."""
    if name == "Controller":
        from orchestration.studies.score.closed_loop import Controller

        return Controller
    if name == "score_controllers":
        from orchestration.studies.score.score import score_controllers

        return score_controllers
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
