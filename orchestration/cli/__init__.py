"""The command line `l1-depth`; `app` imports libraries, and an interrupt may come while it does."""

import sys

from orchestration.cli.interrupts import interruptible


def main() -> None:
    """Entry point: a failure is one line on standard error.

    Exit status: 0, 1 for a failure, 2 for bad usage, 130 for an interrupt. With L1_DEPTH_DEBUG set, an error
    that is not foreseen comes with its traceback.
    """
    with interruptible():
        from orchestration.cli.app import run_command

        status = run_command(sys.argv[1:])
    sys.exit(status)
