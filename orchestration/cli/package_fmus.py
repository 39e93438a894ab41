"""FMUs that are built for a package: sources of signals, and FMUs that start with a scenario's values."""

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, make_dataclass, replace
from pathlib import Path

from fmus.block import Block, NoValues, variable
from fmus.block.guide import Experiment, Guide
from fmus.block.scalars import unflatten
from fmus.block.variables import Value, restarted
from fmus.errors import ExportError, nearest
from fmus.fmi.variable_types import FmiValue
from fmus.generate import builder
from fmus.numerics import ramps
from fmus.platforms import PLATFORMS
from fmus.registry import Flavour, block_fmus
from fmus.units import si_unit
from orchestration.exchange.limits import RampSource


def build_ramp_source(source: RampSource, folder: Path) -> Path:
    """Writes the FMU of a source to a folder, for the platforms of the FMU that it drives.

    Its output has no unit where the input's is no product of SI units: its values are then in that unit too.
    """
    known = si_unit(source.unit)
    unit = source.unit if known and (known.factor, known.offset) == (1.0, 0.0) else None
    block = ramp_source(f"Ramps_{source.name}", source.name, unit, source.points)
    block = with_start_values(block, source.starts)
    return builder.build_block(block, folder, platforms=_platforms(source.driven))


def build_started(fmu: Path, starts: Mapping[str, FmiValue], folder: Path) -> Path:
    """Writes the FMU with other start values to a folder and returns it.

    Returns the FMU itself if it is no native one of an installed block: the python flavour carries the
    modules of its block, which state the start values.
    """
    known = block_fmus([fmu])
    numbers = {name: value for name, value in starts.items() if not isinstance(value, str)}
    if not known or not numbers:
        return fmu
    ((name, flavour),) = known
    if flavour is not Flavour.NATIVE:
        return fmu
    block = with_start_values(builder.load_block(name), numbers)
    return builder.build_block(block, folder, platforms=_platforms(fmu))


def _platforms(fmu: Path) -> Sequence[str]:
    with zipfile.ZipFile(fmu) as archive:
        names = archive.namelist()
    return [p for p in PLATFORMS if any(name.startswith(f"binaries/{p}/") for name in names)]


def ramp_source(name: str, output: str, unit: str | None, points: int) -> Block:
    """Returns a block without inputs whose output follows ramps through given points, in any unit.

    It takes the place of a signal. Its parameters are smooth, point_time[i] and point_value[i].

    output: an identifier
    unit: of the output and of point_value, one that `fmus.block.units` defines; None for no unit
    points: how many, at least 2; their times start at 0, 1, 2, ... s, their values at 0
    """

    @dataclass(frozen=True)
    class Parameters:
        internal_step: float = variable(
            10.0,
            "Longest internal step; without effect, the output follows from the time alone",
            unit="s",
            min=1e-7,
            max=1e6,
            variability="fixed",
        )
        smooth: bool = variable(
            False, "Quintic ramps, with zero first and second derivatives at both ends, not straight ones"
        )
        point_time: tuple[float, ...] = variable(
            tuple(float(i) for i in range(points)),
            "Time of a point, later than the time before",
            unit="s",
            min=-1e9,
            max=1e9,
        )
        point_value: tuple[float, ...] = variable((0.0,) * points, "Value at a point", unit=unit)

    value = variable(0.0, "Value of the ramps at this time", unit=unit)
    outputs = make_dataclass("Outputs", [(output, float, value)], frozen=True)

    def requirements(p: Parameters, calculated: NoValues) -> tuple:
        return tuple(
            (p.point_time[i] < p.point_time[i + 1], f"point_time[{i + 2}] later than point_time[{i + 1}]")
            for i in range(points - 1)
        )

    return Block(
        name=name,
        description=f"Ramps through {points} points",
        parameters=Parameters,
        outputs=outputs,
        requirements=requirements,
        output=lambda t, state, p, calculated: outputs(ramps(t, p.point_time, p.point_value, p.smooth)),
        stop_time=float(points - 1),
        step_size=0.1,
        guide=_GUIDE,
    )


_GUIDE = Guide(
    equations="""\
y(t) = y_i + (y_i+1 - y_i) f(s),   s = (t - t_i) / (t_i+1 - t_i)   between two points
f(s) = s                            smooth false
       10 s^3 - 15 s^4 + 6 s^5      smooth true
""",
    conventions=("The first value holds before the first point, the last one after the last.",),
    tuning=("Spare points of point_time come after the last needed one; their point_value is its value.",),
    experiment=Experiment(step_size=0.1),
)


def with_start_values(block: Block, values: Mapping[str, Value]) -> Block:
    """Returns the block with other start values of some parameters and inputs.

    values: name of a scalar, such as "gain" or "A[1,2]" -> value in the unit of the variable
    Raises ExportError for a name that is no parameter or input, and for a value that it does not accept.
    """
    settable = {v.name: v for v in block.variables if v.settable}
    for name, value in values.items():
        if name not in settable:
            raise ExportError(
                f"block {block.name!r}: no parameter or input {name!r}; {nearest(name, settable)}"
            )
        if reason := settable[name].refuse(value):
            raise ExportError(f"block {block.name!r}: start value {reason}")
    starts = [v.cast(values.get(name, v.start)) for name, v in settable.items()]
    count = len(block.of_causality("parameter"))
    return replace(
        block,
        parameters=_started(block.parameters, starts[:count]),
        inputs=_started(block.inputs, starts[count:]),
    )


def _started(cls: type, starts: list[Value]) -> type:
    """Returns a class of the same variables that start with these scalars, row by row."""
    started = unflatten(cls, starts)
    return restarted(cls, {member.name: getattr(started, member.name) for member in fields(cls)})
