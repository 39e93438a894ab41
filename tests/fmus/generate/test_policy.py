"""FILE.py:Class becomes an FMU of the python flavour that carries what it needs, and no other's."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from fmus.block import policy as policies
from fmus.block.own_modules import OwnModules
from fmus.errors import ExportError
from fmus.fmi.description import describe
from fmus.fmi.model_description import CoSimulation
from fmus.generate.policy import check_repeats, fmu_of_class
from orchestration import Experiment, Recording, SimulationError, Simulator, System, simulate
from tests.described_fmus import members

POLICY = """
import numpy as np
from pathlib import Path

FILE = Path(__file__).with_name("weights.npy")


class Policy:
    period = 0.1
    inputs = ("measured_depth",)

    def reset(self):
        from helper import offset

        self.offset = offset
        self.weights = np.load(FILE)

    def step(self, time, inputs):
        return {"control_force": self.weights.sum() + self.offset + inputs["measured_depth"]}
"""


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    (tmp_path / "my.py").write_text(POLICY)
    (tmp_path / "helper.py").write_text("offset = 1.0\n")
    np.save(tmp_path / "weights.npy", np.ones(2))
    return tmp_path / "my.py"


def run(file: Path, cls: str = "Policy") -> Recording:
    experiment = Experiment(1.0, 0.1, inputs={"own.measured_depth": 0.5})
    return simulate(System({"own": f"{file}:{cls}"}), experiment)


def force(file: Path) -> float:
    return run(file)["own.control_force"][-1]


@pytest.mark.slow
def test_it_carries_its_modules_and_files_and_runs_where_they_are_gone(policy: Path) -> None:
    path = fmu_of_class(f"{policy}:Policy")
    for file in (policy, policy.with_name("helper.py"), policy.with_name("weights.npy")):
        file.unlink()
    recording = simulate(System({"own": path}), Experiment(1.0, 0.1, open_inputs="start"))
    assert recording["own.control_force"].tolist() == 11 * [3.0]


@pytest.mark.slow
def test_a_change_of_any_of_its_files_is_run_also_in_the_same_process(policy: Path) -> None:
    """Modules of the FMUs before are loaded."""
    changes = {
        3.5: lambda: None,
        5.5: lambda: np.save(policy.with_name("weights.npy"), np.full(2, 2.0)),
        7.5: lambda: edited("= 1.0", "= 3.0")(policy.with_name("helper.py")),
        9.5: lambda: edited("self.offset +", "self.offset + 2 +")(policy),
    }
    fmus = set[bytes]()
    for expected, change in changes.items():
        change()
        assert force(policy) == expected
        fmus.add(fmu_of_class(f"{policy}:Policy").read_bytes())
    assert len(fmus) == len(changes)


@pytest.mark.slow
def test_it_is_made_once_and_two_builds_are_the_same_bytes(
    policy: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = fmu_of_class(f"{policy}:Policy")
    content, made = path.read_bytes(), path.stat().st_mtime_ns
    assert fmu_of_class("my.py:Policy", tmp_path).stat().st_mtime_ns == made
    path.write_bytes(b"damaged")
    assert fmu_of_class(f"{policy}:Policy").read_bytes() == content
    assert not [name for name, inside in members(path).items() if str(tmp_path).encode() in inside]


@pytest.mark.slow
def test_its_state_is_saved_if_it_can_be_copied(policy: Path) -> None:
    assert (interface(policy).canGetAndSetFMUstate, interface(policy).canSerializeFMUstate) == (True, False)
    policy.write_text(POLICY.replace("= offset", "= offset; self.calls = (i for i in [])"))
    assert not interface(policy).canGetAndSetFMUstate


@pytest.mark.slow
def test_a_module_that_hides_one_of_python_hides_it_from_the_users_modules_alone(policy: Path) -> None:
    policy.with_name("helper.py").rename(policy.with_name("json.py"))
    policy.write_text(POLICY.replace("from helper", "from json"))
    assert force(policy) == 3.5


def interface(policy: Path) -> CoSimulation:
    found = describe(fmu_of_class(f"{policy}:Policy")).coSimulation
    assert found
    return found


def edited(old: str, new: str) -> Callable[[Path], object]:
    return lambda file: file.write_text(file.read_text().replace(old, new))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (edited("class Policy", "class Polic"), "my.py: no class 'Policy'; nearest is 'Polic'"),
        (edited("import numpy as np", "import nunpy as np"), r"my.py:2: ModuleNotFoundError: .*'nunpy'"),
        (edited("import numpy as np", "from pythonfmu import Real"), "my.py:2: .*; pythonfmu build -f"),
        (edited("import numpy as np", "from .x import y"), r"my.py:2: an import with dots"),
        (edited("class Policy:", "class Policy"), r"my.py:8: expected ':'"),
        (edited("weights.npy", "weight.npy"), "my.py:16: FileNotFoundError: .*; expected one beside"),
        (edited("import numpy as np", "import numpy as np, os; os._exit(3)"), "ended Python: exit status 3"),
        (edited("    period", "    __slots__ = ()\n    period"), "my.py: Policy has __slots__: exp"),
        (edited("FILE =", "exit(3) #"), "my.py:5: SystemExit: 3"),
        (lambda file: file.rename(file.with_name("mine.py")), "my.py: no such file; nearest is 'mine.py'"),
    ],
)  # fmt: skip
def test_a_file_of_which_none_can_be_made_is_refused(
    policy: Path, change: Callable[[Path], object], message: str
) -> None:
    change(policy)
    with pytest.raises(ExportError, match=message):
        System({"own": f"{policy}:Policy"})


@pytest.mark.slow
def test_an_error_of_a_run_names_time_and_line(policy: Path) -> None:
    edited("return {", 'assert time < 0.45, "too late"; return {')(policy)
    message = r"own at t = 0.5 s: .* my.py:19 at t = 0.5 s: AssertionError: too late"
    with pytest.raises(SimulationError, match=message):
        run(policy)


@pytest.mark.parametrize("name", ["my.py:", "my.py:a.b", "my.py:_P"])
def test_a_name_that_is_no_class_is_refused(policy: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(ExportError, match=r"expected FILE\.py:Class"):
        fmu_of_class(name, tmp_path)


REMEMBERS = """
import os
import random
import time as clock

