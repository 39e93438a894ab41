"""Runs on a device: random blocks, metrics, refusals, and what NVRTC, the compiler of a GPU, says."""

import ctypes
import importlib
import importlib.util
import random
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fmus import numerics as n
from fmus.block import Block, variable
from fmus.errors import MissingExtraError
from orchestration import Ensemble, Experiment, Simulator, System, load_scenario, run_many
from orchestration.errors import EnsembleError, SystemDefinitionError
from orchestration.many import job
from orchestration.many.places import place_of
from orchestration.places import gpu
from orchestration.results.metrics import evaluate
from orchestration.results.recording import Recording, on_host
from orchestration.sweep import table
from orchestration.sweep.plan import plan
from orchestration.sweep.run import sweep
from tests.orchestration.many.instances import assert_same_bits, built_for_ensembles, instances
from tests.orchestration.places.host_device import HostDevice
from tests.shared_builds import KINDS

Numbers = Sequence[Any]
Term = Callable[[Numbers], Any]
_ONE = (
    n.sin,
    n.cos,
    n.exp,
    n.tanh,
    n.atan,
    n.floor,
    n.sign,
    abs,
    lambda x: n.sqrt(abs(x)),
    lambda x: n.log1p(x * x),
)
_TWO = (
    lambda x, y: x + y,
    lambda x, y: x - y,
    lambda x, y: x * y,
    lambda x, y: x / (1.0 + y * y),
    n.minimum,
    n.maximum,
    n.hypot,
    n.atan2,
    n.copysign,
    lambda x, y: n.fmod(x, 1.0 + abs(y)),
)
_SIZE = 3  # numbers of the parameters, inputs, states and outputs of a random block


@dataclass(frozen=True)
class Parameters:
    a: tuple[float, ...] = variable((0.5,) * _SIZE, "Numbers")


@dataclass(frozen=True)
class Inputs:
    u: tuple[float, ...] = variable((0.1,) * _SIZE, "Numbers")


@dataclass(frozen=True)
class State:
    x: tuple[float, ...] = (0.3,) * _SIZE


@dataclass(frozen=True)
class Outputs:
    y: tuple[float, ...] = variable((0.0,) * _SIZE, "Numbers")


def term(rng: random.Random, depth: int) -> Term:
    """A random expression; depth: of functions within functions, of which some choose between two."""
    kind = rng.random() if depth else 1.0
    if kind < 0.3:
        function, x = rng.choice(_ONE), term(rng, depth - 1)
        return lambda v: function(x(v))
    if kind < 0.75:
        of_two, x, y = rng.choice(_TWO), term(rng, depth - 1), term(rng, depth - 1)
        return lambda v: of_two(x(v), y(v))
    if kind < 0.9:
        low, x, first, second = (term(rng, depth - 1) for _ in range(4))
        return lambda v: n.where(x(v) > low(v), lambda: first(v), lambda: second(v))
    place, constant = rng.randrange(4 * _SIZE), rng.uniform(-2.0, 2.0)
    return lambda v: v[place] if place < len(v) else constant


def random_block(number: int) -> Block:
    rng = random.Random(number)
    steps, outputs = ([term(rng, 4) for _ in range(_SIZE)] for _ in range(2))
    return Block(
        f"Random{number}",
        "Random functions of numbers",
        parameters=Parameters,
        inputs=Inputs,
        state=State,
        outputs=Outputs,
        step=lambda t, h, s, u, p, c: State(tuple(n.tanh(f((*s.x, *u.u, *p.a))) for f in steps)),
        output=lambda t, s, p, c: Outputs(tuple(f((*s.x, *p.a)) for f in outputs)),
        step_size=0.1,
    )


@pytest.mark.slow
def test_random_blocks_have_the_bits_of_single_runs(tmp_path: Path) -> None:
    """As the components of one system; no instance fails, and the blocks are no constants."""
    blocks = map(random_block, range(30))
    components = {block.name: built_for_ensembles(tmp_path, block) for block in blocks}
    draw = np.random.default_rng(3)
    names = [f"{name}.{kind}[{i}]" for name in components for kind in "au" for i in range(1, _SIZE + 1)]
    vary: dict[str, Any] = {name: draw.normal(0.0, 1.5, 3).tolist() for name in names}
    experiment = Experiment(2.0, 0.1, open_inputs="start")
    experiments = instances(experiment, vary, [name for name in names if ".u[" in name])
    system = System(components)
    with Ensemble(system, device=HostDevice()) as ensemble, Simulator(system) as simulator:
        recorded = ensemble.run(experiments)
        assert_same_bits(recorded, simulator, experiments)
    assert not recorded.failures
    moving = np.ptp(on_host(recorded.values), axis=1) > 0.0
    assert (moving.sum(axis=1) > 30).all()  # of 90 outputs


