"""XML files beside the model description, whose formats are those of FMI 3.0."""

from functools import cache
from pathlib import Path
from typing import Any

from fmus.compliance.fmu_file import FmuFile, etree, parsed_xml
from fmus.compliance.rule import Condition
from fmus.platforms import FMPY

BUILD_DESCRIPTION = "sources/buildDescription.xml"
TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
SCHEMAS = FMPY / "schema"
_LARGEST = 100_000_000  # bytes


def unless_there(path: str) -> Condition:
    """Returns the reason why rules of an optional file do not apply to an FMU."""
    return lambda fmu: "" if path in fmu.paths else f"there is no {path}"


@cache
def schema_of(path: Path) -> Any:
    """Returns an XML schema, read once in a process."""
    return etree.XMLSchema(etree.parse(path))


def schema_errors(root: Any, path: Path) -> list[Any]:
    """Entries with `line`, `path` and `message`."""
    definition = schema_of(path)
    definition.validate(root.getroottree())
    return list(definition.error_log)


def fmi3_schema_errors(root: Any, name: str) -> list[str]:
    """Returns errors by a schema of FMI 3.0; any version may be stated, as FMI 2.0 does not say which."""
    stated = root.attrib.pop("fmiVersion", None)
    root.set("fmiVersion", "3.0")
    errors = [f"line {error.line}: {error.message}" for error in schema_errors(root, SCHEMAS / "fmi3" / name)]
    return errors if stated is not None else [*errors, "fmiVersion is missing: expected one"]


def parsed_member(fmu: FmuFile, path: str) -> tuple[Any, str]:
    """Returns (root element, what is wrong): the root is nothing if the file cannot be read."""
    try:
        return parsed_xml(fmu.read(path, _LARGEST)), ""
    except ValueError as error:
        return None, str(error)
