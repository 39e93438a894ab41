"""Pareto fronts: the error of a law against the total variation of u, within a bound on the delay margin.

    python .ci/fronts.py

searches the laws on three vehicles (`STUDY`) and writes fronts.json and fronts.svg to results/VEHICLE, for
docs/explanation/comparison.md; --plant NAME is for one vehicle, --help shows the options. The journals stay:
the same command continues, and --laws adds laws. --known FILE takes laws that are not searched from
there, and begins others at their points.

Each seed searches the least error under a bound on the total variation, then under half of that bound, and
so on: the epsilon constraint (Haimes, Lasdon and Wismer, IEEE Trans. SMC 1(3), 1971). That is one budget; the
second one is as large and goes the same way back, so that a front after both has twice the evaluations. Each
search begins at the best gains that the seed has evaluated until then: at first the tuned ones, the start
values or those of the law's special cases (`SPECIAL_CASES`). All laws have one step. A front is of the
evaluations that keep every bound and do not fail; those without the delay margin are taken out first.
"""

import json
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Annotated, Any, NamedTuple

import typer
from front_points import VARIATION, front_figure, variation_of
from front_search import LARGEST_ERROR, LEVELS, free_gains, front_of_law, known_gains, margin_of

from fmus.files import write_text_atomically
from orchestration.cli import shared
from orchestration.cli.changes import NO_CHANGES, OF_LOOP, PLANT, Changes, takes_changes
from orchestration.cli.commands import run_application
from orchestration.errors import OrchestrationError
from orchestration.studies.score import tune_problem
from orchestration.studies.score.closed_loop import ClosedLoop, Controller, built_in
from orchestration.studies.score.command import (
    PROCESSORS,
    BoundOption,
    CasesOption,
    ProtocolOption,
    SeedsOption,
    WorkersOption,
    chosen_protocol,
    scored_controllers,
)
from orchestration.studies.score.protocol import Protocol, on_vehicle, read_protocol, with_cost
from orchestration.studies.score.protocol_format import DELAY_MARGIN


class SpecialCase(NamedTuple):
    """A law that another law is, with some gains.

    names: gains of the special case that the other law calls otherwise
    """

    law: str
    gains: Mapping[str, float]
    names: Mapping[str, str] = {}

    def of_law(self, gains: Mapping[str, float]) -> dict[str, float]:
        """Returns gains of the special case as those of the law that contains it."""
        return {**{self.names.get(name, name): value for name, value in gains.items()}, **self.gains}


_NO_PI = {"proportional_gain": 0.0, "integral_gain": 0.0}
# without adaptation the state feedback of the rate and the PI are a PID; the depth's has to be above 0
_NO_L1 = {"depth_feedback_gain": 1e-6, "adaptation_gain": 0.0, "sigma_bound": 0.0, "theta_bound[1]": 0.0}
_OF_PID = {"kp": "proportional_gain", "ki": "integral_gain", "kd": "rate_feedback_gain"}
SPECIAL_CASES: Mapping[str, Sequence[SpecialCase]] = {
    "l1-pi": [SpecialCase("l1", _NO_PI), SpecialCase("pid", _NO_L1, _OF_PID)],
    "l1-nonlinear-p": [SpecialCase("l1", {"large_error_gain": 0.0, "small_error_gain": 0.0})],
    "l1-pi-outside": [SpecialCase("l1-outside", _NO_PI)],
    "pid-rates": [SpecialCase("pid", {"beta": 0.0})],
}
"""Law -> the laws that it is with some of its gains."""
STUDY: Mapping[str, tuple[Mapping[str, float], list[str]]] = {
    "RovDepthPlant": ({}, []),
    "RovHeavePitchPlant": (
        {"plant.thruster_efficiency[2]": 0.9},
        ["nominal", "buoyancy", "hold-step", "hold-sea"],
    ),
    "BlueRov2Plant": ({}, []),
}
"""Vehicle -> its settings, and the cases of the cost in place of the protocol's."""
_TUTORIAL = Path(__file__).parent.parent / "docs" / "tutorials" / "python-controller.md"


