"""Whole commands, from the start of their process to its end, beside the same loop in other importers.

All take turns, so that they see the same machine. What a command does once comes before: the FMUs of
scenarios, and the compiler's own libraries for each platform. A build anew finds neither FMUs nor anything of
them that was compiled.
"""

import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from fmus.build import builder
from fmus.platforms import PLATFORMS, host_platform
from orchestration.errors import OrchestrationError
from orchestration.scenarios import scenario
from tests.importers.comparison import packaged
from tests.importers.importers import ImporterJob
from tests.speed.part import Goal, Options, Part, Table, spread
from tests.speed.states import COMMAND, FIVE, State

SCENARIO = "nominal-extended"
FIRST_RUN = """
from orchestration import System, simulate
system = System({{"controller": "{fmus}/L1DepthController.fmu", "plant": "{fmus}/RovDepthPlant.fmu"}}, [
    ("controller.voltage[1]", "plant.voltage[1]"), ("controller.voltage[2]", "plant.voltage[2]"),
    ("plant.measured_depth", "controller.measured_depth")])
simulate(system, stop_time=10.0, step_size=0.02, open_inputs="start")
"""
ECOS = """
from ecospy.EcosSimulation import EcosSimulation
with EcosSimulation(ssp_path={package!r}, step_size={step!r}) as simulation:
    simulation.init(0.0)
    simulation.step({count})
"""
LIBCOSIM = """
from libcosimpy.CosimExecution import CosimExecution
CosimExecution.from_ssp_file({package!r}, {nanoseconds}).step({count})
"""
FMPY = """
from fmpy.ssp.simulation import simulate_ssp
simulate_ssp({package!r}, 0.0, {stop!r}, {step!r})
"""
OTHERS = {"Ecos": ECOS, "libcosim": LIBCOSIM, "FMPy": FMPY}
RUN = f"`l1-depth run {SCENARIO} --formats none`: recording, metrics, provenance"
FIGURE = f"`l1-depth run {SCENARIO}`, with its figure"
HELP, FIRST = "`l1-depth --help`", "`from orchestration import System, simulate`, a first `simulate`"
REPRODUCE, CHECK = "`l1-depth reproduce`, with its figures", "`l1-depth check` of one FMU"
BUILD, AGAIN = "`l1-depth build` of five FMUs, anew", "the same again, nothing changed"
ALL_PLATFORMS = "the same for all platforms"
TARGETS_S = {
    RUN: 0.4,
    FIGURE: 1.0,
    HELP: 0.3,
    FIRST: 0.35,
    REPRODUCE: 5.0,
    BUILD: 4.0,
    ALL_PLATFORMS: 15.0,
    AGAIN: 0.3,
    CHECK: 1.5,
}
_QUICK = {RUN, HELP, FIRST, BUILD, CHECK}


@dataclass
class Command:
    """What is timed: its times so far [s], on the wall clock and of all processors together."""

    name: str
    arguments: Sequence[str]
    state: State
    environment: Mapping[str, str] | None = None
    prepare: Callable[[], object] = lambda: None
    remark: str = ""
    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)

    def measure(self) -> None:
        """Run it once; OrchestrationError if it fails."""
        self.prepare()
        wall_s, cpu_s = self.state.timed(self.arguments, environment=self.environment)
        self.wall.append(wall_s)
        self.cpu.append(cpu_s)


def commands(state: State) -> Iterator[Command]:
    """The commands of a state."""
    fmus = state.fmus
    run, none = (*COMMAND, "run", SCENARIO, "--out", "results"), ("--formats", "none")
    remark = "" if _succeeds((*run, *none), state) else "with its figure: it could not be left out"

    def command(name: str, *arguments: str) -> Command:
        return Command(name, arguments, state)

    yield Command(RUN, run if remark else (*run, *none), state, remark=remark)
    yield command(FIGURE, *run)
    yield command(HELP, *COMMAND, "--help")
    yield command(FIRST, sys.executable, "-P", "-c", FIRST_RUN.format(fmus=fmus))
    yield command(REPRODUCE, *COMMAND, "reproduce", "--out", "results")
    yield command(AGAIN, *COMMAND, "build", *FIVE, "--out", str(fmus))
    yield command(CHECK, *COMMAND, "check", str(fmus / "L1DepthController.fmu"))


