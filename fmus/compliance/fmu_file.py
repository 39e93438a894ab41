"""An FMU as a file: members and parsed description. Faults are reported as text, never raised."""

import re
import zipfile
from collections.abc import Mapping
from copy import copy
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from fmus.compliance.rule import NotJudgedError
from fmus.compliance.traces.fmi3_view import FLAGS, LISTS, as_fmi2
from fmus.compliance.variable import Unknown, Variable, Variable3, integer, is_true
from fmus.extras import require
from fmus.files import too_large
from fmus.fmi.binding import ADJOINT, EVENT_MODE, EXAMINED, library_member, platform_name
from fmus.fmi.model_description import Element
from fmus.fmi.variable_types import TYPES
from fmus.platforms import FMPY

etree: Any = require("lxml.etree", "check", "a check of FMUs")  # without types
DESCRIPTION = "modelDescription.xml"
ONLY_ONCE = "canBeInstantiatedOnlyOncePerProcess"
_LARGEST_DESCRIPTION = 100_000_000  # bytes; far beyond any that tools write, and a few GB of memory
_LARGEST_MEMBER = 8_000_000_000  # bytes unpacked
CO_SIMULATION, MODEL_EXCHANGE = "CoSimulation", "ModelExchange"  # the elements of both interfaces
_SECTIONS = {**LISTS, "ClockedStates": "ClockedState", "EventIndicators": "EventIndicator"}
C_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@cache
def _schema(path: str) -> Any:
    """Returns an XML schema of FMI, read once in a process."""
    return etree.XMLSchema(etree.parse(FMPY / "schema" / path))


def schema_errors(root: Any, path: str) -> list[Any]:
    """Returns entries with `line`, `path` and `message`. path: of the schema, such as "fmi2/x.xsd"."""
    definition = _schema(path)
    definition.validate(root.getroottree())
    return list(definition.error_log)


class BrokenMemberError(ValueError):
    """A member without the content that a rule needs: a finding of that rule."""


