"""What FMI costs around one step of a block: through an FMU's functions, and the same C without them."""

from dataclasses import dataclass
from statistics import median

from fmus.build import builder
from fmus.platforms import host_platform
from tests.speed.programs import (
    C_SOURCES,
    compile_equations,
    compile_program,
    extracted,
    output_of,
    part_name,
    workplace,
)


@dataclass(frozen=True)
class Layer:
    """One communication step of a block through FMI, all inputs set and outputs read, and without FMI [s]."""

    block: str
    through_fmi: float
    bare: float


def layer(name: str, steps: int = 200_000, rounds: int = 7) -> Layer:
    """A block measured, medians over rounds in which the two take turns."""
    step = builder.load_block(name).step_size
    with workplace() as folder:
        _, library = extracted(builder.build_if_stale(name), folder, host_platform())
        compile_equations(folder, 0, folder / "sources")
        compile_program(
            folder,
            "bare",
            [part_name(0), str(C_SOURCES / "bare.c"), "part0.o"],
            includes=[folder / "sources"],
        )
        lines = output_of(folder, "bare", library, step, steps, rounds)
    fmi, bare = zip(*(map(float, line.split()) for line in lines), strict=True)
    return Layer(name, median(fmi) / steps, median(bare) / steps)
