"""What counts as a mistake that the tests notice."""

import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.mutation.verdict import (
    KILLED_BY,
    SURVIVED,
    TIME_LIMIT,
    BrokenEnvironmentError,
    CollectedTests,
    check_killers,
    verdict,
)

pytestmark = pytest.mark.slow
LIMIT_S = 60.0
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
    from answers import Number, answer, following

    def test_all():
        assert (Number(3).value, following(3), answer()) == (3, 4, 42)
"""


def judged(
    project: Path, path: str, content: str, tests: Sequence[str] = ("test_answer.py",), limit: float = LIMIT_S
) -> str:
    with CollectedTests(project, tests) as collected:
        outcome = verdict(project, Path(path), content, collected, limit)
        check_killers({path: outcome}, path, collected, limit)
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
        ("43", SURVIVED),
        ("disturbed", SURVIVED),  # a test fails once
        ("41", f"{KILLED_BY}test_answer.py::test_answer"),
        ("crash", f"{KILLED_BY}test_answer.py::test_answer"),  # the process ends in the setup
    ],
)
def test_a_mutant_is_killed_by_the_first_test_that_fails(project: Path, content: str, outcome: str) -> None:
    assert judged(project, "answer.txt", content) == outcome
    assert (project / "answer.txt").read_text() == "42"


def test_a_mutant_that_does_not_end_is_killed_by_the_time_limit(project: Path) -> None:
    assert judged(project, "answer.txt", "hang", limit=5.0) == TIME_LIMIT


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("return number + 1", "return number + 2"),
        ("return self.number", "return -self.number"),
        ("self.number = number", "self.number = 0"),
        ("lambda: 42", "lambda: 43"),
    ],
)
def test_a_mutant_is_in_the_functions_that_the_tests_have_imported(
    project: Path, before: str, after: str
) -> None:
    (project / "answers.py").write_text(textwrap.dedent(IMPORTED))
    (project / "test_answer.py").write_text(textwrap.dedent(TESTS_OF_IMPORTED))
    mutated = textwrap.dedent(IMPORTED).replace(before, after)
    assert judged(project, "answers.py", mutated) == f"{KILLED_BY}test_answer.py::test_all"
    assert judged(project, "answers.py", textwrap.dedent(IMPORTED)) == SURVIVED


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
        collected.first_failure()
