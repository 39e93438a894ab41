"""The files of an opened SSP package: found by their sources, read as XML, with their units."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

from fmus.errors import nearest
from fmus.fmi.model_description import base_unit
from orchestration.errors import ScenarioError
from orchestration.exchange.ssp_xml import tag
from orchestration.system.quantities import Units


@dataclass(frozen=True)
class OpenedPackage:
    """A package and the folder that it is extracted to."""

    path: Path
    folder: Path

    def error(self, message: str) -> ScenarioError:
        return ScenarioError(f"{self.path}: {message}")

    def file(self, source: str, purpose: str) -> Path:
        """Returns a file of the package; ScenarioError for one outside it.

        source: a URI (RFC 3986) relative to the structure, or a path that some tools write in its place
        """
        for text in (source if set(source) & set("?#") else unquote(source), source):
            path = PurePosixPath(text)
            is_relative = not path.is_absolute() and ".." not in path.parts and not {"\\", ":"} & set(text)
            if is_relative and (self.folder / path).is_file():
                return self.folder / path
        expected = "a file in the package, as a relative URI without a query and a fragment"
        raise self.error(f"{purpose}: source {source!r}: expected {expected}")

    def root(self, file: Path) -> Element:
        """Returns the root element of an XML file of the package."""
        try:
            if b"<!DOCTYPE" in (content := file.read_bytes()):
                raise self.error(f"{file.name}: expected XML without a document type")
            return _with_places(content, f"{self.path}: {file.relative_to(self.folder).as_posix()}")
        except FileNotFoundError:
            beside = (path.name for path in file.parent.glob("*"))
            raise self.error(f"no {file.name} in it; {nearest(file.name, beside)}") from None
        except (ElementTree.ParseError, LookupError, ValueError) as error:
            raise self.error(f"{file.name}: expected XML: {error}") from error

    def sourced(self, element: Element, kind: str, purpose: str) -> Element | None:
        """Returns the root of the file that an element with `source` names; None for one without."""
        self.check_attribute(element, "type", f"application/x-ssp-{kind}", purpose)
        self.check_attribute(element, "sourceBase", "SSD", purpose)
        source = element.get("source")
        return self.root(self.file(source, purpose)) if source else None

    def check_attribute(self, element: Element, attribute: str, expected: str, purpose: str) -> None:
        """Raises ScenarioError if an attribute is given and is not the expected one."""
        value = element.get(attribute, expected)
        if value != expected:
            raise self.error(f"{purpose}: {attribute} {value!r}: expected {expected!r}")

    def units(self, root: Element) -> Units:
        """Returns the units that a file of the package defines."""
        bases = {unit.get("name", ""): unit.find(tag("ssc:BaseUnit")) for unit in root.iter(tag("ssc:Unit"))}
        try:
            defined = {name: base_unit(base) for name, base in bases.items() if base is not None}
        except ValueError as error:
            raise self.error(f"a unit: {error}") from error
        return {name: unit for name, unit in defined.items() if unit.factor}


def _with_places(content: bytes, file: str) -> Element:
    """Returns the root element of an XML file, in which each parameter has the attribute "place"."""
    root, lines, parser = ElementTree.fromstring(content), list[int](), expat.ParserCreate()
    parser.StartElementHandler = lambda *_: lines.append(parser.CurrentLineNumber)
    parser.Parse(content, True)
    for element, line in zip(root.iter(), lines, strict=True):
        if element.tag == tag("ssv:Parameter"):
            element.set("place", f"{file}:{line}: ")
    return root
