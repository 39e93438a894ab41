"""Rules of the model description as a whole and of its elements but for variables: FMI 2.0.5, 2.2 and 4.3."""

import itertools
import re
from collections.abc import Iterable, Iterator

from fmus.compliance.contents import BUILD_DESCRIPTION, SCHEMAS, TERMINALS, schema_errors
from fmus.compliance.fmu_file import C_IDENTIFIER, FmuFile
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.rules.archive import unreadable
from fmus.compliance.variable import is_true, number

_DESCRIPTION = "2.2 FMI Description Schema"
_HEAD = "2.2.1 Definition of an FMU (fmiModelDescription)"
_CATEGORIES = "2.2.4 Definition of Log Categories (LogCategories)"
_EXPERIMENT = "2.2.5 Definition of a Default Experiment (DefaultExperiment)"
_FLAGS = "4.3.1 Co-Simulation FMU (CoSimulation), 3.3.1 Model Exchange FMU (ModelExchange)"
_SCHEMA = SCHEMAS / "fmi2" / "fmi2ModelDescription.xsd"
_DATE = re.compile(r"\d{4}-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])T([01]\d|2[0-3]):[0-5]\d:[0-5]\dZ")
_UTF_8 = re.compile(
    rb"(\xef\xbb\xbf)?<\?xml[^>\r\n]*[ \t]encoding[ \t]*=[ \t]*[\"']utf-8[\"']", re.IGNORECASE
)
_NO_NUMBER = re.compile(r"\s*[+-]?(?:inf|infinity|nan)\s*", re.IGNORECASE)
_NUMBERS = {  # elements -> attributes of type xs:double
    "TypeDefinitions/SimpleType/Real": ("min", "max", "nominal"),
    "ModelVariables/ScalarVariable/Real": ("start", "min", "max", "nominal"),
    "UnitDefinitions/Unit/*": ("factor", "offset"),
    "DefaultExperiment": ("startTime", "stopTime", "tolerance", "stepSize"),
}
_TIMES = ("startTime", "stopTime", "stepSize")
_STANDARD_CATEGORIES = (
    "logEvents", "logSingularLinearSystems", "logNonlinearSystems", "logDynamicStateSelection",
    "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logStatusPending", "logAll",
)  # fmt: skip


@rule(_DESCRIPTION, Stage.FILE, condition=unreadable)
def description_is_readable(fmu: FmuFile) -> Iterable[str]:
    """modelDescription.xml is well-formed XML without a document type declaration."""
    is_there = fmu.description_problem and fmu.description_problem != fmu.NO_DESCRIPTION
    return [fmu.description_problem] if is_there else []


@rule(_HEAD, Stage.FILE, condition=lambda fmu: fmu.description_problem and "there is no description to read")
def fmi_version(fmu: FmuFile) -> Iterator[str]:
    """fmiVersion is 2.0."""
    if fmu.other_version:
        yield fmu.other_version


@rule(_DESCRIPTION, Stage.DESCRIPTION)
def description_is_utf_8(fmu: FmuFile) -> Iterator[str]:
    """The first line of the model description states the encoding UTF-8."""
    if not _UTF_8.match(fmu.xml):
        yield f'it begins {fmu.xml[:40]!r}: expected <?xml version="1.0" encoding="UTF-8"?>'


@rule(_DESCRIPTION, Stage.FILE, condition=unreadable)
def other_xml_is_utf_8(fmu: FmuFile) -> Iterator[str]:
    """The first line of buildDescription.xml and of terminalsAndIcons.xml states the encoding UTF-8."""
    for path in {BUILD_DESCRIPTION, TERMINALS} & fmu.paths:
        if not _UTF_8.match(content := fmu.read(path)):
            yield f'{path} begins {content[:40]!r}: expected <?xml version="1.0" encoding="UTF-8"?>'


@rule(_DESCRIPTION, Stage.DESCRIPTION)
def schema(fmu: FmuFile) -> Iterator[str]:
    """The model description is valid by the XML schema of FMI 2.0."""
    for error in schema_errors(fmu.root, _SCHEMA):
        yield f"line {error.line}: {error.message}"


@rule(_DESCRIPTION, Stage.DESCRIPTION)
def numbers_are_finite(fmu: FmuFile) -> Iterator[str]:
    """No number is infinite or NaN."""
    for path, attributes in _NUMBERS.items():
        for element, attribute in itertools.product(fmu.root.iterfind(path), attributes):
            if _NO_NUMBER.fullmatch(element.get(attribute, "")):
                text = f"{attribute}={element.get(attribute)!r}"
                yield f"line {element.sourceline}: {element.tag} has {text}: expected a finite number"


@rule(_HEAD, Stage.DESCRIPTION)
def interfaces(fmu: FmuFile) -> Iterator[str]:
    """There is an element ModelExchange or CoSimulation, each at most once."""
    count = {kind: len(fmu.root.findall(kind)) for kind in ("ModelExchange", "CoSimulation")}
    if not any(count.values()):
        yield "neither ModelExchange nor CoSimulation: expected one of them at least"
    for kind, number_of_elements in count.items():
        if number_of_elements > 1:
            yield f"{number_of_elements} elements {kind}: expected one"


