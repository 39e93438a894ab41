"""The command line `l1-depth`: one module for each topic, gathered here.

The modules import at their top what declares a command, and in the body of the command what runs it, so that
help, completion and the message about a mistyped command do not wait for NumPy or an FMU.
"""

import os
import sys
from importlib.metadata import version as version_of
from typing import Annotated

import typer

from fmus.errors import ExportError, MissingExtraError
from orchestration.cli import exchange, fmu, identify, report, reproduce, run, speed, sweep
from orchestration.cli.shared import INTERRUPTED, fail
from orchestration.errors import OrchestrationError

app = typer.Typer(
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # square brackets stay what they are
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _panel, _commands in {
    "FMUs": (fmu.build, fmu.check, fmu.inspect),
    "Scenarios": (run.scenarios, run.run, sweep.sweep, report.report, speed.speed),
    "The paper": (reproduce.reproduce, identify.identify),
    "Other tools": (exchange.package, exchange.export),
}.items():
    for _command in _commands:
        app.command(rich_help_panel=_panel)(_command)


def _print_version(asked: bool) -> None:
    if asked:
        print(f"l1-depth {version_of('l1-depth')}")
        raise typer.Exit


@app.callback()
def _l1_depth(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Build, check and run FMUs for the depth control of an underwater vehicle by extended L1 adaptation."""


def main() -> None:
    """Entry point: a failure is one line on standard error.

    Exit status: 0, 1 for a failure, 2 for bad usage, 130 for an interrupt. With L1_DEPTH_DEBUG set, an error
    that is not foreseen comes with its traceback.
    """
    try:
        status = app(sys.argv[1:] or ["--help"], prog_name="l1-depth", standalone_mode=False)
    except (typer.Abort, KeyboardInterrupt):
        status = INTERRUPTED
    except (OrchestrationError, ExportError, MissingExtraError, OSError) as error:
        fail(str(error), INTERRUPTED if isinstance(error.__cause__, KeyboardInterrupt) else 1)
    except Exception as error:
        if hasattr(error, "format_message"):  # a usage error, of Click or of the copy of it in Typer
            fail(_usage(error), 2)
        if os.environ.get("L1_DEPTH_DEBUG"):
            raise
        fail(f"unforeseen {type(error).__name__}: {error}; set L1_DEPTH_DEBUG=1 for the traceback")
    if status == INTERRUPTED:
        fail("interrupted", INTERRUPTED)
    sys.exit(status if isinstance(status, int) else 0)


def _usage(error: Exception) -> str:
    context = getattr(error, "ctx", None)
    command = context.command_path if context else "l1-depth"
    message = error.format_message()  # type: ignore[attr-defined]
    return f"{message}{'' if message.endswith(('.', '?')) else '.'} See {command} --help."
