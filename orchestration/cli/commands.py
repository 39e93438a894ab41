"""Commands by name, each in a module that is imported when it is needed, and the message of a failure.

The modules import at their top what declares a command, and in the body of the command what runs it, so that
help, completion and the message about a mistyped command do not wait for NumPy or an FMU.
"""

import os
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from fmus import registry
from fmus.errors import ExportError, MissingExtraError
from orchestration.cli.interrupts import INTERRUPTED, is_interrupted
from orchestration.cli.shared import fail
from orchestration.errors import FmuWarning, OrchestrationError, ScenarioWarning

_OTHERS = "Other tools"
OUTPUT_CLOSED = 141  # exit status that shells report for SIGPIPE

_PANELS = {
    "FMUs": ("fmu.new", "fmu.build", "fmu.verify", "fmu.inspect", "cache.cache"),
    "Scenarios": ("run.scenarios", "run.run", "sweep.sweep", "explain.explain"),
    "Controllers compared": (),
    "Vehicles": (),
    "The paper": ("run.reproduce",),
    _OTHERS: ("exchange.package",),
}
"""Panel of the help, in its order -> module of this package, and function in it: a command of that name."""
_CORE = {
    where.partition(".")[2]: (where.partition(".")[0], panel)
    for panel, functions in _PANELS.items()
    for where in functions
}


def command_names() -> list[str]:
    """Returns the names of all commands: first of this package, then the installed ones.

    The latter are entry points of the group `l1_depth.commands`; their modules may state the `PANEL` of the
    help. None takes the name of a command of this package.
    """
    return list(dict.fromkeys([*_CORE, *registry.installed(registry.COMMANDS)]))


def command_function(name: str) -> tuple[Callable[..., None], str]:
    """Returns the function of a command, and its panel of the help; ExportError if it cannot be loaded."""
    if name in _CORE:
        module, panel = _CORE[name]
        return getattr(import_module(f"orchestration.cli.{module}"), name), panel
    point = registry.installed(registry.COMMANDS)[name]
    function = registry.load(point, "command")
    return function, getattr(import_module(point.module), "PANEL", _OTHERS)


def application(names: Iterable[str] = ()) -> typer.Typer:
    """Returns the command line with these commands, by default all; only their modules are imported.

    Of all commands, one of another package that cannot be loaded is named on standard error and left out.
    """
    app = typer.Typer(
        callback=_l1_depth,
        pretty_exceptions_enable=False,
        rich_markup_mode="markdown",  # square brackets stay what they are
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    found = dict[str, tuple[Callable[..., None], str]]()
    for name in names or command_names():
        try:
            found[name] = command_function(name)
        except ExportError as error:
            if names:
                raise
            print(f"l1-depth: warning: {error}", file=sys.stderr)
    panels = [*_PANELS]
    for name, (function, panel) in sorted(
        found.items(), key=lambda item: panels.index(item[1][1]) if item[1][1] in panels else len(panels)
    ):
        app.command(name, rich_help_panel=panel)(function)
    return app


def _print_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version as version_of

        print(f"l1-depth {version_of('l1-depth')}")
        raise typer.Exit


def _l1_depth(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Build, check and run FMUs for the depth control of an underwater vehicle by extended L1 adaptation."""


def run_command(arguments: Sequence[str]) -> int:
    """Runs a command and returns its exit status, as `run_application` does."""
    first = arguments[:1]
    return run_application(
        lambda: application(first if first and (first[0] in _CORE or first[0] in command_names()) else ()),
        arguments,
    )


def run_application(made: Callable[[], typer.Typer], arguments: Sequence[str], name: str = "l1-depth") -> int:
    """Runs a command line and returns its exit status; a failure is a line on standard error and SystemExit.

    A command whose output is no longer read, as with `| head`, ends without a message.
    made: returns the application; name: of the program
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", ScenarioWarning)
            warnings.showwarning = partial(_show_warning, warnings.showwarning)
            status = made()(list(arguments) or ["--help"], prog_name=name, standalone_mode=False)
        print(end="", flush=True)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except (BrokenPipeError, SystemExit) as error:
        if BrokenPipeError not in (type(error), type(error.__context__)):  # Typer makes SystemExit of it
            raise
        # the rest of the output would be an error at the end of Python
        sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115
        return OUTPUT_CLOSED
    except (OrchestrationError, ExportError, MissingExtraError, OSError) as error:
        file = getattr(error, "filename", None)
        # of an error of the system, the number says nothing to a user
        text = f"{file}: {error.strerror}" if isinstance(error, OSError) and file else str(error)
        fail(text, INTERRUPTED if isinstance(error.__cause__, KeyboardInterrupt) else 1)
    except Exception as error:
        if hasattr(error, "format_message"):  # a usage error, of Click or of the copy of it in Typer
            fail(_usage(error), 2)
        if is_interrupted():
            raise KeyboardInterrupt from None
        if os.environ.get("L1_DEPTH_DEBUG"):
            raise
        fail(f"unforeseen {type(error).__name__}: {error}; set L1_DEPTH_DEBUG=1 for the traceback")
    if status == INTERRUPTED:  # Typer's, of a KeyboardInterrupt
        raise KeyboardInterrupt
    return status if isinstance(status, int) else 0


def _show_warning(usual: Callable[..., None], message: object, category: type[Warning], *place: Any) -> None:
    """Prints a warning of a scenario or of an FMU as a line, any other one as usual."""
    if issubclass(category, FmuWarning | ScenarioWarning):
        print(f"l1-depth: warning: {message}", file=sys.stderr)
    else:
        usual(message, category, *place)


def _usage(error: Exception) -> str:
    context = getattr(error, "ctx", None)
    command = context.command_path if context else "l1-depth"
    message = error.format_message()  # type: ignore[attr-defined]
    return f"{message}{'' if message.endswith(('.', '?')) else '.'} See {command} --help."
