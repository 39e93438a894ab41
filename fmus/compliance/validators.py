"""Checks of others: FMI's own schema, and FMPy's validation."""

from collections.abc import Iterator
from pathlib import Path

from fmus.compliance.fmu_file import FmuFile, etree
from fmus.compliance.rule import Stage, rule

_SCHEMA = Path("schema") / "fmi2" / "fmi2ModelDescription.xsd"


@rule("2.2 FMI Description Schema", Stage.DESCRIPTION)
def schema(fmu: FmuFile) -> Iterator[str]:
    """The model description is valid by the XML schema of FMI 2.0."""
    import fmpy

    definition = etree.XMLSchema(etree.parse(Path(fmpy.__file__).parent / _SCHEMA))
    definition.validate(fmu.root.getroottree())
    for error in definition.error_log:
        yield f"line {error.line}: {error.message}"


@rule("2.2 FMI Description Schema, as FMPy reads it", Stage.DESCRIPTION)
def fmpy_validation(fmu: FmuFile) -> Iterator[str]:
    """FMPy's validate_fmu finds no problem."""
    from fmpy.validation import validate_fmu

    yield from validate_fmu(str(fmu.path))
