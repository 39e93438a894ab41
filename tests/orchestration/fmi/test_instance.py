"""An instance is always freed, warns where it should, and its errors survive a process boundary."""

import contextlib
import math
import pickle
import signal
import tempfile
import threading
import time
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from fmus.binding import Library
from orchestration.errors import FmuError, FmuWarning, SimulationError, SystemDefinitionError
from orchestration.fmi.description import describe
from orchestration.fmi.instance import FmuInstance
from orchestration.master import simulate
from orchestration.master.checkpoint import Checkpoints, read_checkpoint
from orchestration.master.interrupt import deferred_interrupt
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment
from orchestration.system.signals import Constant
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import coupled

Build = Callable[..., Path]


class Spy(Library):
    """A library that counts the calls that it passes on."""

    def __init__(self, library: Library) -> None:
        self._library = library
        self.calls: list[str] = []

    def __getattr__(self, name: str) -> Any:
        if name in ("fmi2Terminate", "fmi2FreeInstance"):
            self.calls.append(name)
        return getattr(self._library, name)


def load(path: Path, name: str = "it") -> FmuInstance:
    return FmuInstance(name, path, describe(path))


def test_closing_terminates_frees_unloads_and_removes(
    foreign: Mapping[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    unloaded: list[Library] = []

    def unload(library: Library) -> None:
        unloaded.append(library)

    monkeypatch.setattr(Library, "unload", unload)
    component = load(foreign["Lag"])
    library = component.library
    component.library = spy = Spy(component.library)
    component.initialise(0.0, None)
    component.exit_initialization_mode()
    assert list(tmp_path.iterdir())
    component.close()
    assert spy.calls == ["fmi2Terminate", "fmi2FreeInstance"]
    assert unloaded == [library]
    assert not list(tmp_path.iterdir())


def test_after_fatal_nothing_is_called_any_more(foreign: Mapping[str, Path]) -> None:
    component = load(foreign["Raises"])
    component.initialise(0.0, None)
    component.exit_initialization_mode()
    component.library = spy = Spy(component.library)
    with pytest.raises(FmuError, match=r"returned fatal: .*the hull is breached"):
        component.call("fmi2DoStep", 0.5, 0.1, 1)
    component.close()
    assert spy.calls == []


def doing(rogue: Build, misdeed: Misdeed, **capabilities: Any) -> tuple[FmuInstance, Spy]:
    """An instance that does so in its first step."""
    component = load(rogue(**capabilities))
    component.library = spy = Spy(component.library)
    begin(component, misdeed)
    return component, spy


def begin(component: FmuInstance, misdeed: Misdeed) -> None:
    for variable in component.description.modelVariables:
        if variable.name == "misdeed":
            component.set(variable, int(misdeed))
    component.initialise(0.0, None)
    component.exit_initialization_mode()


@pytest.mark.parametrize(
    ("misdeed", "calls"),
    [
        (Misdeed.NONE, ["fmi2Terminate", "fmi2FreeInstance"]),
        (Misdeed.DISCARD, ["fmi2Terminate", "fmi2FreeInstance"]),
        (Misdeed.ERROR, ["fmi2FreeInstance"]),
        (Misdeed.FATAL, []),
    ],
    ids=lambda each: each.name if isinstance(each, Misdeed) else "",
)
def test_an_instance_ends_as_fmi_allows_after_its_last_step(
    rogue: Build, misdeed: Misdeed, calls: list[str]
) -> None:
    component, spy = doing(rogue, misdeed)
    with contextlib.suppress(FmuError):
        component.call("fmi2DoStep", 0.0, 0.1, 1)
    component.close()
    assert spy.calls == calls


def test_a_restored_state_ends_an_error(rogue: Build) -> None:
    component, spy = doing(rogue, Misdeed.ERROR, saves_state=True)
    saved = component.get_fmu_state()
    with pytest.raises(FmuError, match="returned error: the rudder is stuck"):
        component.call("fmi2DoStep", 0.0, 0.1, 1)
    component.set_fmu_state(saved)
    component.free_fmu_state(saved)
    component.close()
    assert spy.calls == ["fmi2Terminate", "fmi2FreeInstance"]


def test_a_reset_ends_an_error(rogue: Build) -> None:
    component, spy = doing(rogue, Misdeed.ERROR)
    with pytest.raises(FmuError, match="returned error: the rudder is stuck"):
        component.call("fmi2DoStep", 0.0, 0.1, 1)
    assert component.reset()
    begin(component, Misdeed.NONE)
    component.close()
    assert spy.calls == ["fmi2Terminate", "fmi2FreeInstance"]


def test_what_ends_fatally_is_not_freed(rogue: Build) -> None:
    component, spy = doing(rogue, Misdeed.NONE)
    fatal = 4
    vars(spy)["fmi2Terminate"] = lambda instance: fatal
    component.close()
    assert spy.calls == []


def test_a_fatal_error_ends_one_instance_as_each_has_a_library_of_its_own(rogue: Build) -> None:
    bad, _ = doing(rogue, Misdeed.FATAL)
    good, spy = doing(rogue, Misdeed.NONE)
    assert bad.function("fmi2DoStep") != good.function("fmi2DoStep")
    with pytest.raises(FmuError, match="returned fatal: the hull is breached"):
        bad.call("fmi2DoStep", 0.0, 0.1, 1)
    bad.close()
    good.call("fmi2DoStep", 0.0, 0.1, 1)
    good.close()
    assert spy.calls == ["fmi2Terminate", "fmi2FreeInstance"]


def test_a_warning_is_a_python_warning_that_names_instance_time_and_words(
    foreign: Mapping[str, Path],
) -> None:
    with load(foreign["Lag"], "pump") as component:
        component.time = 1.5
        component.log.append((1, "running dry"))
        with pytest.warns(FmuWarning, match=r"pump at t = 1.5 s: fmi2DoStep: running dry"):
            component.check_status("fmi2DoStep", 1)
        assert component.log == []


def test_an_error_that_is_only_logged_is_an_error(foreign: Mapping[str, Path]) -> None:
    with load(foreign["Lag"]) as component:
        component.log.append((3, "no"))
        with pytest.raises(FmuError, match=r"fmi2SetReal returned error: no"):
            component.check_status("fmi2SetReal", 0)


def test_errors_cross_processes_with_all_they_say() -> None:
    slave = FmuError("plant", 0.5, "fmi2DoStep", "discard", ["no", "never"])
    assert str(pickle.loads(pickle.dumps(slave))) == str(slave)
    assert str(slave) == "plant at t = 0.5 s: fmi2DoStep returned discard: no; never"
    ended = SimulationError(str(slave), Recording((), (), np.zeros(1), np.zeros((1, 0))))
    copy = pickle.loads(pickle.dumps(ended))
    assert str(copy) == str(slave)
    assert copy.recording.time.tolist() == [0.0]


class InterruptSoon:
    """A progress that raises SIGINT half a second after the run has begun."""

    def __init__(self) -> None:
        self.timer: threading.Timer | None = None

    def __call__(self, done: int, total: int) -> None:
        if self.timer is None:
            self.timer = threading.Timer(0.5, lambda: signal.raise_signal(signal.SIGINT))
            self.timer.start()


@pytest.fixture
def interrupt_soon() -> Iterator[InterruptSoon]:
    progress = InterruptSoon()
    yield progress
    if progress.timer:
        progress.timer.join()


def test_an_interrupt_waits_for_the_end_of_a_step(
    python_built: Mapping[str, Path], interrupt_soon: InterruptSoon
) -> None:
    """Inside an FMU it would strike the FMU's Python and look like the FMU's failure."""
    inputs = {"p.control": 0.0, "p.disturbance": 0.0}
    before = signal.getsignal(signal.SIGINT)
    system, experiment = System({"p": python_built["ExamplePlant"]}), Experiment(100.0, 1e-3, inputs=inputs)
    with pytest.raises(SimulationError, match=r"^interrupted$") as caught:
        simulate(system, experiment, interrupt_soon)
    assert len(caught.value.recording.time) > 1
    assert signal.getsignal(signal.SIGINT) is before


def test_a_signal_that_raises_is_named_before_the_run(foreign: Mapping[str, Path]) -> None:
    def broken(t: float) -> float:
        if t > 0.25:
            raise RuntimeError("no more data")
        return 0.0

    with pytest.raises(SystemDefinitionError, match=r"signal lag.u: RuntimeError\('no more data'\)"):
        simulate(System({"lag": foreign["Lag"]}), Experiment(1.0, 0.1, signals={"lag.u": broken}))


def _edited(path: Path, folder: Path, *changes: tuple[str, str]) -> Path:
    """A copy of an FMU with another model description."""
    copy = folder / f"edited_{path.name}"
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(copy, "w") as target:
        for member in source.namelist():
            data = source.read(member)
            if member == "modelDescription.xml":
                text = data.decode()
                for old, new in changes:
                    assert old in text
                    text = text.replace(old, new, 1)
                data = text.encode()
            target.writestr(member, data)
    return copy


def test_what_an_fmu_cannot_do_is_said_before_it_is_loaded(
    foreign: Mapping[str, Path], tmp_path: Path
) -> None:
    fixed = _edited(
        foreign["Lag"], tmp_path,
        ('canHandleVariableCommunicationStepSize="true"', 'canHandleVariableCommunicationStepSize="false"'),
        ('canBeInstantiatedOnlyOncePerProcess="false"', 'canBeInstantiatedOnlyOncePerProcess="true"'),
    )  # fmt: skip
    with pytest.raises(SystemDefinitionError, match=r"one cannot vary its step size"):
        simulate(System({"one": fixed}), Experiment(1.05, 0.1, inputs={"one.u": 0.0}))
    both = Experiment(1.0, 0.1, inputs={"one.u": 0.0, "two.u": 0.0})
    with pytest.raises(SystemDefinitionError, match=r"one, two: expected one instance"):
        simulate(System({"one": fixed, "two": fixed}), both)


def test_a_range_and_unit_that_only_the_declared_type_states_count(
    foreign: Mapping[str, Path], tmp_path: Path
) -> None:
    types = (
        '<UnitDefinitions><Unit name="K"><BaseUnit K="1"/></Unit></UnitDefinitions><TypeDefinitions>'
        '<SimpleType name="T"><Real unit="K" max="5.0"/></SimpleType></TypeDefinitions>'
    )
    typed = _edited(
        foreign["Lag"], tmp_path,
        ("<LogCategories>", types + "<LogCategories>"),
        ('<Real start="0"', '<Real declaredType="T" start="0"'),
    )  # fmt: skip
    with pytest.raises(SystemDefinitionError, match=r"lag.u = 7.0: expected -inf..5 K"):
        simulate(System({"lag": typed}), Experiment(1.0, 0.1, inputs={"lag.u": 7.0}))


def test_an_fmu_without_units_connects_to_one_with(
    foreign: Mapping[str, Path], built: Mapping[str, Path]
) -> None:
    system = System(
        {"lag": foreign["Lag"], "p": built["ExamplePlant"]}, (("lag.y", "p.control"), ("p.output", "lag.u"))
    )
    run = simulate(system, Experiment(0.1, 0.01, inputs={"p.disturbance": 0.0}))
    assert run["p.output"][-1] != 0.0


def test_runs_in_other_threads_do_not_touch_signals(foreign: Mapping[str, Path]) -> None:
    done: list[Recording] = []

    def work() -> None:
        done.append(simulate(System({"lag": foreign["Lag"]}), Experiment(0.1, 0.1, inputs={"lag.u": 0.0})))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert len(done) == 1


def test_the_library_of_this_very_platform_is_loaded(
    built: Mapping[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """FMPy looks on ARM where x86 libraries lie: as if it did not know this platform here."""
    monkeypatch.setattr(fmpy, "platform", "elsewhere")
    inputs = {"p.control": 0.0, "p.disturbance": 0.0}
    run = simulate(System({"p": built["ExamplePlant"]}), Experiment(0.1, 0.01, inputs=inputs))
    assert run.time[-1] == 0.1


def test_messages_arrive_also_after_somebody_else_used_fmpy(built: Mapping[str, Path]) -> None:
    """FMPy's own simulation makes its proxy pass messages to FMPy's logger."""
    fmpy.simulate_fmu(str(built["ExamplePlant"]), stop_time=0.01)
    signals = {"p.control": lambda t: 1e308 if t > 0.05 else 0.0, "p.disturbance": Constant(0.0)}
    with pytest.raises(SimulationError, match="not finite any more"):
        simulate(System({"p": built["ExamplePlant"]}), Experiment(0.1, 0.01, signals=signals))


def test_two_instances_of_one_name_are_heard_apart(rogue: Build) -> None:
    """As in two simulators that are open at once."""
    path = rogue()
    with load(path, "it") as first, load(path, "it") as second:
        for component in (first, second):
            variables = {v.name: v for v in component.description.modelVariables}
            component.set(variables["misdeed"], int(Misdeed.ERROR))
            component.initialise(0.0, None)
            component.exit_initialization_mode()
        with pytest.raises(FmuError) as caught:
            first.call("fmi2DoStep", 0.0, 0.1, 1)
        assert caught.value.log
        assert second.log == []


def test_an_interrupt_of_the_last_stretch_is_not_lost() -> None:
    """It comes when nothing looks at it any more."""
    with pytest.raises(KeyboardInterrupt), deferred_interrupt():
        signal.raise_signal(signal.SIGINT)


def test_an_interrupt_ends_shorter_steps_between_two_points(
    linear: Build, tmp_path: Path, interrupt_soon: InterruptSoon
) -> None:
    """And the system goes back to the point before them, from where it can go on."""
    system = coupled(linear, saves_state=True, serialises_state=True)
    with pytest.raises(SimulationError, match="interrupted; saved in"):
        simulate(
            system,
            Experiment(2.0, 2.0, tolerance=1e-7),
            interrupt_soon,
            checkpoints=Checkpoints(tmp_path / "c"),
        )
    checkpoint = read_checkpoint(tmp_path / "c")
    assert checkpoint.position == 0


def test_an_interrupt_ends_a_wait_for_the_clock(linear: Build, interrupt_soon: InterruptSoon) -> None:
    begun = time.monotonic()
    with pytest.raises(SimulationError, match="interrupted"):
        simulate(coupled(linear), Experiment(600.0, 300.0), interrupt_soon, real_time=1.0)
    assert time.monotonic() - begun < 60.0  # and not 600


def test_an_fmu_that_repeats_itself_is_heard_once(rogue: Build) -> None:
    parameters = {"bad.misdeed": int(Misdeed.WARNING), "bad.misdeed_time": 0.5}
    experiment = Experiment(100.0, 0.01, parameters=parameters, inputs={"bad.u": 0.0})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        simulate(System({"bad": rogue()}), experiment)
    messages = [str(each.message) for each in caught]
    assert messages[0].startswith("bad at t = 0.5 s: ")
    assert max(map(len, messages)) < 200


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"step_sizes": {"t": math.inf}}, "step size of t, inf s: expected a multiple"),
        (
            {"inputs": {"t.a": 2**40, "t.b": False}},
            r"t.a = 1099511627776: expected -2.14748e\+09..2.14748e\+09",
        ),
    ],
)
def test_what_no_fmu_can_take_is_refused_before_the_run(
    foreign: Mapping[str, Path], settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        simulate(
            System({"t": foreign["Types"]}),
            Experiment(1.0, 0.1, **{"inputs": {"t.a": 1, "t.b": False}, **settings}),
        )
