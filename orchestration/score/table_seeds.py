"""The seeds of the table of a score. Who tunes must not import this module."""

from pathlib import Path

from pydantic import TypeAdapter

from orchestration.scenarios.file_tables import checked
from orchestration.scenarios.toml_file import read_toml
from orchestration.score.protocol_format import TableFile

FILE = Path(__file__).with_name("table.toml")
_FILE = TypeAdapter(TableFile)


def table_seeds() -> TableFile:
    """Returns the seeds of the cases and of the plants."""
    file = read_toml(FILE)
    return checked(_FILE, file.data, file.at)