def builds(state: State, platforms: Sequence[str]) -> Iterator[Command]:
    """Builds of five FMUs from nothing but the compiler's own libraries, which are there for platforms."""
    environment = {**state.environment, "XDG_CACHE_HOME": f"{state.folder}/anew"}

    def forget() -> None:
        for path in (state.folder / "anew", state.folder / "built"):
            shutil.rmtree(path, ignore_errors=True)
        _restore_libraries(state, platforms)

    build = (*COMMAND, "build", *FIVE, "--out", "built")
    yield Command(BUILD, build, state, environment, forget)
    yield Command(ALL_PLATFORMS, (*build, "--all-platforms"), state, environment, forget)


def _succeeds(arguments: Sequence[str], state: State) -> bool:
    try:
        state.timed(arguments)
    except OrchestrationError:
        return False
    return True


def _restore_libraries(state: State, platforms: Sequence[str]) -> None:
    """Leave nothing in the compiler's cache but its own libraries, which are made when they are missing.

    They are made where they are used, as Zig finds them by their paths.
    """
    cache = Path(state.environment["ZIG_GLOBAL_CACHE_DIR"])
    libraries = cache.with_name("libraries")
    shutil.rmtree(cache, ignore_errors=True)
    if not libraries.exists():
        state.output_of("zig_libraries.py", *platforms)
        shutil.move(cache, libraries)
    shutil.copytree(libraries, cache, symlinks=True)


def _of_importers(job: ImporterJob, state: State) -> list[Command]:
    """The same loop in other importers, which write nothing."""
    times = {"step": job.step_size, "stop": job.stop_time, "nanoseconds": round(job.step_size * 1e9)}
    values = {"package": str(job.package), "count": job.reports, **times}
    return [
        Command(name, (sys.executable, "-c", text.format(**values)), state) for name, text in OTHERS.items()
    ]


def measure(options: Options) -> Part:
    """All commands of each state by turns, after a round that does not count."""
    chosen = scenario.load(scenario.find(SCENARIO))
    builder.build_missing(chosen.system.components.values())
    own = [_of_state(state, options) for state in options.states]
    others = _of_importers(packaged(chosen, options.folder), options.now)
    everything = [*others, *(command for of_state in own for command in of_state.values())]
    for turn in range(options.rounds(4)):
        for command in everything:
            if turn == 1:  # what is built and compiled to bytecode once was in the turn before
                command.wall.clear()
                command.cpu.clear()
            if turn or options.quick or command.name != ALL_PLATFORMS:  # long, and like the build before it
                command.measure()
    now, before = own[-1], own[0] if options.before else {}
    rows = [(name, *_times(before.get(name)), *_times(now[name])) for name in now]
    rows += [(f"the same loop in {c.name}, nothing written", "", "", *_times(c)) for c in others]
    headings = ("command", "before, s", "its CPU, s", "now, s", "its CPU, s")
    return Part([Table("commands", headings, rows)], _goals(now, before, others))


def _of_state(state: State, options: Options) -> dict[str, Command]:
    """Name -> command, in the order of the table."""
    platforms = [host_platform()] if options.quick else PLATFORMS
    chosen = {command.name: command for command in [*commands(state), *builds(state, platforms)]}
    return {name: chosen[name] for name in TARGETS_S if not options.quick or name in _QUICK}


def _goals(now: Mapping[str, Command], before: Mapping[str, Command], others: list[Command]) -> list[Goal]:
    peers = ", ".join(f"{c.name} {median(c.wall):.2f} s" for c in others)
    return [
        Goal(
            name,
            f"{TARGETS_S[name]:g} s",
            f"{median(command.wall):.2f} s",
            _with_remark(f"{median(before[name].wall):.2f} s", before[name]) if before else "",
            f"{peers}, which write nothing" if name == RUN else "",
        )
        for name, command in now.items()
    ]


def _times(command: Command | None) -> tuple[str, str]:
    """On the clock, and of all processors."""
    if not command:
        return "", ""
    return _with_remark(spread(command.wall), command), spread(command.cpu)


def _with_remark(text: str, command: Command) -> str:
    return f"{text}, {command.remark}" if command.remark else text