import numpy as np

NUMBERS = np.random.default_rng(0)
COUNT = 0
LOG = []


def counter():
    count = [0]
    return lambda: count.append(0) or len(count)


calls_until_now = counter()


class Part:
    def __deepcopy__(self, memo):
        import own

        return own.Part()


class Base:
    shared = {{}}


class Policy(Base):
    period = 0.25
    inputs = ("measured_depth", "pitch")
    integral = [0.0]
    calls = 0

    def reset(self):
        self.x = 0.0
        {reset}

    def step(self, time, inputs, memory=[]):
        global COUNT
        self.x += inputs["pitch"]
        {step}
        return {{"control_force": {force}}}
"""


def tried(folder: Path, reset: str = "pass", step: str = "pass", force: str = "self.x") -> bool:
    """Whether the state of a policy can be saved, after the runs of a build."""
    package = folder / "tried_policy"
    package.mkdir()
    (package / "own.py").write_text(REMEMBERS.format(reset=reset, step=step, force=force))
    modules = OwnModules(package.name, package)
    with modules.present():
        cls = import_module("tried_policy.own").Policy
    return check_repeats(policies, policies.policy_block(cls, modules))


OF_FUNCTION = "default values of arguments, closure or attributes of "
REMEMBERED = {
    "Policy.integral": ("self.integral[0] += inputs['measured_depth']", "self.integral[0]"),
    "Policy.calls": ("type(self).calls -= 1", "type(self).calls"),
    "Base.shared": ("self.shared[time] = self.shared.get(time, 0) + 1", "self.shared[time]"),
    "own.COUNT": ("COUNT += 1", "COUNT"),
    "own.NUMBERS": ("pass", "NUMBERS.normal()"),
    "own.LOG": ("LOG.append(time)", "self.x + (len(LOG) > 25)"),
    "os.environ": ("os.environ['CALLS'] += 'x'", "len(os.environ['CALLS'])"),
    f"{OF_FUNCTION}Policy.step": ("memory.append(time)", "len(memory)"),
    f"{OF_FUNCTION}own.calls_until_now": ("pass", "calls_until_now()"),
}


@pytest.mark.parametrize("name", REMEMBERED)
def test_a_class_that_remembers_the_run_before_is_refused_with_the_name_of_its_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv("CALLS", "")
    step, force = REMEMBERED[name]
    message = rf"^Policy: two objects, .* as control_force at t = .*; expected in self .*, not in {name}$"
    with pytest.raises(ExportError, match=message):
        tried(tmp_path, step=step, force=force)


def test_the_first_difference_of_two_runs_is_told(tmp_path: Path) -> None:
    """The first object calls once at the start, then in 20 samples; the second begins at 21."""
    step = "self.integral[0] += 1"
    with pytest.raises(ExportError, match=r"have 0 and -1 as control_force at t = 0.5 s"):
        tried(tmp_path, step=step, force="-(self.integral[0] > 23 and time > 0.4) if self.x else 0")


@pytest.mark.parametrize(
    ("reset", "force"),
    [
        ("self.random = np.random.default_rng()", "self.random.normal()"),
        ("pass", "random.random()"),
        ("pass", "np.random.normal()"),
        ("pass", "clock.perf_counter()"),
    ],
)
def test_random_numbers_without_a_seed_and_clocks_are_refused(tmp_path: Path, reset: str, force: str) -> None:
    message = r"expected random numbers that reset seeds, self.random = .* clock, and nothing that a file"
    with pytest.raises(ExportError, match=message):
        tried(tmp_path, reset=reset, force=force)


@pytest.mark.parametrize(
    ("can_save", "changes"),
    [
        (True, {}),
        (True, {"reset": "self.r = np.random.default_rng(1)", "force": "self.r.normal()"}),
        (True, {"reset": "self.log = []", "step": "self.log.append(time)", "force": "len(self.log)"}),
        (True, {"reset": "self.part = Part()"}),
        (True, {"step": "assert abs(self.x) < 0.6"}),  # which these inputs do not meet
        (False, {"step": "LOG.append(time)"}),  # a copy of the object would miss these
        (False, {"reset": "random.seed(1)", "force": "random.random()"}),
        (False, {"step": "self.later = (i for i in LOG)"}),
    ],
)
def test_the_state_can_be_saved_where_a_copy_of_the_object_is_all_of_it(
    tmp_path: Path, can_save: bool, changes: dict[str, str]
) -> None:
    assert tried(tmp_path, **changes) == can_save


LATE = """
import pickle
from pathlib import Path

