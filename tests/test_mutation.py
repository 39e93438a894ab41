"""What counts as a mistake that the tests notice."""

import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.mutation.collected import BrokenEnvironmentError, CollectedTests
from tests.mutation.mutants import Mutant, chosen, mutants_of, statement_lines
from tests.mutation.verdict import KILLED_BY, SURVIVED, TIME_LIMIT, Judge, check_killers

pytestmark = pytest.mark.slow
BUDGET_S = 60.0
TESTS = """
    import os, time
    import pytest

    @pytest.fixture
    def answer():
        text = open("answer.txt").read()
        if text == "crash":
            os._exit(9)
        if text == "disturbed" and not os.path.exists("disturbed"):
            open("disturbed", "w").close()
            return 0
        if text == "disturbed":
            return 42
        if text == "hang":
            time.sleep(100)
        return int(text)

    def test_first():
        pass

    def test_answer(answer, monkeypatch, tmp_path):
        monkeypatch.chdir(tmp_path)
        assert answer in (42, 43)

    def test_after(answer):
        assert "BROKEN" not in os.environ
"""
IMPORTED = """
    from functools import cache

    class Number:
        def __init__(self, number):
            self.value = number

        @property
        def value(self):
            return self.number

        @value.setter
        def value(self, number):
            self.number = number

    @cache
    def following(number):
        return number + 1

    answer = lambda: 42
"""
TESTS_OF_IMPORTED = """
    import subprocess, sys
    import pytest
    from answers import Number, answer, following
    from tests.shared_builds import built_once

    def test_value():
        assert Number(3).value == 3

    def test_following():
        assert following(3) == 4

    def test_answer_of_another_process():
        code = "import sys, answers; sys.exit(answers.answer() != 42)"
        assert subprocess.run([sys.executable, "-c", code]).returncode == 0

    @pytest.fixture(scope="session")
    def shared():
        return following(4)

    def test_one(shared):
        assert True

    def test_another(shared):
        assert shared == 5

    @pytest.mark.parametrize("number", [1, 2])
    def test_file(tmp_path_factory, number):
        path = tmp_path_factory.getbasetemp() / "file"
        built_once(path, lambda path: path.write_text(str(following(5))))
"""


