"""A worker process: it answers, it ends with its parent, and its ending has words."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from fmus.fmi.process import ProcessEndedError, WorkerProcess, ending
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

TO_START_S = 60.0  # for an interpreter on a machine that is busy


def test_a_worker_answers_whatever_it_prints_or_reads(tmp_path: Path) -> None:
    process = WorkerProcess(answer, tmp_path)
    process.send({"a": 1})
    assert process.receive(TO_START_S) == ("", {"a": 1}, str(process.folder))
    process.close()
    assert not list(tmp_path.iterdir())


def test_an_interrupt_at_the_terminal_is_not_for_it(tmp_path: Path) -> None:
    """That goes to a session."""
    process = WorkerProcess(sleep, tmp_path)
    assert os.getsid(process.pid) != os.getsid(0)
    process.close()


def test_a_time_limit_leaves_the_process(tmp_path: Path) -> None:
    process = WorkerProcess(answer, tmp_path)
    with pytest.raises(TimeoutError):
        process.receive(0.01)
    process.send(1)
    assert process.receive(TO_START_S)[1] == 1
    process.close()


def test_a_signal_that_arrives_as_a_time_limit_ends_does_not_prolong_it(tmp_path: Path) -> None:
    def fail_if_late(number: int, frame: object) -> None:
        assert time.monotonic() < deadline

    process = WorkerProcess(sleep, tmp_path)
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
        process.close()


def test_a_crash_is_told_each_time(tmp_path: Path) -> None:
    process = WorkerProcess(die, tmp_path)
    for _ in range(2):
        with pytest.raises(ProcessEndedError, match=r"^SIGKILL$") as caught:
            process.receive(TO_START_S)
        assert caught.value.status == -signal.SIGKILL
    process.send("to nobody")
    process.close()


def test_an_error_leaves_its_last_line(tmp_path: Path) -> None:
    process = WorkerProcess(fail, tmp_path)
    with pytest.raises(ProcessEndedError, match=r"^exit status 1$") as caught:
        process.receive(TO_START_S)
    assert caught.value.last_error_line == "ValueError: no data"
    process.close()


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
def test_what_it_started_ends_with_it(tmp_path: Path) -> None:
    process = WorkerProcess(leave_a_child, tmp_path)
    child = psutil.Process(process.receive(TO_START_S))
    process.close()
    with contextlib.suppress(psutil.NoSuchProcess):
        psutil.wait_procs([child], TO_START_S)
        assert child.status() == psutil.STATUS_ZOMBIE  # where nobody waits for orphans


def test_much_on_standard_error_takes_no_room_and_its_last_line_is_kept(tmp_path: Path) -> None:
    process = WorkerProcess(flood_errors, tmp_path)
    assert process.receive(TO_START_S) == 0
    with pytest.raises(ProcessEndedError) as caught:
        process.receive(TO_START_S)
    assert caught.value.last_error_line == "the last line"
    process.close()


def test_it_imports_nothing_from_a_folder_that_it_enters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend("")  # as `python -c` has it
    (tmp_path / "wave.py").write_text("raise RuntimeError('of the folder')")
    process = WorkerProcess(import_where_it_is)
    process.send(str(tmp_path))
    assert Path(process.receive(TO_START_S)).parent != tmp_path
    process.close()


def test_nothing_is_run_that_an_untrusted_process_sends(tmp_path: Path) -> None:
    process = WorkerProcess(send_a_trap, trusted=False)
    process.send(str(tmp_path / "sprung"))
    with pytest.raises(ValueError):  # noqa: PT011 - of the JSON decoder, or of the Unicode one
        process.receive(TO_START_S)
    assert not list(tmp_path.iterdir())
    process.close()


def test_an_untrusted_process_that_sends_more_than_it_is_asked_for_is_ended(tmp_path: Path) -> None:
    process = WorkerProcess(flood_messages, tmp_path, trusted=False)
    deadline = time.monotonic() + TO_START_S
    while psutil.pid_exists(process.pid):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert [process.receive(TO_START_S) for _ in range(2)] == ["x" * 1000] * 2
    with pytest.raises(ProcessEndedError, match=r"^SIGKILL$"):
        process.receive(TO_START_S)
    process.close()


def test_a_forked_child_answers_no_request_and_ends_the_process(tmp_path: Path) -> None:
    process = WorkerProcess(fork, tmp_path)
    process.send(1)
    assert process.receive(TO_START_S) == 1
    process.send("fork")
    for _ in range(2):
        with pytest.raises(
            ProcessEndedError, match=r"^SIGKILL, since an FMU forked it and the child returned"
        ):
            process.receive(TO_START_S)
    process.close()


def test_a_forked_child_that_keeps_the_pipe_does_not_hide_the_end(tmp_path: Path) -> None:
    process = WorkerProcess(fork, tmp_path)
    process.send("die")
    with pytest.raises(ProcessEndedError, match=r"^SIGKILL$"):
        process.receive(TO_START_S)
    process.close()


def test_an_answer_to_an_earlier_request_is_not_that_to_the_last(tmp_path: Path) -> None:
    process = WorkerProcess(answer_twice, tmp_path)
    for message in range(3):
        process.send(message)
        assert process.receive(TO_START_S) == message
    process.close()
