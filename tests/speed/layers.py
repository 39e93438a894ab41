"""What FMI costs around one step of a block: through an FMU's functions, and the same C without them."""

import zipfile
from dataclasses import dataclass
from statistics import median

from fmus import catalogue
from fmus.platforms import host_platform, library_name
from tests.speed import monolith
from tests.speed.programs import C_SOURCES, compile_equations, compile_program, output_of, workplace


@dataclass(frozen=True)
class Layer:
    """One communication step of a block through FMI, all inputs set and outputs read, and without FMI [s]."""

    block: str
    through_fmi: float
    bare: float


def layer(name: str, steps: int = 200_000, rounds: int = 7) -> Layer:
    """A block measured, medians over rounds in which the two take turns."""
    step = catalogue.load_block(name).step_size
    with workplace() as folder:
        path = catalogue.build_if_stale(name)
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder)
        compile_equations(folder, 0, folder / "sources")
        named = f"-DPART(f)={monolith.part(0, '##f')}"
        compile_program(
            folder, "bare", [named, str(C_SOURCES / "bare.c"), "part0.o"], includes=[folder / "sources"]
        )
        library = folder / library_name(name, host_platform())
        lines = output_of(folder, "bare", library, step, steps, rounds)
    fmi, bare = zip(*(map(float, line.split()) for line in lines), strict=True)
    return Layer(name, median(fmi) / steps, median(bare) / steps)
