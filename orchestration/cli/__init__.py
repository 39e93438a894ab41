"""The command line `l1-depth`; `app` imports libraries, and an interrupt may come while it does."""

import sys


def main() -> None:
    """Entry point: a failure is one line on standard error.

    Exit status: 0, 1 for a failure, 2 for bad usage, 130 for an interrupt. With L1_DEPTH_DEBUG set, an error
    that is not foreseen comes with its traceback.
    """
    try:
        from orchestration.cli.interrupts import interruptible

        with interruptible():
            from orchestration.cli.app import run_command

            status = run_command(sys.argv[1:])
    except KeyboardInterrupt:  # before there is a handler
        print("l1-depth: interrupted", file=sys.stderr)
        sys.exit(130)
    sys.exit(status)
