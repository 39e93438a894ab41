"""The compiler's own refusals, and which platform this is."""

import contextlib
import ctypes
import math
import os
import platform
import signal
import subprocess
import sys
import time
from io import FileIO
from pathlib import Path
from typing import Any

import pytest

from fmus.errors import ExportError
from fmus.native import toolchain
from fmus.native.toolchain import compile_library, zig
from fmus.platforms import TARGETS, check_platforms, host_platform


@pytest.mark.parametrize(
    ("system", "machine", "name"),
    [
        ("linux", "x86_64", "linux64"),
        ("linux", "aarch64", "aarch64-linux"),
        ("darwin", "arm64", "aarch64-darwin"),
        ("win32", "AMD64", "win64"),
    ],
)
def test_the_host_is_named_as_fmi_does(
    monkeypatch: pytest.MonkeyPatch, system: str, machine: str, name: str
) -> None:
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    assert host_platform() == name


def test_an_unknown_host_is_told_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    with pytest.raises(ExportError, match=r"no native FMU for .* on riscv64: .*use the python flavour"):
        host_platform()


def test_platforms_are_taken_once_and_misspelt_ones_offer_the_nearest() -> None:
    assert check_platforms(["win64", "linux64", "win64"]) == ("win64", "linux64")
    with pytest.raises(ExportError, match="no platform 'darwin'; nearest is 'darwin64'"):
        check_platforms(["darwin"])


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("int main(void) { return nothing; }", "undeclared identifier 'nothing'"),
        ('#include "absent.h"', "(?s)'absent.h' file not found.*; expected that file among the sources$"),
    ],
)
def test_what_the_compiler_says_is_passed_on(tmp_path: Path, source: str, message: str) -> None:
    (tmp_path / "broken.c").write_text(source)
    with pytest.raises(ExportError, match=message):
        zig(["cc", "broken.c"], tmp_path)


def test_a_compiler_that_does_not_end_is_announced_and_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / "endless.c")
    monkeypatch.setattr(toolchain, "_SILENT_S", 0.001)
    monkeypatch.setattr(toolchain, "_PATIENCE_S", 0.001)
    with pytest.raises(ExportError, match=r"did not end within 0.001 s.* with a new cache"):
        zig(["cc", "endless.c"], tmp_path)
    assert "another build has the lock of its cache" in capsys.readouterr().err


def test_no_variable_of_the_environment_changes_a_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None of clang, nor of zig."""
    (tmp_path / "math.h").write_text("static inline double sin(double x) { return 0.5 * x; }\n")
    # no library of this text is in the compiler's cache, which tells no environments apart
    exported = f'__attribute__((visibility("default"))) /* {tmp_path} */'
    source = f"#include <math.h>\n{exported} double result(double x) {{ return sin(x); }}\n"
    with monkeypatch.context() as environment:
        environment.setenv("CCC_OVERRIDE_OPTIONS", f"+-I{tmp_path}")
        for variable in ("CPATH", "C_INCLUDE_PATH", "ZIG_LIB_DIR", "CFLAGS", "BASH_ENV", "ENV"):
            environment.setenv(variable, str(tmp_path))
        library = compile_library("sine", {"sine.c": source}, ["sine.c"], host_platform())
    (tmp_path / "library").write_bytes(library)
    result = ctypes.CDLL(str(tmp_path / "library")).result
    result.argtypes, result.restype = [ctypes.c_double], ctypes.c_double
    assert result(1.0) == math.sin(1.0)


def test_an_interrupt_while_the_compiler_ends_stays_an_interrupt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wait = subprocess.Popen.wait

    def interrupted(process: subprocess.Popen[bytes], timeout: float | None = None) -> None:
        wait(process, timeout)
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess.Popen, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        zig(["version"], tmp_path)


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_a_build_that_is_ended_leaves_no_process_and_an_interrupted_one_no_file(
    tmp_path: Path, end: signal.Signals
) -> None:
    """A process would keep the lock of the compiler's cache."""
    process, endless = compiling_for_ever(tmp_path)
    with endless.open("wb", buffering=0) as stream:  # opens when the compiler reads
        process.send_signal(end)
        assert process.wait(timeout=60) != 0
        assert end == signal.SIGKILL or not list((tmp_path / "temporary").iterdir())
        wait_for_the_end_of_readers(stream)


