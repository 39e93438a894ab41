"""A program whose process ends before the program does is no success, and the FMU that was busy is named."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

BUSY = """
import os, signal, struct, sys, time
from fmus.fmi.parent_process import end_is_meant, report_memory, results_are_written, run_watched
from fmus.fmi.parent_process import share_names
def busy():
    share_names(["good", "bad"])
    struct.pack_into("=7q", report_memory(56), 0, 0, 0, 0, 0, 0, 2, 0)
def program():
    {body}
    return 0
sys.exit(run_watched(program))
"""
LOST = "the run is lost; with --timeout FMUs have a process of their own\n"
WRITTEN = LOST.replace("the run is lost", "the files of the run are written")
SEGFAULT = "busy(); os.kill(os.getpid(), signal.SIGSEGV)"
REAL_TIME = "busy(); os.kill(os.getpid(), 37)"  # a signal without a name


def started(body: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", BUSY.format(body=body)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize(
    ("body", "status", "error"),
    [
        ("return 3", 3, ""),
        ("busy(); sys.exit(4)", 4, ""),
        ("end_is_meant(); os._exit(130)", 130, ""),
        ("busy(); os._exit(0)", 70, f"l1-depth: bad ended the process with exit status 0: {LOST}"),
        ("os._exit(5)", 70, f"l1-depth: something ended the process with exit status 5: {LOST}"),
        (REAL_TIME, 165, f"l1-depth: bad ended the process with signal 37: {LOST}"),
        (SEGFAULT, 139, f"l1-depth: bad ended the process with SIGSEGV: {LOST}"),
        (
            f"results_are_written(); {SEGFAULT}",
            139,
            f"l1-depth: bad ended the process with SIGSEGV: {WRITTEN}",
        ),
        ("results_are_written(); return 3", 3, ""),
        ("os._exit(70)", 70, "l1-depth: the run is lost\n"),
        ("results_are_written(); os._exit(70)", 70, "l1-depth: the files of the run are written\n"),
        (
            "signal.signal(signal.SIGTERM, signal.SIG_DFL); os.kill(os.getpid(), signal.SIGTERM)",
            130,
            "l1-depth: interrupted\n",
        ),
    ],
)
def test_an_end_that_the_program_did_not_decide_is_an_error(body: str, status: int, error: str) -> None:
    process = started(body)
    assert process.communicate() == ("", error)
    assert process.returncode == status


def test_what_is_registered_for_the_end_and_what_is_printed_is_not_lost() -> None:
    """Also of a thread that is still at work: the process ends without freeing what was imported."""
    at_work = "import threading; threading.Thread(target=lambda: (time.sleep(0.2), print('thread'))).start()"
    for body, printed in (("pass", "printed\nregistered\n"), (at_work, "printed\nthread\nregistered\n")):
        process = started(f"import atexit; atexit.register(print, 'registered'); print('printed'); {body}")
        assert process.communicate() == (printed, "")
        assert process.returncode == 0


def test_what_c_code_has_printed_is_not_lost() -> None:
    """As printf of an FMU does, into a pipe; without a standard output there is nothing to lose."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    for closed, printed in (("", b"printed"), (" >&-", b"")):
        code = BUSY.format(body="import ctypes; ctypes.CDLL(None).printf(b'printed'); return 3")
        done = subprocess.run(
            ["/bin/sh", "-c", f'exec "$0" -c "$1"{closed}', sys.executable, code],
            env=environment,
            capture_output=True,
            check=False,
            timeout=60,
        )
        assert (done.returncode, done.stdout, done.stderr) == (3, printed, b"")


def test_the_status_of_the_program_is_known_where_the_end_of_a_child_was_ignored_before() -> None:
    code = (
        "import signal, sys; signal.signal(signal.SIGCHLD, signal.SIG_IGN)\n"
        "from fmus.fmi.parent_process import run_watched; sys.exit(run_watched(lambda: 3))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (3, b"")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupt_from_another_process_is_passed_on(number: signal.Signals) -> None:
    wait = f"signal.signal({int(number)}, lambda *_: sys.exit(9)); print('ready', flush=True); time.sleep(60)"
    process = started(wait)
    assert process.stdout
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    assert process.communicate() == ("", "")
    assert process.returncode == 9


def test_the_program_is_interrupted_when_the_process_that_waits_is_killed(tmp_path: Path) -> None:
    file = tmp_path / "interrupted"
    touch = f"signal.signal(signal.SIGTERM, lambda *_: open({str(file)!r}, 'x') and sys.exit(1))"
    process = started(f"{touch}; print('ready', flush=True); time.sleep(60)")
    assert process.stdout
    assert process.stdout.readline() == "ready\n"
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()  # the child holds the streams until its end
    until = time.monotonic() + 60.0
    while not file.exists():
        assert time.monotonic() < until
        time.sleep(0.02)
