"""The whole command line as a Typer application, for documentation and completion of other programs."""

from orchestration.cli.commands import application

app = application()
