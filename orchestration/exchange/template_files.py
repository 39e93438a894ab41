"""The texts of `files/`: Modelica and MATLAB as they are, `${name}` where a value stands."""

from importlib import resources
from string import Template

_FOLDER = resources.files("orchestration.exchange") / "files"


def filled(file: str, /, **values: object) -> str:
    """The text of a file with its placeholders replaced."""
    return Template((_FOLDER / file).read_text(encoding="utf-8")).substitute(values)
