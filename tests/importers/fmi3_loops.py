"""A closed loop of FMUs of either standard in Ecos, and in a container FMU of fmucontainer."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import numpy as np

from fmus.fmi.process import Parent

STEP = 0.02  # s
Link = tuple[str, str]  # "component.variable"


@dataclass(frozen=True)
class Loop:
    """FMUs by component, connections between them, and the output that is reported at each step."""

    fmus: dict[str, Path]
    links: tuple[Link, ...]
    output: str
    steps: int


def run_in_ecos(parent: Parent) -> None:
    """Runs the loop that is sent through `ecospy`; sends the output's values, the one at the start first."""
    from ecospy.EcosSimulation import EcosSimulation
    from ecospy.EcosSimulationStructure import EcosSimulationStructure

    loop: Loop = parent.receive()
    structure = EcosSimulationStructure()
    for component, path in loop.fmus.items():
        structure.add_model(component, str(path))
    for link in loop.links:
        structure.make_real_connection(*(end.replace(".", "::", 1) for end in link))
    output = loop.output.replace(".", "::", 1)
    with EcosSimulation(structure=structure, step_size=STEP) as simulation:
        assert simulation.init()
        values = [simulation.get_real(output)]
        for _ in range(loop.steps):
            simulation.step()
            values.append(simulation.get_real(output))
    parent.send(np.array(values))


def run_in_container(parent: Parent) -> None:
    """Puts the loop that is sent, with a version of FMI, into a container FMU of it, which FMPy runs."""
    from fmu_manipulation_toolbox.assembly import Assembly, AssemblyNode

    loop, version = parent.receive()
    with TemporaryDirectory() as folder:
        assembly = Assembly(fmu_directory=Path(folder))
        node = AssemblyNode("loop.fmu", step_size=STEP, auto_link=False, auto_input=False, auto_output=False)
        assembly.root = node
        for path in loop.fmus.values():
            node.add_fmu(str(path))

        def port(end: str) -> tuple[str, str]:
            component, _, variable = end.partition(".")
            return str(loop.fmus[component]), variable

        for source, target in loop.links:
            node.add_link(*port(source), *port(target))
        node.add_output(*port(loop.output), "output")
        assembly.make_fmu(fmi_version=version)
        result = fmpy.simulate_fmu(
            str(Path(folder, "loop.fmu")),
            stop_time=loop.steps * STEP,
            step_size=STEP,
            output_interval=STEP,
            output=["output"],
        )
    parent.send(result["output"])