class FmuFile:
    """A file said to be an FMU; `archive_problem` and `description_problem` are empty if it can be read."""

    NO_DESCRIPTION = f"there is no {DESCRIPTION} at the top of the archive"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.members: list[zipfile.ZipInfo] = []
        self.archive_problem = self.description_problem = ""
        self.root: Any = etree.Element("none")  # fmiModelDescription, if there is one
        self._judged = ""
        self.elements: list[Element] | None = None  # of FMI 3.0, where its behaviour is judged
        self.uses, self.has_clocks = 0, False  # the former of `Fmi3Library`
        try:
            with zipfile.ZipFile(path) as archive:
                self.members = archive.infolist()
        except Exception as error:
            # zipfile raises many kinds of errors for a damaged archive
            self.archive_problem = f"it cannot be read as a zip: {error}"
            self.description_problem = "the archive cannot be read"
        else:
            self.description_problem = self._read_description()

    def _read_description(self) -> str:
        """Reads and parses the model description; returns the reason why it cannot."""
        if DESCRIPTION not in self.paths:
            return self.NO_DESCRIPTION
        try:
            self.root = self.parsed(DESCRIPTION)
        except (BrokenMemberError, NotJudgedError) as error:
            return str(error)
        for date in filter(None, [self.root.get("generationDateAndTime")]):
            # libxml2 does not collapse the blanks of a date
            self.root.set("generationDateAndTime", date.strip())
        return ""

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(member.filename for member in self.members)

    @cached_property
    def paths(self) -> frozenset[str]:
        """The names of the members, to look one up."""
        return frozenset(self.names)

    @property
    def too_large(self) -> str:
        """Reason why the archive is not unpacked, if it is too large."""
        return too_large(self.members, self.path.stat().st_size)

    @property
    def version(self) -> str:
        return self.root.get("fmiVersion", "")

    @property
    def is_fmi3(self) -> bool:
        return self.version.startswith("3.0")

    @property
    def fmi(self) -> int:
        """The version of the standard whose rules are judged."""
        return 3 if self.is_fmi3 or self.elements is not None else 2

    @property
    def other_version(self) -> str:
        """Reason why no more than the file is judged, if the FMU is one of another version."""
        return "" if self.version == "2.0" or self.is_fmi3 else "it is no FMU of FMI 2.0 or 3.0"

    @cached_property
    def interfaces(self) -> dict[str, Mapping[str, str]]:
        return {
            kind: dict(self.root.find(kind).attrib)
            for kind in (CO_SIMULATION, MODEL_EXCHANGE)
            if self.root.find(kind) is not None
        }

    def judged_as(self, interface: str) -> "FmuFile":
        """Returns this FMU with one of its interfaces, whose capabilities and library count.

        Of FMI 3.0 it has the description of FMI 2.0 that `as_fmi2` gives, and elements of
        `Fmi3Library`; `description_problem` is the reason why not.
        """
        fmu = copy(self)
        fmu._judged = interface
        if self.is_fmi3:
            # its own properties are made anew
            for name in [
                name for name in vars(fmu) if isinstance(getattr(FmuFile, name, None), cached_property)
            ]:
                delattr(fmu, name)
            try:
                fmu.root, fmu.elements = as_fmi2(self.root, self.variables)
            except (ValueError, LookupError) as error:
                fmu.description_problem = str(error)
            fmu.has_clocks = any(v.kind == "Clock" for v in self.variables)
            # 2.3.2: clocks require event mode
            fmu.uses = EXAMINED | (EVENT_MODE if fmu.has_clocks and fmu.claims("hasEventMode") else 0)
            fmu.uses |= ADJOINT if fmu.claims("providesAdjointDerivatives") else 0
        return fmu

    @property
    def interface(self) -> str:
        """The interface that is judged: for co-simulation, unless another was chosen or is the only one."""
        return self._judged or next(iter(self.interfaces), CO_SIMULATION)

    @property
    def is_model_exchange(self) -> bool:
        return self.interface == MODEL_EXCHANGE

    @property
    def _attributes(self) -> Mapping[str, str]:
        return self.interfaces.get(self.interface, {})

    def claims(self, capability: str) -> bool:
        """Whether a capability flag of the interface that is judged is true."""
        name = FLAGS.get(capability, capability) if self.is_fmi3 else capability
        return is_true(self._attributes.get(name))

    @property
    def output_derivative_order(self) -> int:
        return integer(self._attributes.get("maxOutputDerivativeOrder")) or 0

    @cached_property
    def units(self) -> dict[str, Any]:
        """Name -> element Unit."""
        return {unit.get("name", ""): unit for unit in self.root.iterfind("UnitDefinitions/Unit")}

    @cached_property
    def types(self) -> dict[str, Any]:
        """Name -> element inside SimpleType, such as Enumeration; of FMI 3.0, such as EnumerationType."""
        if self.is_fmi3:
            return {e.get("name", ""): e for e in self.root.iterfind("TypeDefinitions/*")}
        types = {}
        for simple in self.root.iterfind("TypeDefinitions/SimpleType"):
            types.update({simple.get("name", ""): element for element in simple if element.tag in TYPES})
        return types

    @cached_property
    def variables(self) -> tuple[Variable, ...]:
        if self.is_fmi3:
            listed = self.root.iterfind("ModelVariables/*")
            return tuple(self._variable3(index, element) for index, element in enumerate(listed, 1))
        elements = self.root.iterfind("ModelVariables/ScalarVariable")
        return tuple(self._variable(index, element) for index, element in enumerate(elements, 1))

    def _variable(self, index: int, element: Any) -> Variable:
        typed = next((child for child in element if child.tag in TYPES), None)
        if typed is None:
            return Variable(index, dict(element.attrib), "", {}, {})
        declared, items = self._declared(typed)
        return Variable(index, dict(element.attrib), typed.tag, dict(typed.attrib), declared, items)

    def _variable3(self, index: int, element: Any) -> Variable:
        stated = dict(element.attrib)
        return Variable3(index, stated, element.tag, stated, *self._declared(element), element)

    def _declared(self, typed: Any) -> tuple[dict[str, str], frozenset[int]]:
        """Returns the attributes of the type that is declared, and the values of its items."""
        declared = self.types.get(typed.get("declaredType", ""))
        if declared is None or declared.tag.removesuffix("Type") != typed.tag:
            return {}, frozenset()
        values = [integer(item.get("value")) for item in declared.iterfind("Item")]
        return dict(declared.attrib), frozenset(value for value in values if value is not None)

    @cached_property
    def by_key(self) -> dict[int | None, Variable]:
        """Variables by their keys in the description: the index, or in FMI 3.0 the value reference.

        Of several variables with one reference it has the first.
        """
        return {v.reference if self.is_fmi3 else v.index: v for v in reversed(self.variables)}

    @cached_property
    def settable_before(self) -> list[Variable]:
        """Variables that can be set when instantiated: initial exact or approx, not constant."""
        return [v for v in self.variables if v.variability != "constant" and v.initial in ("exact", "approx")]

    @cached_property
    def settable_in_initialization(self) -> list[Variable]:
        """Variables that can be set in initialization mode: initial exact, not constant, and inputs."""
        return [
            v
            for v in self.variables
            if v.causality == "input" or (v.variability != "constant" and v.initial == "exact")
        ]

    @cached_property
    def settable_while_stepping(self) -> list[Variable]:
        """Variables that can be set at communication points: inputs and tunable parameters."""
        tunable = "parameter", "tunable"
        return [
            v for v in self.variables if v.causality == "input" or (v.causality, v.variability) == tunable
        ]

    @cached_property
    def readable_in_initialization(self) -> list[Variable]:
        """Outputs and initial unknowns."""
        indices = {unknown.variable.index for unknown in self.unknowns["InitialUnknowns"]}
        return [v for v in self.variables if v.causality == "output" or v.index in indices]

    @cached_property
    def aliases(self) -> dict[tuple[str, int | None], list[Variable]]:
        """Type and value reference -> the variables that have both, and so the same value."""
        sets: dict[tuple[str, int | None], list[Variable]] = {}
        for v in self.variables:
            if v.reference is not None and v.kind:
                sets.setdefault((v.base_kind, v.reference), []).append(v)
        return sets

    @property
    def key_words(self) -> str:
        """Words for the keys that variables have."""
        return "the value reference of a variable" if self.is_fmi3 else f"1..{len(self.variables)}"

    def section(self, name: str) -> str:
        """Returns the name of a list of ModelStructure in this version of FMI."""
        return _SECTIONS[name] if self.is_fmi3 else name

    @cached_property
    def derivatives(self) -> dict[int, Variable]:
        """Index of each variable with the attribute derivative -> the other variable that it names."""
        stated = {v.index: integer(v.typed["derivative"]) for v in self.variables if "derivative" in v.typed}
        known = {index: self.by_key[of] for index, of in stated.items() if of in self.by_key}
        return {index: of for index, of in known.items() if of.index != index}

    @cached_property
    def state_derivatives(self) -> dict[int, int]:
        """Index of each variable in Derivatives that has the attribute derivative -> index of its state."""
        listed = (unknown.variable.index for unknown in self.unknowns["Derivatives"])
        return {index: self.derivatives[index].index for index in listed if index in self.derivatives}

    @cached_property
    def states(self) -> frozenset[int]:
        """Indices of the continuous-time states: those whose derivatives stand in Derivatives."""
        return frozenset(self.state_derivatives.values())

    @cached_property
    def unknowns(self) -> dict[str, list[Unknown]]:
        """Section of ModelStructure -> its unknowns."""
        key = "valueReference" if self.is_fmi3 else "index"
        variables = {number: (v,) for number, v in self.by_key.items()}
        return {
            name: [
                Unknown(self.section(name), element, known, *variables.get(integer(text), ()))
                for element in self.root.iterfind(
                    f"ModelStructure/{self.section(name)}{'' if self.is_fmi3 else '/Unknown'}"
                )
                for known in [frozenset(map(integer, element.get("dependencies", "").split()))]
                # `as_fmi2` lists all elements of an array in one
                for text in element.get(key, "").split() or [""]
            ]
            for name in _SECTIONS
        }

    @property
    def state_variables(self) -> list[Variable]:
        """The continuous states, in the order of Derivatives."""
        return [self.variables[index - 1] for index in self.state_derivatives.values()]

    @property
    def log_categories(self) -> list[str]:
        return [category.get("name", "") for category in self.root.iterfind("LogCategories/Category")]

    def vector_length(self, function: str) -> int:
        """Returns the number of elements that a function of model exchange gives, or that it counts."""
        if function.endswith("EventIndicators"):
            return integer(self.root.get("numberOfEventIndicators")) or 0
        return len(self.unknowns["Derivatives"])

    def platforms(self) -> list[str]:
        """Returns the names of the folders below binaries that hold a file."""
        return sorted({path.split("/")[1] for path in self.names if re.match("binaries/[^/]+/.*[^/]$", path)})

    def libraries(self) -> dict[str, str]:
        """Returns path inside the archive -> folder below binaries, of libraries named as a modelIdentifier.

        Others in the same folder are libraries that these need.
        """
        identifiers = "|".join(re.escape(one.get("modelIdentifier", "")) for one in self.interfaces.values())
        library = re.compile(rf"binaries/([^/]+)/(?:{identifiers})\.(?:so|dll|dylib)")
        return {match.group(): match[1] for match in map(library.fullmatch, self.names) if match}

    @property
    def host_library(self) -> str:
        """Path inside the archive of the library that this machine loads, or ""."""
        identifier = self._attributes.get("modelIdentifier", "")
        is_name = C_IDENTIFIER.fullmatch(identifier)
        return (library_member(self.names, identifier, self.fmi) or "") if is_name else ""

    @property
    def no_host_library(self) -> str:
        """Reason why this machine cannot run the FMU, with the libraries that there are, if so."""
        folder = f"binaries/{platform_name()}/"
        there = [path for path in self.names if path.startswith(folder) and not path.endswith("/")]
        there_is = ", ".join(there or sorted({*self.libraries().values()})) or "none"
        name = f"library {self._attributes.get('modelIdentifier')} for {platform_name()}"
        return "" if self.host_library else f"no {name} (there is {there_is})"

    def read(self, member: str, most: int = _LARGEST_MEMBER) -> bytes:
        """Returns the content of a member.

        Raises NotJudgedError if it cannot be unpacked (rules of the archive report that), BrokenMemberError
        if it is missing or has more than `most` bytes.
        """
        if self.too_large:
            raise NotJudgedError(self.too_large)
        with zipfile.ZipFile(self.path) as archive:
            try:
                size = archive.getinfo(member).file_size
            except KeyError:
                raise BrokenMemberError(f"there is no {member}") from None
            if size > most:
                raise BrokenMemberError(f"{member} has {size} bytes: expected at most {most}")
            try:
                return archive.read(member)
            except Exception as error:
                # each compression method has its own errors
                raise NotJudgedError(f"{member} cannot be unpacked: {error}") from error

    def parsed(self, member: str, most: int = _LARGEST_DESCRIPTION) -> Any:
        """Returns the root element of an XML file. Raises as `read`, and BrokenMemberError for XML that is
        not well-formed or has a document type declaration.
        """
        content = self.read(member, most)
        parser = etree.XMLParser(
            resolve_entities=False, no_network=True, load_dtd=False, remove_comments=True, remove_pis=True
        )
        try:
            root = etree.fromstring(content, parser)
        except (etree.XMLSyntaxError, ValueError) as error:
            raise BrokenMemberError(f"{member} is not well-formed: {getattr(error, 'msg', error)}") from None
        # its entities could expand to gigabytes
        if root.getroottree().docinfo.doctype:
            raise BrokenMemberError(f"{member} has a document type declaration: expected none")
        return root
