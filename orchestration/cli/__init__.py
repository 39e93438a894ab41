"""The command line `l1-depth`: a module a topic, gathered here.

Commands import where they run what takes long to import and only they need: `--help` waits for nothing.
"""

import os
import sys

import typer

from fmus.errors import ExportError, MissingExtraError
from orchestration.cli import exchange, fmu, pages, simulation, sweeps
from orchestration.errors import OrchestrationError

app = typer.Typer(
    help="Extended L1 adaptive depth control of an underwater vehicle: FMUs and their master.",
    add_completion=False,
    pretty_exceptions_enable=False,
)
for _command in (
    fmu.build, fmu.check, fmu.inspect,
    simulation.run, simulation.scenarios, simulation.identify, simulation.reproduce, simulation.bench,
    sweeps.sweep, pages.report,
    exchange.package, exchange.export, exchange.importers,
):  # fmt: skip
    app.command()(_command)


def main() -> None:
    """Entry point: every failure is one line on standard error; exit status 1, or 2 for bad usage.

    With L1_DEPTH_DEBUG set, an error that nobody foresaw comes with its traceback.
    """
    if len(sys.argv) == 1:
        sys.argv.append("--help")
    try:
        app(standalone_mode=False)
    except (typer.Abort, KeyboardInterrupt):
        _fail("interrupted", 1)
    except (OrchestrationError, ExportError, MissingExtraError, OSError) as error:
        _fail(str(error), 1)
    except Exception as error:
        usage = getattr(error, "format_message", None)  # click's own errors, wherever typer keeps them
        if usage:
            _fail(f"{usage()} Try --help.", 2)
        if os.environ.get("L1_DEPTH_DEBUG"):
            raise
        _fail(f"unforeseen {type(error).__name__}: {error}; set L1_DEPTH_DEBUG=1 for the traceback", 1)


def _fail(message: str, status: int) -> None:
    print(f"l1-depth: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(status)