def judged(
    project: Path,
    path: str,
    content: str,
    tests: Sequence[str] = ("test_answer.py",),
    budget: float = BUDGET_S,
) -> str:
    before = (project / path).read_text()
    with CollectedTests(project, tests) as collected:
        measured = collected.measured()
        outcome = Judge(measured, budget).verdict(Mutant(Path(path), 0, len(before), content), collected)
        check_killers({path: outcome}, path, collected, measured)
        return outcome


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project of one file and its tests."""
    own = Path(__file__).parent
    shutil.copytree(own / "mutation", tmp_path / "tests" / "mutation")
    shutil.copy(own / "shared_builds.py", tmp_path / "tests")
    (tmp_path / "test_answer.py").write_text(textwrap.dedent(TESTS))
    (tmp_path / "answer.txt").write_text("42")
    (tmp_path / "pytest.ini").write_text("[pytest]\naddopts = -p no:l1_depth -p no:hypothesispytest\n")
    return tmp_path


@pytest.mark.parametrize(
    ("content", "outcome"),
    [
        ("43", f"{SURVIVED} 3 of 3 tests"),
        ("disturbed", f"{SURVIVED} 3 of 3 tests"),  # a test fails once
        ("41", f"{KILLED_BY}test_answer.py::test_answer"),
        ("crash", f"{KILLED_BY}test_answer.py::test_a"),  # the process ends in the setup
    ],
)
def test_a_mutant_is_killed_by_a_test_that_fails_twice(project: Path, content: str, outcome: str) -> None:
    assert judged(project, "answer.txt", content).startswith(outcome)
    assert (project / "answer.txt").read_text() == "42"


def test_a_mutant_that_does_not_end_is_ended(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server = project / "tests" / "mutation" / "server.py"
    server.write_text(server.read_text().replace("_LEAST_S, _TIMES = 30.0", "_LEAST_S, _TIMES = 0.5"))
    assert judged(project, "answer.txt", "hang").startswith(f"{TIME_LIMIT}test_answer.py::test_a")


def test_tests_beyond_the_budget_do_not_run(project: Path) -> None:
    assert judged(project, "answer.txt", "43", budget=1e-9) == f"{SURVIVED} 1 of 3 tests"


@pytest.mark.parametrize(
    ("before", "after", "killers"),
    [
        ("return number + 1", "return number + 2", {"test_following", "test_another"}),
        ("return self.number", "return -self.number", {"test_value"}),
        ("self.number = number", "self.number = 0", {"test_value"}),
        ("lambda: 42", "lambda: 43", {"test_answer_of_another_process"}),
    ],
)
def test_a_mutant_is_in_the_functions_that_the_tests_have_imported(
    project: Path, before: str, after: str, killers: set[str]
) -> None:
    content = textwrap.dedent(IMPORTED)
    (project / "answers.py").write_text(content)
    (project / "test_answer.py").write_text(textwrap.dedent(TESTS_OF_IMPORTED))
    start = content.index(before)
    mutant = Mutant(Path("answers.py"), start, start + len(before), after)
    with CollectedTests(project, ["test_answer.py"]) as collected:
        judge = Judge(collected.measured(), BUDGET_S)
        assert judge.verdict(mutant, collected) in {f"{KILLED_BY}test_answer.py::{test}" for test in killers}


def test_fixtures_and_files_that_are_shared_count_for_each_test_that_uses_them(project: Path) -> None:
    content = textwrap.dedent(IMPORTED)
    (project / "answers.py").write_text(content)
    (project / "test_answer.py").write_text(textwrap.dedent(TESTS_OF_IMPORTED))
    with CollectedTests(project, ["test_answer.py"]) as collected:
        measured = collected.measured()
    line = content[: content.index("return number + 1")].count("\n") + 1
    names = {name.partition("::")[2] for name in measured.lines["answers.py", line]}
    assert names == {"test_following", "test_one", "test_another", "test_file[1]", "test_file[2]"}


def test_a_statement_has_the_lines_of_its_head() -> None:
    content = "def f(\n  a):\n    if (a\n        > 1):\n        return (\n            a)\n    return 0\n"
    spans = [[*statement_lines(content, line)] for line in range(1, 8)]
    assert spans == [[1, 2], [1, 2], [3, 4], [3, 4], [5, 6], [5, 6], [7]]


def test_fewer_mutants_are_the_first_of_more() -> None:
    mutants = mutants_of(Path("a.py"), "def f(a, b):\n    return a + b * 2 < 3 - a / 4\n")
    assert chosen(mutants, 3, seed=5) == chosen(mutants, 6, seed=5)[:3]


@pytest.mark.parametrize(
    ("tests", "message"),
    [
        (["test_answer.py"], "test_answer.py::test_after fails without a mutant"),
        (["test_none.py"], "status 4"),
    ],
)
def test_where_tests_fail_anyway_nothing_is_killed(
    project: Path, monkeypatch: pytest.MonkeyPatch, tests: list[str], message: str
) -> None:
    monkeypatch.setenv("BROKEN", "1")
    with pytest.raises(BrokenEnvironmentError, match=message):
        judged(project, "answer.txt", "43", tests)


def test_a_collecting_pytest_that_dies_ends_the_measurement(project: Path) -> None:
    (project / "test_answer.py").write_text(
        "import os, signal\ndef test_answer(): os.kill(os.getppid(), signal.SIGKILL)\n"
    )
    with (
        pytest.raises(BrokenEnvironmentError, match=r"pytest ended with status -9 between two mutants"),
        CollectedTests(project, ["test_answer.py"]) as collected,
    ):
        collected.measured()
