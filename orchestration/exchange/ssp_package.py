"""The files of an SSP package, and refusals that name the package."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from fmus.errors import nearest
from orchestration.errors import ScenarioError


@dataclass(frozen=True)
class OpenedPackage:
    """A package and the folder that it is extracted to."""

    path: Path
    folder: Path

    def error(self, message: str) -> ScenarioError:
        return ScenarioError(f"{self.path}: {message}")

    def file(self, source: str, purpose: str) -> Path:
        """A file of the package; ScenarioError for one outside it."""
        path = PurePosixPath(source)
        is_relative = not path.is_absolute() and ".." not in path.parts and not {"\\", ":"} & set(source)
        if not (is_relative and (self.folder / path).is_file()):
            raise self.error(f"{purpose}: source {source!r}: expected a file in the package")
        return self.folder / path

    def root(self, file: Path) -> Element:
        """The root element of an XML file of the package."""
        try:
            if b"<!DOCTYPE" in file.read_bytes():
                raise self.error(f"{file.name}: expected XML without a document type")
            return ElementTree.parse(file).getroot()
        except FileNotFoundError:
            beside = (path.name for path in file.parent.glob("*"))
            raise self.error(f"no {file.name} in it; {nearest(file.name, beside)}") from None
        except (ElementTree.ParseError, LookupError, ValueError) as error:
            raise self.error(f"{file.name}: expected XML: {error}") from error

    def check_attribute(self, element: Element, attribute: str, expected: str, purpose: str) -> None:
        """Raise ScenarioError if an attribute is given and is not the expected one."""
        value = element.get(attribute, expected)
        if value != expected:
            raise self.error(f"{purpose}: {attribute} {value!r}: expected {expected!r}")