def test_builds_of_different_sources_do_not_wait_for_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They have files of the same names, by which the compiler names its locks."""
    process, endless = compiling_for_ever(tmp_path)
    monkeypatch.setattr(toolchain, "_PATIENCE_S", 30.0)
    monkeypatch.setattr(toolchain, "_awaited_lock", lambda group: pytest.fail("it waits"))
    with endless.open("wb", buffering=0):  # opens when the compiler reads, which has its locks then
        other = f"/* {tmp_path} */ int other(void) {{ return 3; }}"
        assert compile_library("m", {"m.c": other}, ["m.c"], host_platform())
        process.kill()
        process.wait()


@pytest.mark.skipif(not Path("/proc/locks").exists(), reason="locks are listed by Linux")
def test_the_lock_that_a_process_waits_for_is_named(tmp_path: Path) -> None:
    import fcntl

    locked = tmp_path / "locked.txt"
    code = f"import fcntl; fcntl.flock(open({str(locked)!r}), fcntl.LOCK_EX); print('has it', flush=True)"
    with locked.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        waiting = subprocess.Popen(
            [sys.executable, "-c", code], start_new_session=True, stdout=subprocess.PIPE
        )
        end = time.monotonic() + 30.0
        while not (lock := toolchain._awaited_lock(waiting.pid)) and time.monotonic() < end:
            time.sleep(0.01)
    assert lock == str(locked)
    assert waiting.communicate()[0] == b"has it\n"
    assert toolchain._awaited_lock(waiting.pid) == ""
    assert toolchain._awaited_lock(os.getpgid(0)) == ""


@pytest.mark.parametrize("ends", [True, False])
def test_a_compile_that_does_not_end_is_tried_again_in_a_cache_of_its_own(
    ends: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (target, *_), suffix = TARGETS[host_platform()]
    caches, run = list[str](), toolchain._running

    def running(arguments: list[str], folder: Path, cache: str = "") -> Any:
        caches.append(cache)
        if cache and ends:  # in place of a compile that takes its C library as well
            assert Path(cache).is_dir()
            (folder / target / f"m.{suffix}").write_bytes(b"a library")
            return contextlib.nullcontext(lambda: None)
        return run(arguments, folder, cache)

    os.mkfifo(tmp_path / "endless.h")
    monkeypatch.setattr(toolchain, "_running", running)
    monkeypatch.setattr(toolchain, "_awaited_lock", lambda group: "/cache/h/1.txt")
    monkeypatch.setattr(toolchain, "_PATIENCE_S", 0.001)
    source, error = f'#include "{tmp_path}/endless.h"', ""
    try:
        assert compile_library("m", {"m.c": source}, ["m.c"], host_platform()) == b"a library"
    except ExportError as refusal:
        error = str(refusal)
    assert len(caches) == 2
    assert [bool(cache) for cache in caches] == [False, True]
    assert not Path(caches[1]).exists()
    name = f"zig cc of {target}/m.{suffix}"
    late = f"{name} did not end within 0.001 s; it waits for /cache/h/1.txt"
    assert f"{late}; it is tried once more, with a new cache" in capsys.readouterr().err
    assert error.startswith("" if ends else f"{late}, with a new cache")
    assert bool(error) is not ends


@pytest.mark.parametrize("cache", ["", "own"])
def test_a_cache_of_its_own_takes_the_place_of_both_caches(
    cache: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", "global")
    monkeypatch.setenv("ZIG_LOCAL_CACHE_DIR", "local")
    monkeypatch.setattr(toolchain, "_ZIG", sys.executable)
    names = "ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"
    code = f"import os; open('caches', 'w').write(' '.join(os.environ[name] for name in {names}))"
    with toolchain._running(["-c", code], tmp_path, cache) as end:
        end()
    assert (tmp_path / "caches").read_text() == ("own own" if cache else "global local")


def compiling_for_ever(folder: Path) -> tuple[subprocess.Popen[bytes], Path]:
    """A process whose compiler reads a header that does not end, and the header."""
    temporary, endless = folder / "temporary", folder / "endless.h"
    temporary.mkdir()
    os.mkfifo(endless)
    source = f'#include "{endless}"'
    call = f"compile_library('m', {{'m.c': {source!r}}}, ['m.c'], {host_platform()!r})"
    process = subprocess.Popen(
        [sys.executable, "-c", f"from fmus.native.toolchain import compile_library; {call}"],
        env={**os.environ, "TMPDIR": str(temporary)},
        stderr=subprocess.DEVNULL,
    )
    return process, endless


def wait_for_the_end_of_readers(stream: FileIO) -> None:
    """Only the compiler has the FIFO open for reading."""
    end = time.monotonic() + 30.0
    with contextlib.suppress(BrokenPipeError):
        while time.monotonic() < end:
            stream.write(b" ")
            time.sleep(0.01)
        pytest.fail("the compiler goes on")