import helper

CALLS = []


class Policy:
    period = 0.1
    inputs = ("measured_depth",)
    calls = []

    def reset(self):
        self.model = pickle.loads(Path(__file__).with_name("model.pkl").read_bytes())

    def step(self, time, inputs):
        from late import NAMES

        for memory in (CALLS, helper.CALLS, self.calls, NAMES):
            memory.append(time)
        late = len(CALLS) + len(helper.CALLS) + len(self.calls) + len(NAMES) if time > 8.0 else 0.0
        return {"control_force": self.model.k + late + inputs["measured_depth"]}
"""


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A class whose memory has an effect after the runs of a build, with a pickle of a helper's class."""
    folder = tmp_path_factory.mktemp("late")
    pickled = b"\x80\x04chelper\nModel\n)\x81}\x8c\x01kG@\x12\x00\x00\x00\x00\x00\x00sb."
    modules = {"own": LATE, "helper": "CALLS = []\nclass Model: pass\n", "late": "NAMES = []\n"}
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text)
    (folder / "model.pkl").write_bytes(pickled)
    return str(fmu_of_class(f"{folder / 'own.py'}:Policy"))


@pytest.mark.slow
def test_each_run_and_each_component_begins_without_what_another_left(late: str) -> None:
    """Two components of one class, run twice: 4 lists have an entry for each sample, and one of the start."""
    system = System({"a": late, "b": late})
    experiment = Experiment(9.0, 0.1, inputs={"a.measured_depth": -1.0, "b.measured_depth": 2.0})
    with Simulator(system) as simulator:
        first, second = (simulator.run(experiment) for _ in range(2))
    assert first["a.control_force"][0] == 3.5
    assert first["a.control_force"][-1] == 3.5 + 4 * 91
    assert first["b.control_force"][-1] == 6.5 + 4 * 91
    assert np.array_equal(first.values, second.values)
