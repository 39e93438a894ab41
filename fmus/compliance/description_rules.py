"""Rules of the model description as a whole, its types and its CoSimulation element."""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import fmpy

from fmus.compliance.archive_rules import unreadable
from fmus.compliance.fmu_file import C_IDENTIFIER, FmuFile, etree
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.variable import integer, number

_HEAD = "2.2.1 Definition of an FMU (fmiModelDescription)"
_TYPES = "2.2.3 Definition of Types (TypeDefinitions)"
_SCHEMA = Path(fmpy.__file__).parent / "schema" / "fmi2" / "fmi2ModelDescription.xsd"
_DATE = re.compile(r"\d{4}-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])T([01]\d|2[0-3]):[0-5]\d:[0-5]\d(\.\d+)?Z")
_UTF_8 = re.compile(rb"(\xef\xbb\xbf)?<\?xml[^>]*encoding=[\"']utf-8[\"']", re.IGNORECASE)


@rule("2.2 FMI Description Schema", Stage.FILE, condition=unreadable)
def description_is_readable(fmu: FmuFile) -> Iterable[str]:
    """modelDescription.xml is well-formed XML without a document type declaration."""
    return [fmu.description_problem] if fmu.description_problem else []


@rule("2.2 FMI Description Schema", Stage.DESCRIPTION)
def description_is_utf_8(fmu: FmuFile) -> Iterator[str]:
    """The XML declaration says encoding UTF-8."""
    if not _UTF_8.match(fmu.xml):
        yield f'it begins {fmu.xml[:40]!r}: expected <?xml version="1.0" encoding="UTF-8"?>'


@rule("2.2 FMI Description Schema", Stage.DESCRIPTION)
def schema(fmu: FmuFile) -> Iterator[str]:
    """The model description is valid by the XML schema of FMI 2.0."""
    definition = etree.XMLSchema(etree.parse(_SCHEMA))
    definition.validate(fmu.root.getroottree())
    for error in definition.error_log:
        yield f"line {error.line}: {error.message}"


@rule(_HEAD, Stage.DESCRIPTION)
def fmi_version(fmu: FmuFile) -> Iterator[str]:
    """fmiVersion is 2.0."""
    if fmu.root.get("fmiVersion") != "2.0":
        yield f"fmiVersion {fmu.root.get('fmiVersion')!r}: expected '2.0'"


@rule(_HEAD, Stage.DESCRIPTION)
def guid_is_given(fmu: FmuFile) -> Iterator[str]:
    """The GUID, which ties description and library together, is not empty."""
    if not fmu.guid.strip():
        yield f"guid {fmu.guid!r}: expected a string that identifies the FMU"


@rule(_HEAD, Stage.DESCRIPTION)
def generation_date(fmu: FmuFile) -> Iterator[str]:
    """generationDateAndTime is an ISO date in UTC, YYYY-MM-DDThh:mm:ssZ."""
    date = fmu.root.get("generationDateAndTime")
    if date is not None and not _DATE.fullmatch(date):
        yield f"generationDateAndTime {date!r}: expected YYYY-MM-DDThh:mm:ssZ, ending in Z"


@rule("2.2.4 Definition of Log Categories (LogCategories)", Stage.DESCRIPTION)
def log_categories_are_unique(fmu: FmuFile) -> Iterator[str]:
    """No two log categories have the same name."""
    yield from _repeated(
        "log category", [element.get("name") for element in fmu.root.iterfind("LogCategories/Category")]
    )


def _repeated(what: str, names: Iterable[str | None]) -> Iterator[str]:
    for name, count in repeated(names).items():
        yield f"{what} {name!r} is defined {count} times: expected once"


@rule("2.2.5 Definition of a Default Experiment (DefaultExperiment)", Stage.DESCRIPTION)
def default_experiment(fmu: FmuFile) -> Iterator[str]:
    """The default experiment stops after it starts; step size and tolerance are positive."""
    experiment = fmu.root.find("DefaultExperiment")
    if experiment is None:
        return
    begin, end = number(experiment.get("startTime", "0")), number(experiment.get("stopTime"))
    if begin is not None and end is not None and end <= begin:
        yield f"stopTime {end:g}: expected more than startTime {begin:g}"
    for attribute in ("stepSize", "tolerance"):
        value = number(experiment.get(attribute))
        if value is not None and value <= 0:
            yield f"{attribute} {value:g}: expected more than 0"


@rule("4.3.1 Co-Simulation FMU (CoSimulation), 3.3.1 ModelExchange", Stage.DESCRIPTION)
def model_identifier(fmu: FmuFile) -> Iterator[str]:
    """modelIdentifier is a C identifier, as it names files and the prefix of functions."""
    for kind, attributes in fmu.interfaces.items():
        identifier = attributes.get("modelIdentifier", "")
        if not C_IDENTIFIER.fullmatch(identifier):
            yield f"{kind} modelIdentifier {identifier!r}: expected letters, digits and _, no digit first"


@rule("4.3.1 Co-Simulation FMU (CoSimulation)", Stage.DESCRIPTION)
def capabilities_agree(fmu: FmuFile) -> Iterator[str]:
    """canSerializeFMUstate only with canGetAndSetFMUstate; maxOutputDerivativeOrder is not negative."""
    for kind, attributes in fmu.interfaces.items():
        serializes, gets = (
            attributes.get(f"can{verb}FMUstate") in ("true", "1") for verb in ("Serialize", "GetAndSet")
        )
        if serializes and not gets:
            yield f"{kind} has canSerializeFMUstate: expected canGetAndSetFMUstate too"
    if fmu.output_derivative_order < 0:
        yield f"maxOutputDerivativeOrder {fmu.output_derivative_order}: expected 0 or more"


@rule(_TYPES, Stage.DESCRIPTION)
def type_names(fmu: FmuFile) -> Iterator[str]:
    """Names of types are unique, and differ from those of variables."""
    names = [element.get("name") for element in fmu.root.iterfind("TypeDefinitions/SimpleType")]
    yield from _repeated("type", names)
    for name in sorted({v.name for v in fmu.variables} & {text for text in names if text}):
        yield f"type {name!r} is called like a variable: expected another name"


@rule(_TYPES, Stage.DESCRIPTION)
def enumeration_items(fmu: FmuFile) -> Iterator[str]:
    """Items of an enumeration have names and values that occur once; there is one at least."""
    for name, kind in fmu.types.items():
        if kind.tag != "Enumeration":
            continue
        items = kind.findall("Item")
        if not items:
            yield f"enumeration {name!r} has no item: expected one or more"
        yield from _repeated(f"enumeration {name!r}: item", [element.get("name") for element in items])
        values = [str(integer(element.get("value"))) for element in items]
        yield from _repeated(f"enumeration {name!r}: value", values)