@rule(_HEAD, Stage.DESCRIPTION)
def name_and_guid_are_given(fmu: FmuFile) -> Iterator[str]:
    """modelName and guid, which ties description and library together, are not empty."""
    for attribute in ("modelName", "guid"):
        if attribute in fmu.root.attrib and not fmu.root.get(attribute).strip():
            yield f"{attribute} {fmu.root.get(attribute)!r}: expected one that is not empty"


@rule(_HEAD, Stage.DESCRIPTION)
def generation_date(fmu: FmuFile) -> Iterator[str]:
    """generationDateAndTime is a date in UTC, YYYY-MM-DDThh:mm:ssZ."""
    date = fmu.root.get("generationDateAndTime")
    if date is not None and not _DATE.fullmatch(date):
        yield f"generationDateAndTime {date!r}: expected such as 2026-01-31T12:00:00Z"


@rule(_CATEGORIES, Stage.DESCRIPTION)
def log_categories_are_unique(fmu: FmuFile) -> Iterator[str]:
    """No two log categories have the same name."""
    names = [element.get("name") for element in fmu.root.iterfind("LogCategories/Category")]
    for name, count in repeated(names).items():
        yield f"log category {name!r} is defined {count} times: expected once"


@rule(_CATEGORIES, Stage.DESCRIPTION)
def log_category_names(fmu: FmuFile) -> Iterator[str]:
    """A standardized log category has its standardized name."""
    standard = {name.lower(): name for name in _STANDARD_CATEGORIES}
    for element in fmu.root.iterfind("LogCategories/Category"):
        name = element.get("name", "")
        expected = standard.get(name.replace("_", "").replace(" ", "").lower(), name)
        if name != expected:
            yield f"log category {name!r}: expected {expected}, the standardized name"


@rule(_CATEGORIES, Stage.DESCRIPTION)
def log_category_descriptions(fmu: FmuFile) -> Iterator[str]:
    """The description of a log category, where there is one, is not empty."""
    for element in fmu.root.iterfind("LogCategories/Category"):
        if not element.get("description", "-").strip():
            yield f"log category {element.get('name')!r} has an empty description: expected one or none"


@rule(_EXPERIMENT, Stage.DESCRIPTION)
def default_experiment(fmu: FmuFile) -> Iterator[str]:
    """The default experiment does not stop before it starts; step size and tolerance are not negative."""
    for limit, text in _experiment(fmu):
        if limit < 0:
            yield text


@rule(_EXPERIMENT, Stage.DESCRIPTION)
def default_experiment_is_meaningful(fmu: FmuFile) -> Iterator[str]:
    """The default experiment takes a step at least; its step size and tolerance are not 0."""
    for limit, text in _experiment(fmu):
        if limit == 0:
            yield text
    element = fmu.root.find("DefaultExperiment")
    begin, end, step = (number(element.get(name)) if element is not None else None for name in _TIMES)
    if end is not None and step is not None and 0 < end - (begin or 0.0) < step:
        yield f"stepSize {step:g}: expected at most the time from start to stop, {end - (begin or 0.0):g} s"


def _experiment(fmu: FmuFile) -> Iterator[tuple[float, str]]:
    """Values that should be above 0, each with what is wrong if it is not."""
    experiment = fmu.root.find("DefaultExperiment")
    if experiment is None:
        return
    begin, end = number(experiment.get("startTime", "0")), number(experiment.get("stopTime"))
    if begin is not None and end is not None:
        yield end - begin, f"stopTime {end:.17g}: expected more than startTime {begin:.17g}"
    for attribute in ("stepSize", "tolerance"):
        value = number(experiment.get(attribute))
        if value is not None:
            yield value, f"{attribute} {value:g}: expected more than 0"


@rule("2.2.6 Definition of Vendor Annotations (VendorAnnotations)", Stage.DESCRIPTION)
def annotations_are_unique(fmu: FmuFile) -> Iterator[str]:
    """No two annotations of the FMU, or of one variable, are of one tool."""
    parents = [("VendorAnnotations", fmu.root.find("VendorAnnotations"))]
    for v in fmu.root.iterfind("ModelVariables/ScalarVariable[Annotations]"):
        parents.append((f"{v.get('name')}, Annotations", v.find("Annotations")))
    for what, parent in parents:
        names = [element.get("name") for element in parent.iterfind("Tool")] if parent is not None else []
        for name, count in repeated(names).items():
            yield f"{what}: tool {name!r} occurs {count} times: expected once"


@rule(_FLAGS, Stage.DESCRIPTION)
def model_identifier(fmu: FmuFile) -> Iterator[str]:
    """modelIdentifier is a C identifier, as it names files and the prefix of functions."""
    for kind, attributes in fmu.interfaces.items():
        identifier = attributes.get("modelIdentifier")
        if identifier is not None and not C_IDENTIFIER.fullmatch(identifier):
            yield f"{kind} modelIdentifier {identifier!r}: expected letters, digits and _, no digit first"


@rule(_FLAGS, Stage.DESCRIPTION)
def capabilities_agree(fmu: FmuFile) -> Iterator[str]:
    """canSerializeFMUstate only with canGetAndSetFMUstate."""
    for kind, attributes in fmu.interfaces.items():
        if is_true(attributes.get("canSerializeFMUstate")) and not is_true(
            attributes.get("canGetAndSetFMUstate")
        ):
            yield f"{kind} has canSerializeFMUstate: expected canGetAndSetFMUstate too"
