"""Guide to a block: what its documentation says besides the variables, and an experiment that shows it.

Standard library only: a block's guide is a module beside the block, and an FMU of the python flavour
carries both. Text is plain; whoever shows it escapes it.
"""

from dataclasses import dataclass

Point = tuple[float, float]


@dataclass(frozen=True)
class Source:
    """Source of a statement or a number; `url` may be empty."""

    text: str
    url: str = ""


@dataclass(frozen=True)
class Experiment:
    """Experiment from 0 s with all parameters at their start values.

    stop_time, step_size: in s; None stands for what the block says.
    stimuli: (input, ((time [s], value), ...)) of inputs that move: straight lines between the points,
        held before the first and after the last; the points lie on communication points.
        Every other input keeps its start value.
    """

    stop_time: float | None = None
    step_size: float | None = None
    stimuli: tuple[tuple[str, tuple[Point, ...]], ...] = ()


@dataclass(frozen=True)
class Guide:
    """Guide: what is particular to a block.

    equations: lines as they should be read, in ASCII.
    conventions, tuning, limits: one sentence or a few for each item.
    """

    equations: str = ""
    conventions: tuple[str, ...] = ()
    tuning: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    sources: tuple[Source, ...] = ()
    experiment: Experiment = Experiment()


NO_GUIDE = Guide()