def tutorial_mpc(protocol: Protocol, folder: Path) -> dict[str, Any]:
    """Returns a row without a front: the model predictive control of the tutorial, not searched."""
    (program,) = re.findall("```python\n(# mpc.py\n.*?)```", _TUTORIAL.read_text(encoding="utf-8"), re.S)
    path = folder / "mpc.py"
    path.write_text(program, encoding="utf-8")
    with ClosedLoop(Controller("mpc", f"{path}:Mpc"), protocol) as loop:
        (row,) = tune_problem.costs(loop, [{}])
        margin = margin_of(loop, {})
    return {
        "title": "MPC of the tutorial",
        "error": row["error"],
        VARIATION: variation_of(row),
        DELAY_MARGIN: margin,
    }


def fronts_of_vehicle(
    protocol: Protocol,
    laws: Sequence[str],
    seeds: int,
    evaluations: int,
    workers: int,
    out: Path,
    known: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Returns the fronts of laws on the vehicle of a protocol as a document, written after each law.

    known: documents of fronts; the laws of this vehicle that are not named are taken from there, and others
        begin at their points there
    """
    effort = {
        "evaluations_per_gain_bound_and_seed": evaluations,
        "budgets": 2,
        "bounds": LEVELS,
        "seeds": [*range(1, seeds + 1)],
        "step": tune_problem.step_of(built_in(protocol, laws[0]), protocol),
    }
    cost, of_file = protocol.tables.cost.model_dump(), dict[str, Mapping[str, Any]]()
    for given in known:
        if given["vehicle"] == protocol.vehicle.name:
            for name, expected in {"effort": effort, "cost": cost}.items():
                if given[name] != expected:
                    raise OrchestrationError(f"--known: {name} {given[name]}: expected {expected}")
            of_file |= {law["name"]: law for law in given["laws"]}
    kept = of_file.keys() - {*laws}
    special = {case.law for law in laws for case in SPECIAL_CASES.get(law, ())}
    names = [name for name in protocol.controllers if name in {*laws, *special, *kept}]
    gains = sum(len(free_gains(protocol, name)) for name in names if name not in kept)
    found, this_revision = list[Mapping[str, Any]](), revision()
    document = {
        "vehicle": protocol.vehicle.name,
        "settings": dict(protocol.vehicle.settings),
        "protocol": protocol.version,
        "statement": protocol.statement,
        "cost": cost,
        "effort": effort,
        "units": {"error": "cm", VARIATION: "N", DELAY_MARGIN: "s", "step": "s"},
        "hypervolume": f"in decades of both, from {LARGEST_ERROR:g} cm and the bound on the variation",
        "without_front": list[dict[str, Any]](),
        "laws": found,
    }

    def write() -> None:
        found.sort(key=lambda law: [*protocol.controllers].index(law["name"]))
        write_text_atomically(out / "fronts.json", f"{json.dumps(document, indent=1)}\n")

    with shared.progress("fronts", 2 * LEVELS * seeds * evaluations * gains, kept="evaluations") as bar:
        # those that contain others after these
        for name in sorted(names, key=lambda name: name in SPECIAL_CASES):
            if name in kept:
                found.append(of_file[name])
                continue
            (tuned_gains, _) = known_gains(protocol, name, free_gains(protocol, name))
            # gains that the special case does not have are its own choice: they change nothing there
            begin = [
                {**tuned_gains, **case.of_law(point["gains"])}
                for case in (SpecialCase(name, {}), *SPECIAL_CASES.get(name, ()))
                for law in {**of_file, **{one["name"]: one for one in found}}.values()
                if law["name"] == case.law
                for point in law["points"]
            ]
            law = front_of_law(
                protocol,
                name,
                range(1, seeds + 1),
                evaluations,
                workers,
                out / f"{name}.front.jsonl",
                lambda done, _: bar.advance(done),
                begin,
            )
            found.append({**law, "revision": this_revision, "again": name in of_file})
            write()
    # its model has the numbers of the paper's vehicle
    if protocol.vehicle.is_of_base:
        document["without_front"].append(tutorial_mpc(protocol, out))
        write()
    return document


def known_fronts(path: Path) -> list[dict[str, Any]]:
    """Returns the documents of a fronts.json, of this script or of the page."""
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise OrchestrationError(f"--known {path}: {error}: expected a fronts.json") from None
    documents = read if isinstance(read, list) else [read]
    needed = {"vehicle", "cost", "effort", "laws"}
    if not all(isinstance(document, dict) and needed <= document.keys() for document in documents):
        raise OrchestrationError(f"--known {path}: expected a fronts.json, with {', '.join(sorted(needed))}")
    return documents


@takes_changes(**OF_LOOP)
def main(
    laws: Annotated[str, typer.Option(metavar="NAME,...", help="Search the fronts of these laws only.")] = "",
    bounds: BoundOption = [],  # noqa: B006  (Typer copies it)
    cases: CasesOption = "",
    seeds: SeedsOption = 5,
    evaluations: Annotated[
        int,
        typer.Option(
            metavar="NUMBER",
            help="Evaluations for each free gain, each seed, each bound and each of two budgets.",
            min=1,
        ),
    ] = 100,
    workers: WorkersOption = PROCESSORS,
    out: shared.OutFolder = Path("results"),
    known: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Take laws from this fronts.json, or begin at their points."),
    ] = None,
    changes: Changes = NO_CHANGES,
    protocol_file: ProtocolOption = None,
) -> None:
    """Search each law's Pareto front of error and total variation; write fronts.json and fronts.svg.

    They are of three vehicles, or of the one that --plant names. The same command continues.
    """
    scored_controllers([], False, changes)
    shared.check_writable(out)
    options = tune_problem.cost_of_options(bounds, cases)
    for vehicle in [changes.components[PLANT]] if PLANT in changes.components else STUDY:
        settings, of_study = STUDY.get(vehicle, ({}, []))
        # the base's own vehicle is that of the protocol
        is_other = vehicle != read_protocol().vehicle.name
        given = replace(changes, settings={PLANT: vehicle, **settings, **changes.settings})
        protocol = chosen_protocol(given if is_other else NO_CHANGES, protocol_file)
        protocol = with_cost(on_vehicle(protocol), {"cases": of_study} if of_study else {})
        protocol = with_cost(protocol, options)
        names = [built_in(protocol, n).name for n in tune_problem.listed(laws) or protocol.controllers]
        folder = out / vehicle
        folder.mkdir(parents=True, exist_ok=True)
        documents = known_fronts(known) if known else []
        document = fronts_of_vehicle(protocol, names, seeds, evaluations, workers, folder, documents)
        figures = front_figure({vehicle: document["laws"]}, folder / "fronts")
        for law in document["laws"]:
            word = "converged" if law["is_converged"] else "not converged"
            print(f"{law['title']}: hypervolume {median(law['hypervolumes']):.3g}, {word}")
        print(*(folder / "fronts.json", *figures), sep="\n")


def revision() -> str:
    """Returns the last commit of the packages that run, with "-dirty" if they differ from it."""
    root = Path(__file__).parent.parent
    packages = [
        "--",
        *(str(root / name) for name in ("controller_fmu", "fmus", "orchestration", "plant_fmu")),
    ]

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(root), *arguments, *packages]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    return git("log", "-1", "--format=%h", "--abbrev=12") + ("-dirty" if git("status", "--porcelain") else "")


def application() -> typer.Typer:
    """Returns the command line of this script."""
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(main)
    return app


if __name__ == "__main__":
    sys.exit(run_application(application, sys.argv[1:], Path(__file__).name))