@pytest.fixture
def on_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """The processor stands for the GPU."""
    monkeypatch.setattr(gpu, "gpu", HostDevice)


def all_metrics(runs: Recording) -> list[Any]:
    """The metrics of the nominal scenario, and what is drawn: a result of numbers for each run."""
    measured = evaluate(runs, load_scenario("nominal-extended").metrics)
    return [{name: column[i] for name, column in measured.items()} for i in range(len(runs.values))]


@pytest.mark.slow
@pytest.mark.usefixtures("on_device", "vehicle_fmus")
def test_metrics_on_a_device_are_those_of_the_processor() -> None:
    scenario = load_scenario("nominal-extended")
    experiments = [
        replace(scenario.experiment, parameters={**scenario.experiment.parameters, "plant.inertia": inertia})
        for inertia in (5.0, 5.5, 7.0)
    ]
    here, there = (
        list(run_many(scenario.system, experiments, reduce=all_metrics, where=where))
        for where in ("vectors", "gpu")
    )
    assert there == here
    assert len({*map(repr, here)}) == 3


@pytest.mark.slow
@pytest.mark.usefixtures("on_device", "vehicle_fmus")
def test_a_sweep_on_a_device_has_the_rows_of_the_processor(tmp_path: Path) -> None:
    scenario = load_scenario("monte-carlo")
    planned = plan(replace(scenario, sweep={**scenario.sweep, "samples": 20}))
    notes = list[str]()
    tables = [
        table.read(sweep(planned, tmp_path / where, place_of(where, note=notes.append)))[0]
        for where in ("vectors", "gpu")
    ]
    assert tables[0].equals(tables[1])
    assert notes[-1] == "the host"


@pytest.mark.usefixtures("on_device", "vehicle_fmus")
def test_a_run_that_fails_on_a_device_is_named_and_the_others_go_on() -> None:
    scenario = load_scenario("nominal-extended")
    parameters = scenario.experiment.parameters
    experiments = [
        replace(scenario.experiment, parameters={**parameters, "plant.initial_depth": depth})
        for depth in (0.0, 1e300, 0.1)
    ]
    results = list(run_many(scenario.system, experiments, where="gpu"))
    assert [isinstance(result, job.Failure) for result in results] == [False, True, False]
    assert "t = " in results[1].reason


@pytest.mark.usefixtures("on_device", "vehicle_fmus")
@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"where": "gpu", "timeout": 3.0}, "the host ends no run: expected no timeout, got 3 s"),
        ({"where": "gpu", "workers": 2}, "gpu with 2 workers: expected gpu alone"),
        ({"where": "gpu:1"}, "gpu:1: expected gpu alone"),
    ],
)
def test_what_a_device_does_not_have_is_refused_before_a_run(settings: dict[str, Any], problem: str) -> None:
    scenario = load_scenario("nominal-extended")
    with pytest.raises(EnsembleError, match=problem):
        next(run_many(scenario.system, [scenario.experiment], **settings))


def test_the_memory_of_an_ensemble_is_that_of_its_rows_its_varied_signals_and_its_instances() -> None:
    prepared: Any = SimpleNamespace(shape=(11, 3))
    libraries = {"a": SimpleNamespace(words=7), "b": SimpleNamespace(words=5)}
    assert gpu.DeviceLoop.words(prepared, libraries, 4, varied=2) == 4 * (11 * (3 + 2) + 7 + 5)


