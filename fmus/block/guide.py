"""Guide to a block: the part of its documentation that does not follow from the variables.

Standard library only: an FMU of the python flavour carries the guide beside the block. Text is plain; the
page escapes it.
"""

from dataclasses import dataclass

Point = tuple[float, float]


@dataclass(frozen=True)
class Source:
    """Source of a statement or a number.

    Parameters
    ----------
    text : str
        Authors, title and year, or where the number was measured.
    url : str
        Link, or "".
    """

    text: str
    url: str = ""


@dataclass(frozen=True)
class Experiment:
    """Experiment from 0 s with all parameters at their start values.

    Parameters
    ----------
    stop_time, step_size : float, optional
        In s; by default the numbers of the block.
    stimuli : tuple of (input, ((time [s], value), ...))
        Inputs that move: straight lines between the points, held before the first and after the last. The
        points lie on communication points. Every other input keeps its start value.
    """

    stop_time: float | None = None
    step_size: float | None = None
    stimuli: tuple[tuple[str, tuple[Point, ...]], ...] = ()


@dataclass(frozen=True)
class Guide:
    """Guide of one block: text, sources and an experiment.

    Parameters
    ----------
    equations : str
        Lines in ASCII, which the page shows as mathematics: `theta_hat_i`, `x'`, `A^T`, `|x|_inf`,
        `a / (b c)` and Greek names. Columns are two spaces or more apart.
    conventions, tuning, limits : tuple of str
        One sentence or a few for each item. The page lists the parameters in the order in which `tuning`
        names them.
    sources : tuple of Source
        Literature and data.
    experiment : Experiment
        Experiment of the reference results.

    Examples
    --------
    >>> guide = Guide(equations="y' = (K u - y) / T", tuning=("Measure gain, then time_constant.",))
    >>> guide.equations
    "y' = (K u - y) / T"
    """

    equations: str = ""
    conventions: tuple[str, ...] = ()
    tuning: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    sources: tuple[Source, ...] = ()
    experiment: Experiment = Experiment()


NO_GUIDE = Guide()
