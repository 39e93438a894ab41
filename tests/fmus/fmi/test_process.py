"""A worker process: it answers, it ends with its parent, and its ending has words."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from fmus.fmi.process import ProcessEndedError, Worker, WorkerProcess, ending
from tests.fmus.fmi.process_workers import (
    answer,
    answer_twice,
    die,
    fail,
    flood_errors,
    flood_messages,
    fork,
    import_where_it_is,
    leave_a_child,
    send_a_trap,
    sleep,
)

Start = Callable[..., WorkerProcess]
TO_START_S = 60.0  # for an interpreter on a machine that is busy


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts workers with their folders in `tmp_path`; they are closed after the test."""
    with contextlib.ExitStack() as stack:

        def one(worker: Worker, folder: Path | None = tmp_path, **options: bool) -> WorkerProcess:
            return stack.enter_context(contextlib.closing(WorkerProcess(worker, folder, **options)))

        yield one


def test_a_worker_answers_whatever_it_prints_or_reads(start: Start, tmp_path: Path) -> None:
    process = start(answer)
    process.send({"a": 1})
    assert process.receive(TO_START_S) == ("", {"a": 1}, str(process.folder))
    process.close()
    assert not list(tmp_path.iterdir())


def test_an_interrupt_at_the_terminal_is_not_for_it(start: Start) -> None:
    """That goes to a session."""
    process = start(sleep)
    assert os.getsid(process.pid) != os.getsid(0)


def test_a_time_limit_leaves_the_process(start: Start) -> None:
    process = start(answer)
    with pytest.raises(TimeoutError):
        process.receive(0.01)
    process.send(1)
    assert process.receive(TO_START_S)[1] == 1


def test_a_signal_that_arrives_as_a_time_limit_ends_does_not_prolong_it(start: Start) -> None:
    def fail_if_late(number: int, frame: object) -> None:
        assert time.monotonic() < deadline

    process = start(sleep)
    before = signal.signal(signal.SIGALRM, fail_if_late)
    deadline = time.monotonic() + TO_START_S
    try:
        for microseconds in range(950, 1100):
            signal.setitimer(signal.ITIMER_REAL, 1e-6 * microseconds, 0.5)
            with pytest.raises(TimeoutError):
                process.receive(0.001)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_a_crash_is_told_each_time(start: Start) -> None:
    process = start(die)
    for _ in range(2):
        with pytest.raises(ProcessEndedError, match=r"^SIGKILL$") as caught:
            process.receive(TO_START_S)
        assert caught.value.status == -signal.SIGKILL
    process.send("to nobody")


def test_an_error_leaves_its_last_line(start: Start) -> None:
    process = start(fail)
    with pytest.raises(ProcessEndedError, match=r"^exit status 1$") as caught:
        process.receive(TO_START_S)
    assert caught.value.last_error_line == "ValueError: no data"


def test_it_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    """A parent that has no time to close anything."""
    script = (
        "import time; from pathlib import Path; from fmus.fmi.process import WorkerProcess\n"
        "from tests.fmus.fmi.process_workers import sleep\n"
        f"print(WorkerProcess(sleep, Path({str(tmp_path)!r})).pid, flush=True); time.sleep(600)"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout
    worker = psutil.Process(int(parent.stdout.readline()))
    parent.kill()
    parent.communicate()
    begun = time.monotonic()
    while worker.is_running() and worker.status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() - begun < TO_START_S
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (0, "exit status 0"),
        (-11, "SIGSEGV"),
        (-37, "signal 37"),  # a real-time one has no name
        (0xC0000005, "exit status 0xc0000005"),  # an access violation on Windows
    ],
)
def test_an_ending_has_words(status: int, words: str) -> None:
    assert ending(status) == words


@pytest.mark.skipif(os.name == "nt", reason="Windows has no process groups of this kind")
def test_what_it_started_ends_with_it(start: Start) -> None:
    process = start(leave_a_child)
    child = psutil.Process(process.receive(TO_START_S))
    process.close()
    with contextlib.suppress(psutil.NoSuchProcess):
        psutil.wait_procs([child], TO_START_S)
        assert child.status() == psutil.STATUS_ZOMBIE  # where nobody waits for orphans


def test_much_on_standard_error_takes_no_room_and_its_last_line_is_kept(start: Start) -> None:
    process = start(flood_errors)
    assert process.receive(TO_START_S) == 0
    with pytest.raises(ProcessEndedError) as caught:
        process.receive(TO_START_S)
    assert caught.value.last_error_line == "the last line"


def test_it_imports_nothing_from_a_folder_that_it_enters(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend("")  # as `python -c` has it
    (tmp_path / "wave.py").write_text("raise RuntimeError('of the folder')")
    process = start(import_where_it_is)
    process.send(str(tmp_path))
    assert Path(process.receive(TO_START_S)).parent != tmp_path


def test_nothing_is_run_that_an_untrusted_process_sends(start: Start, tmp_path: Path) -> None:
    process = start(send_a_trap, None, trusted=False)
    process.send(str(tmp_path / "sprung"))
    with pytest.raises(ValueError):  # noqa: PT011 - of the JSON decoder, or of the Unicode one
        process.receive(TO_START_S)
    assert not list(tmp_path.iterdir())


def test_an_untrusted_process_that_sends_more_than_it_is_asked_for_is_ended(start: Start) -> None:
    process = start(flood_messages, trusted=False)
    deadline = time.monotonic() + TO_START_S
    while psutil.pid_exists(process.pid):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert [process.receive(TO_START_S) for _ in range(2)] == ["x" * 1000] * 2
    with pytest.raises(ProcessEndedError, match=r"^SIGKILL$"):
        process.receive(TO_START_S)


def test_a_forked_child_answers_no_request_and_ends_the_process(start: Start) -> None:
    process = start(fork)
    process.send(1)
    assert process.receive(TO_START_S) == 1
    process.send("fork")
    for _ in range(2):
        with pytest.raises(ProcessEndedError, match=r"^SIGKILL, since an FMU forked it and the child ret"):
            process.receive(TO_START_S)


def test_a_forked_child_that_keeps_the_pipe_does_not_hide_the_end(start: Start) -> None:
    process = start(fork)
    process.send("die")
    with pytest.raises(ProcessEndedError, match=r"^SIGKILL$"):
        process.receive(TO_START_S)


def test_an_answer_to_an_earlier_request_is_not_that_to_the_last(start: Start) -> None:
    process = start(answer_twice)
    for message in range(3):
        process.send(message)
        assert process.receive(TO_START_S) == message