def test_more_than_the_memory_of_the_device_is_refused(
    system: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(HostDevice, "free_bytes", lambda _: 2**15)
    with (
        Ensemble(system, device=HostDevice()) as ensemble,
        pytest.raises(SystemDefinitionError, match=r"9 instances of .* of the device; .* fewer instances"),
    ):
        ensemble.run([Experiment(4.0, 0.02, open_inputs="start")] * 9)


@pytest.mark.usefixtures("vehicle_fmus")
def test_without_a_gpu_one_sentence_says_what_is_missing() -> None:
    scenario = load_scenario("nominal-extended")
    error = EnsembleError if importlib.util.find_spec("cupy") else MissingExtraError
    with pytest.raises(error, match=r"^no GPU: .*processor|runs on a GPU needs? cupy: pip install"):
        next(run_many(scenario.system, [scenario.experiment], where="gpu"))


class CompileError(Exception):
    """As CuPy's."""


class DriverError(Exception):
    """As CuPy's."""


def fake_cupy(problem: Exception | None, launches: list[tuple[Any, ...]]) -> Any:
    """What `Gpu` takes of CuPy: a count of devices, and a module whose functions note their launches."""

    def module(code: str, options: Sequence[str]) -> Any:
        def function(name: str) -> Any:
            if isinstance(problem, CompileError):
                raise problem
            return lambda *launch: launches.append((code, tuple(options), name, *launch))

        return SimpleNamespace(get_function=function)

    def count() -> int:
        if isinstance(problem, DriverError):
            raise problem
        return 1

    runtime = SimpleNamespace(getDeviceCount=count, CUDARuntimeError=DriverError)
    compiler = SimpleNamespace(CompileException=CompileError)
    return SimpleNamespace(RawModule=module, cuda=SimpleNamespace(runtime=runtime, compiler=compiler))


@pytest.mark.parametrize(
    ("problem", "message"),
    [
        (DriverError("cudaErrorNoDevice"), "^no GPU: cudaErrorNoDevice; the processor makes"),
        (
            CompileError("program.cu(3): error: x\nmore"),
            r"^FMUs do not compile for the GPU: program\.cu\(3\): er",
        ),
    ],
)
def test_what_is_wrong_with_the_gpu_is_one_line(
    problem: Exception, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cupy", fake_cupy(problem, []))
    with pytest.raises(EnsembleError, match=message) as error:
        gpu.Gpu().kernels("code")
    assert "\n" not in str(error.value)


def test_a_kernel_is_launched_with_a_thread_for_each_instance(monkeypatch: pytest.MonkeyPatch) -> None:
    """In blocks of 128, the last of which may be a part: device.h leaves out what is beyond."""
    launches = list[tuple[Any, ...]]()
    monkeypatch.setitem(sys.modules, "cupy", fake_cupy(None, launches))
    gpu.Gpu().kernels("code")["run"](4711, 257, 3, 9)
    assert launches == [("code", gpu.OPTIONS, "ensemble_run_all", (3,), (128,), (4711, 257, 3, 9))]


@pytest.mark.slow
def test_the_compiler_of_gpus_takes_blocks_of_each_kind(built: Mapping[str, Path]) -> None:
    """NVRTC compiles for a virtual architecture without a GPU; our options are those of `Gpu`."""
    text = gpu.program([built[name] for name in KINDS])
    code = nvrtc(text, [*gpu.OPTIONS, "--gpu-architecture=compute_80"])
    for name in gpu.KERNELS:
        assert f".entry ensemble_{name}_all" in code


def nvrtc(program: str, options: Sequence[str]) -> str:
    """Returns the PTX of a program; its log is the error where the compiler refuses it."""
    folder = Path(next(iter(importlib.import_module("nvidia.cuda_nvrtc").__path__)), "lib")
    library = ctypes.CDLL(str(next(folder.glob("libnvrtc.so.*"))))
    handle = ctypes.c_void_p()
    arguments = [option.encode() for option in options]
    assert not library.nvrtcCreateProgram(
        ctypes.byref(handle), program.encode(), b"program.cu", 0, None, None
    )
    status = library.nvrtcCompileProgram(
        handle, len(arguments), (ctypes.c_char_p * len(arguments))(*arguments)
    )
    assert not status, _text(library.nvrtcGetProgramLogSize, library.nvrtcGetProgramLog, handle)
    return _text(library.nvrtcGetPTXSize, library.nvrtcGetPTX, handle)


def _text(size_of: Any, text_of: Any, handle: ctypes.c_void_p) -> str:
    size = ctypes.c_size_t()
    size_of(handle, ctypes.byref(size))
    text = ctypes.create_string_buffer(size.value)
    text_of(handle, text)
    return text.value.decode()
