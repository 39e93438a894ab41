"""The binding of FMI 2.0: names of statuses, the library for a machine, logs, counted memory."""

import pytest

from fmus.fmi import binding
from fmus.fmi.binding import library_member, status_name
from fmus.fmi.callbacks import CountingAllocator, Log

MEMBERS = ("binaries/aarch64-linux/m.so", "binaries/linux64/m.so", "sources/m.c")


def test_a_status_that_fmi_does_not_know_is_named_by_its_number() -> None:
    assert [status_name(status) for status in (0, 5, 6, -1)] == ["ok", "pending", "status 6", "status -1"]


@pytest.mark.parametrize(
    ("host", "fmpy_platform", "path"),
    [
        ("aarch64-linux", "linux64", "binaries/aarch64-linux/m.so"),
        ("win64", "linux64", "binaries/linux64/m.so"),
        ("win64", "darwin64", None),
    ],
)
def test_the_library_of_the_fmi_platform_goes_before_that_of_fmpy(
    monkeypatch: pytest.MonkeyPatch, host: str, fmpy_platform: str, path: str | None
) -> None:
    monkeypatch.setattr(binding, "host_platform", lambda: host)
    monkeypatch.setattr(binding, "SYSTEM_PLATFORM", fmpy_platform)
    monkeypatch.setattr(binding, "SHARED_LIBRARY_SUFFIX", ".so")
    assert library_member(MEMBERS, "m") == path


def test_a_log_leaves_repetitions_out_and_marks_errors() -> None:
    log = Log()
    for status, message in ((1, "hot"), (1, "hot\n"), (3, "too  hot"), (1, "hot")):
        log.add(status, message)
    assert log == [(1, "hot"), (3, "too hot"), (1, "hot")]
    assert log.error_logged[0]
    log.clear()
    assert not log
    assert not log.error_logged[0]


def test_memory_in_use_and_frees_of_other_addresses_are_counted() -> None:
    memory = CountingAllocator()
    first, second = memory.allocate(3, 8), memory.allocate(0, 8)
    memory.free(first)
    assert set(memory.held) == {second}
    memory.free(None)  # as free of C takes it
    assert memory.foreign_frees == 0
    memory.free(first)
    assert memory.foreign_frees == 1
