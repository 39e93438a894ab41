"""The run of a scenario in two states of this project, in turns: `python -m tests.speed.runs OLD [NEW]`.

All of `Simulator.run`: reset, parameters, initialisation, steps, recording; with FMUs and the compiled loop
of each state. Each is a git revision or a clone.
"""

import subprocess
from statistics import median
from typing import Annotated

import typer

from tests.speed.programs import workplace
from tests.speed.states import ROOT, python, sources

_PROGRAM = """
import hashlib, sys, time
from fmus import catalogue
from orchestration.master import Simulator
from orchestration.scenarios import scenario
chosen = scenario.load(scenario.find(sys.argv[1]))
catalogue.build_missing([*chosen.system.components.values()])
with Simulator(chosen.system) as simulator:
    simulator.run(chosen.experiment)
    print("ready", flush=True)
    for line in sys.stdin:
        start = time.thread_time()
        for _ in range(int(line)):
            recording = simulator.run(chosen.experiment)
        seconds = (time.thread_time() - start) / int(line)
        print(seconds, hashlib.sha256(recording.values.tobytes()).hexdigest(), flush=True)
"""


def _turn(process: "subprocess.Popen[str]", runs: int) -> tuple[float, str]:
    """Seconds of CPU of a run, and what tells its recording from others."""
    assert process.stdin
    assert process.stdout
    process.stdin.write(f"{runs}\n")
    process.stdin.flush()
    seconds, recording = process.stdout.readline().split()
    return float(seconds), recording


def main(
    old: Annotated[str, typer.Argument(help="Revision, or folder of a clone.")],
    new: Annotated[str, typer.Argument(help="The same; by default this clone.")] = str(ROOT),
    scenario: Annotated[str, typer.Option(help="A shipped scenario.")] = "nominal-extended",
    rounds: Annotated[int, typer.Option(help="Of which the median is taken.", min=1)] = 41,
    runs: Annotated[int, typer.Option(help="Of each state in a round.", min=1)] = 3,
) -> None:
    """Compare the runs of a scenario."""
    with workplace() as folder:
        processes = []
        for name, state in (("old", old), ("new", new)):
            (folder / name).mkdir()
            processes.append(python(_PROGRAM, sources(state, folder / name), folder / name, scenario))
        try:
            for process in processes:
                assert process.stdout
                assert process.stdout.readline() == "ready\n", "it did not start"
            turns = [[_turn(process, runs) for process in processes] for _ in range(rounds)]
        finally:
            for process in processes:
                process.communicate()
    ratios = sorted(second / first for (first, _), (second, _) in turns)
    first, second = (1e3 * median(turn[i][0] for turn in turns) for i in (0, 1))
    spread = f"{ratios[len(ratios) // 4]:.3f} to {ratios[-1 - len(ratios) // 4]:.3f}"
    print(f"{scenario}: {first:.2f} ms before, {second:.2f} ms now, ratio {median(ratios):.3f} ({spread})")
    are_equal = len({recording for turn in turns for _, recording in turn}) == 1
    print(f"the recordings are {'equal bit for bit' if are_equal else 'different'}")


if __name__ == "__main__":
    typer.run(main)
