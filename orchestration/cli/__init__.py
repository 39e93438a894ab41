"""The command line `l1-depth`; `commands` imports libraries, and an interrupt may come while it does."""

import gc
import os
import sys

_ALLOCATIONS = 200_000  # between collections of garbage: an import makes many objects that stay


def main() -> None:
    """Runs the command line; a failure is one line on standard error.

    Exit status: 0, 1 for a failure, 2 for bad usage, 70 if an FMU ended the process, 130 for an interrupt,
    141 if the reader of the output ended.
    With L1_DEPTH_DEBUG set, an error that is not foreseen comes with its traceback.
    """
    # each has the value None if it was closed, as by >&-
    sys.stdout, sys.stderr = (x or open(os.devnull, "w") for x in (sys.stdout, sys.stderr))  # noqa: SIM115, PTH123
    try:
        from fmus.fmi.parent_process import run_watched

        status = run_watched(run_interruptible)
    except KeyboardInterrupt:  # before there is a handler
        print("l1-depth: interrupted", file=sys.stderr)
        sys.exit(130)
    sys.exit(status)


def run_interruptible() -> int:
    """Runs a command in this process and returns its exit status."""
    from orchestration.cli.interrupts import interruptible

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads wait for each other where matrices are small
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # it would open a file of each package
    gc.set_threshold(_ALLOCATIONS)
    with interruptible():
        from orchestration.cli.commands import run_command

        return run_command(sys.argv[1:])
