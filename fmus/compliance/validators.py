"""Checks of others: FMI's own schema, FMPy and the FMU manipulation toolbox."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fmus.compliance.fmu_file import FmuFile, etree
from fmus.compliance.rule import Stage, rule
from fmus.extras import require

_SCHEMA = Path("schema") / "fmi2" / "fmi2ModelDescription.xsd"
_TOOLBOX = "fmu_manipulation_toolbox"


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


class _ErrorMessages(logging.Handler):
    """Collects the messages that are logged as errors."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


def _toolbox(fmu: FmuFile, operation: str) -> list[str]:
    """The errors that one check of the toolbox logs. Raises what the toolbox raises."""
    checker: Any = require("fmu_manipulation_toolbox.checker", "check", "a check of FMUs")
    operations: Any = require("fmu_manipulation_toolbox.operations", "check", "a check of FMUs")
    handler, logger = _ErrorMessages(), logging.getLogger(_TOOLBOX)
    propagated, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        with operations.FMU(str(fmu.path)) as opened:
            opened.apply_operation(getattr(checker, operation)())
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagated
    return handler.messages


@rule("2.2 FMI Description Schema, as fmutool -check reads it", Stage.DESCRIPTION)
def fmutool_generic_check(fmu: FmuFile) -> Iterator[str]:
    """The generic check of fmutool -check finds no error."""
    yield from _toolbox(fmu, "OperationGenericCheck")


@rule("2.2.7 and 2.2.8, as fmutool -check reads them", Stage.DESCRIPTION)
def fmutool_semantic_check(fmu: FmuFile) -> Iterator[str]:
    """The semantic check of fmutool -check finds no error."""
    yield from _toolbox(fmu, "OperationSemanticCheck")
