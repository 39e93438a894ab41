"""An instance is always freed, warns where it should, and its errors survive a process boundary."""

import pickle
import signal
import tempfile
import threading
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from orchestration.component import Component
from orchestration.errors import SimulationError, SlaveError, SlaveWarning, SystemDefinitionError
from orchestration.experiment import Experiment
from orchestration.master import simulate
from orchestration.recording import Recording
from orchestration.reference import Constant
from orchestration.system import System, describe
from tests.orchestration.foreign_fmus import Misdeed

Build = Callable[..., Path]


class Spy:
    """A library that counts the calls that it passes on."""

    def __init__(self, library: Any) -> None:
        self._library = library
        self.calls: list[str] = []

    def __getattr__(self, name: str) -> Any:
        if name in ("fmi2Terminate", "fmi2FreeInstance"):
            self.calls.append(name)
        return getattr(self._library, name)


def load(path: Path, name: str = "it") -> Component:
    return Component(name, path, describe(path))


def test_closing_terminates_frees_unloads_and_removes(
    foreign: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    component = load(foreign["Lag"])
    slave = component._slave
    spy = slave.dll = Spy(slave.dll)
    freed: list[bool] = []
    monkeypatch.setattr(slave, "freeLibrary", lambda: freed.append(True))
    component.initialise(0.0, None)
    component.begin_stepping()
    assert list(tmp_path.iterdir())
    component.close()
    assert spy.calls == ["fmi2Terminate", "fmi2FreeInstance"]
    assert freed == [True]
    assert not list(tmp_path.iterdir())


def test_after_fatal_nothing_is_called_any_more(foreign: dict[str, Path]) -> None:
    component = load(foreign["Raises"])
    component.initialise(0.0, None)
    component.begin_stepping()
    component._slave.dll = spy = Spy(component._slave.dll)
    with pytest.raises(SlaveError, match=r"returned fatal: .*the hull is breached"):
        component.do_step(0.5, 0.1)
    component.close()
    assert spy.calls == []


def test_a_warning_is_a_python_warning_that_names_instance_time_and_words(foreign: dict[str, Path]) -> None:
    with load(foreign["Lag"], "pump") as component:
        component.time = 1.5
        component.log.append((1, "running dry"))
        with pytest.warns(SlaveWarning, match=r"pump at t = 1.5 s: fmi2DoStep: running dry"):
            component.judge("fmi2DoStep", 1)
        assert component.log == []


def test_an_error_that_is_only_logged_is_an_error(foreign: dict[str, Path]) -> None:
    with load(foreign["Lag"]) as component:
        component.log.append((3, "no"))
        with pytest.raises(SlaveError, match=r"fmi2SetReal returned error: no"):
            component.judge("fmi2SetReal", 0)


def test_errors_cross_processes_with_all_they_say() -> None:
    slave = SlaveError("plant", 0.5, "fmi2DoStep", "discard", ["no", "never"])
    assert str(pickle.loads(pickle.dumps(slave))) == str(slave)
    assert str(slave) == "plant at t = 0.5 s: fmi2DoStep returned discard: no; never"
    ended = SimulationError(str(slave), Recording((), (), np.zeros(1), np.zeros((1, 0))))
    copy = pickle.loads(pickle.dumps(ended))
    assert str(copy) == str(slave)
    assert copy.recording.time.tolist() == [0.0]


def test_an_interrupt_waits_for_the_end_of_a_step(python_built: dict[str, Path]) -> None:
    """Inside an FMU it would strike the FMU's Python and look like the FMU's failure."""
    inputs = {"p.control": 0.0, "p.disturbance": 0.0}
    before = signal.getsignal(signal.SIGINT)
    timer = threading.Timer(0.5, lambda: signal.raise_signal(signal.SIGINT))
    timer.start()
    with pytest.raises(SimulationError, match=r"^interrupted$") as caught:
        simulate(System({"p": python_built["BenchmarkPlant"]}), Experiment(100.0, 1e-3, inputs=inputs))
    timer.join()
    assert len(caught.value.recording.time) > 1
    assert signal.getsignal(signal.SIGINT) is before


def test_a_signal_that_raises_is_named_before_the_run(foreign: dict[str, Path]) -> None:
    def broken(t: float) -> float:
        if t > 0.25:
            raise RuntimeError("no more data")
        return 0.0

    with pytest.raises(SystemDefinitionError, match=r"signal lag.u: RuntimeError\('no more data'\)"):
        simulate(System({"lag": foreign["Lag"]}), Experiment(1.0, 0.1, signals={"lag.u": broken}))


def test_a_signal_drives_real_inputs_only(foreign: dict[str, Path]) -> None:
    experiment = Experiment(1.0, 0.1, inputs={"t.b": False}, signals={"t.a": Constant(1.0)})
    with pytest.raises(SystemDefinitionError, match=r"t.a: expected an input of type Real, got Integer"):
        simulate(System({"t": foreign["Types"]}), experiment)


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


def test_what_an_fmu_cannot_do_is_said_before_it_is_loaded(foreign: dict[str, Path], tmp_path: Path) -> None:
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
    foreign: dict[str, Path], tmp_path: Path
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


def test_an_fmu_without_units_connects_to_one_with(foreign: dict[str, Path], built: dict[str, Path]) -> None:
    system = System(
        {"lag": foreign["Lag"], "p": built["BenchmarkPlant"]}, (("lag.y", "p.control"), ("p.output", "lag.u"))
    )
    run = simulate(system, Experiment(0.1, 0.01, inputs={"p.disturbance": 0.0}))
    assert run["p.output"][-1] != 0.0


def test_runs_in_other_threads_do_not_touch_signals(foreign: dict[str, Path]) -> None:
    done: list[Recording] = []

    def work() -> None:
        done.append(simulate(System({"lag": foreign["Lag"]}), Experiment(0.1, 0.1, inputs={"lag.u": 0.0})))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert len(done) == 1


def test_the_library_of_this_very_platform_is_loaded(
    built: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """FMPy looks on ARM where x86 libraries lie: as if it did not know this platform here."""
    monkeypatch.setattr(fmpy, "platform", "elsewhere")
    inputs = {"p.control": 0.0, "p.disturbance": 0.0}
    run = simulate(System({"p": built["BenchmarkPlant"]}), Experiment(0.1, 0.01, inputs=inputs))
    assert run.time[-1] == 0.1


def test_messages_arrive_also_after_somebody_else_used_fmpy(built: dict[str, Path]) -> None:
    """FMPy's own simulation makes its proxy pass messages to FMPy's logger."""
    fmpy.simulate_fmu(str(built["BenchmarkPlant"]), stop_time=0.01)
    signals = {"p.control": lambda t: 1e308 if t > 0.05 else 0.0, "p.disturbance": Constant(0.0)}
    with pytest.raises(SimulationError, match="not finite any more"):
        simulate(System({"p": built["BenchmarkPlant"]}), Experiment(0.1, 0.01, signals=signals))


def test_two_instances_of_one_name_are_heard_apart(rogue: Build) -> None:
    """As in two simulators that are open at once."""
    path = rogue()
    with load(path, "it") as first, load(path, "it") as second:
        for component in (first, second):
            variables = {v.name: v for v in component.description.modelVariables}
            component.set(variables["misdeed"], int(Misdeed.ERROR))
            component.initialise(0.0, None)
            component.begin_stepping()
        with pytest.raises(SlaveError) as caught:
            first.do_step(0.0, 0.1)
        assert caught.value.log
        assert second.log == []
