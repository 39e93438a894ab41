"""FILE.py:Class becomes an FMU of the python flavour that carries what it needs, and no other's."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fmus.build.policy import fmu_of_class
from fmus.errors import ExportError
from fmus.fmi.description import describe
from fmus.fmi.model_description import CoSimulation
from orchestration import Experiment, Recording, SimulationError, System, simulate

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
    return simulate(
        System({"own": f"{file}:{cls}"}), Experiment(1.0, 0.1, inputs={"own.measured_depth": 0.5})
    )


def force(file: Path) -> float:
    return run(file)["own.control_force"][-1]


def test_it_carries_its_modules_and_files_and_runs_where_they_are_gone(policy: Path) -> None:
    path = fmu_of_class(f"{policy}:Policy")
    for file in (policy, policy.with_name("helper.py"), policy.with_name("weights.npy")):
        file.unlink()
    recording = simulate(System({"own": path}), Experiment(1.0, 0.1, open_inputs="start"))
    assert recording["own.control_force"].tolist() == 11 * [3.0]


@pytest.mark.parametrize("changed", ["my.py", "helper.py", "weights.npy"])
def test_a_change_of_any_of_its_files_is_run_also_in_the_same_process(policy: Path, changed: str) -> None:
    """Twice in one process: modules of the old FMU are loaded."""
    assert force(policy) == 3.5
    first, file = fmu_of_class(f"{policy}:Policy").read_bytes(), policy.with_name(changed)
    if changed == "weights.npy":
        np.save(file, np.full(2, 2.0))
    else:
        text = file.read_text()
        file.write_text(
            text.replace("offset = 1.0", "offset = 3.0").replace("self.offset +", "self.offset + 2 +")
        )
    assert force(policy) == 5.5
    assert fmu_of_class(f"{policy}:Policy").read_bytes() != first


def test_it_is_made_once_and_two_builds_are_the_same_bytes(
    policy: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = fmu_of_class(f"{policy}:Policy")
    content, made = path.read_bytes(), path.stat().st_mtime_ns
    assert fmu_of_class("my.py:Policy", tmp_path).stat().st_mtime_ns == made
    path.write_bytes(b"damaged")
    assert fmu_of_class(f"{policy}:Policy").read_bytes() == content
    with zipfile.ZipFile(path) as archive:
        assert not [name for name in archive.namelist() if str(tmp_path).encode() in archive.read(name)]


def test_two_policies_with_modules_of_one_name_do_not_meet(policy: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "my.py").write_text(POLICY)
    (other / "helper.py").write_text("offset = 7.0\n")
    np.save(other / "weights.npy", np.zeros(1))
    system = System({"a": f"{policy}:Policy", "b": f"{other / 'my.py'}:Policy"})
    recording = simulate(system, Experiment(1.0, 0.1, open_inputs="start"))
    assert (recording["a.control_force"][-1], recording["b.control_force"][-1]) == (3.0, 7.0)


def test_its_state_is_saved_if_it_can_be_copied(policy: Path) -> None:
    assert (interface(policy).canGetAndSetFMUstate, interface(policy).canSerializeFMUstate) == (True, False)
    policy.write_text(POLICY.replace("= offset", "= offset; self.calls = (i for i in [])"))
    assert not interface(policy).canGetAndSetFMUstate


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
        (edited("import numpy as np", "from .x import y"), r"my.py:2: an import with dots"),
        (edited("class Policy:", "class Policy"), r"my.py:8: expected ':'"),
        (edited("weights.npy", "weight.npy"), "my.py:16: FileNotFoundError: .*; expected one beside"),
        (edited("import numpy as np", "import numpy as np, os; os._exit(3)"), "ended Python: exit status 3"),
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


def test_an_error_of_a_run_names_time_and_line(policy: Path) -> None:
    edited("return {", 'assert time < 0.45, "too late"; return {')(policy)
    with pytest.raises(
        SimulationError, match=r"own at t = 0.5 s: .* my.py:19 at t = 0.5 s: AssertionError: too late"
    ):
        run(policy)


@pytest.mark.parametrize("name", ["my.py:", "my.py:a.b", "my.py:_P"])
def test_a_name_that_is_no_class_is_refused(policy: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(ExportError, match=r"expected FILE\.py:Class"):
        fmu_of_class(name, tmp_path)
