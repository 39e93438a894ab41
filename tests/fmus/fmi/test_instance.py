"""An instance is always freed, warns where it should, and its errors survive a process boundary."""

import contextlib
import ctypes
import pickle
import sys
import threading
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from fmus.fmi import binding, instance
from fmus.fmi.binding import Library
from fmus.fmi.description import describe
from fmus.fmi.instance import FmuInstance
from orchestration.errors import FmuError, FmuWarning, SimulationError
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.system.experiment import Experiment
from orchestration.system.signals import Constant
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.shared_builds import Build


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


@pytest.fixture
def unloaded(monkeypatch: pytest.MonkeyPatch) -> list[Library]:
    """Libraries that were unloaded."""
    libraries: list[Library] = []
    unload_library = Library.unload

    def unload(library: Library) -> None:
        libraries.append(library)
        unload_library(library)

    monkeypatch.setattr(Library, "unload", unload)
    return libraries


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not list threads")
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_library_whose_thread_may_still_run_stays_loaded(
    linear: Build, unloaded: list[Library], fmi: int
) -> None:
    """A thread of C that was not there before, also if it has called Python; no thread of Python."""
    is_over, has_begun = threading.Event(), threading.Event()
    path = linear(fmi=fmi)
    before, earlier = load(path), load(path)
    ours = threading.Thread(target=is_over.wait, daemon=True)
    ours.start()
    earlier.close()
    assert unloaded == [earlier.library]

    @ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
    def wait(_: int | None) -> None:
        assert isinstance(threading.current_thread(), threading._DummyThread)
        has_begun.set()
        is_over.wait()

    c, thread = ctypes.CDLL(None), ctypes.c_ulong()
    assert c.pthread_create(ctypes.byref(thread), None, wait, None) == 0
    try:
        assert has_begun.wait(10.0)
        before.close()
        assert len(unloaded) == 1
        later = load(path)
        later.close()
        assert unloaded[1:] == [later.library]
    finally:
        is_over.set()
        c.pthread_join(thread, None)
        ours.join()


def test_a_thread_that_the_system_lists_for_a_moment_does_not_keep_a_library(
    linear: Build, unloaded: list[Library], monkeypatch: pytest.MonkeyPatch
) -> None:
    listed = iter([set[str](), {"7"}, {"7"}, set[str]()])  # when loaded, then when closed
    monkeypatch.setattr(instance, "foreign_threads", lambda: next(listed))
    component = load(linear())
    component.close()
    assert unloaded == [component.library]


def test_closing_terminates_frees_unloads_and_removes(
    foreign: Mapping[str, Path], temporary: Path, unloaded: list[Library]
) -> None:
    component = load(foreign["Lag"])
    library = component.library
    component.library = spy = Spy(component.library)
    component.initialise(0.0, None)
    component.exit_initialization_mode()
    assert list(temporary.iterdir())
    component.close()
    assert spy.calls == ["fmi2Terminate", "fmi2FreeInstance"]
    assert unloaded == [library]
    assert not list(temporary.iterdir())


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
    ids=lambda argument: argument.name if isinstance(argument, Misdeed) else "",
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
    component.time = 2.0  # of a run that messages name no more
    with pytest.raises(FmuError, match="returned error: the rudder is stuck"):
        component.call("fmi2DoStep", 0.0, 0.1, 1)
    assert component.reset()
    assert component.time == 0.0
    begin(component, Misdeed.NONE)
    component.close()
    assert spy.calls == ["fmi2Terminate", "fmi2FreeInstance"]


def test_what_ends_fatally_is_not_freed(rogue: Build) -> None:
    component, spy = doing(rogue, Misdeed.NONE)
    fatal = 4
    vars(spy)["fmi2Terminate"] = lambda instance: fatal
    with pytest.warns(FmuWarning, match="it at t = 0 s: fmi2Terminate returned fatal"):
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


def test_the_library_of_this_very_platform_is_loaded(
    built: Mapping[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """FMPy looks on ARM where x86 libraries lie: as if it did not know this platform here."""
    monkeypatch.setattr(binding, "SYSTEM_PLATFORM", "elsewhere")
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


def test_an_fmu_that_repeats_itself_is_heard_once(rogue: Build) -> None:
    parameters = {"bad.misdeed": int(Misdeed.WARNING), "bad.misdeed_time": 0.5}
    experiment = Experiment(100.0, 0.01, parameters=parameters, inputs={"bad.u": 0.0})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        simulate(System({"bad": rogue()}), experiment)
    messages = [str(warning.message) for warning in caught]
    assert messages[0].startswith("bad at t = 0.5 s: ")
    assert max(map(len, messages)) < 200


@pytest.mark.parametrize("status", [-5, 6])
@pytest.mark.parametrize("function", ["fmi2EnterInitializationMode", "fmi2ExitInitializationMode"])
def test_a_status_that_fmi_does_not_have_is_an_error(
    foreign: Mapping[str, Path], function: str, status: int
) -> None:
    def initialise() -> None:
        component.initialise(0.0, None)
        component.exit_initialization_mode()

    with load(foreign["Lag"]) as component:
        setattr(component.library, function, lambda handle: status)
        with pytest.raises(FmuError, match=rf"{function} returned status {status}: it logged nothing"):
            initialise()
