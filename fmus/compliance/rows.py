"""Rules of one shape as rows of data: what they look at, what is wrong with it, and the message if it is."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

from fmus.compliance.fmu_file import FmuFile, etree
from fmus.compliance.rule import Condition, Rule, Stage, add_rule, always, repeated

T = TypeVar("T")
Case = tuple[Callable[[T, FmuFile], object], str]
"""Whether something is wrong with a subject, and the message: a template of `str.format`. The names in it are
attributes of the subject, `subject` is the subject itself, `value` what the function returned.
"""


@dataclass(frozen=True)
class Row:
    """One rule. subjects: what it looks at in an FMU. cases: of each subject the first that holds is told.

    clause: its own, where it is not that of its table.
    """

    name: str
    claim: str
    subjects: Callable[[FmuFile], Iterable[Any]]
    cases: tuple[Case[Any], ...]
    clause: str = ""

    def check(self, fmu: FmuFile) -> Iterable[str]:
        """Returns the messages, each once."""
        return dict.fromkeys(told(fmu, self.subjects(fmu), *self.cases))


def row(
    name: str, claim: str, subjects: Callable[[FmuFile], Iterable[T]], *cases: Case[T], clause: str = ""
) -> Row:
    """Returns a row whose cases are of the type of its subjects."""
    return Row(name, claim, subjects, cases, clause)


def add_rows(
    module: str, clause: str, stage: Stage, rows: Iterable[Row], condition: Condition = always
) -> None:
    """Makes a table of rows the rules of a module: of one clause and stage, with one condition."""
    for r in rows:
        its_clause = r.clause or clause
        add_rule(Rule(r.name, its_clause, r.claim, stage, r.check, condition, module=module))


def told(fmu: FmuFile, subjects: Iterable[T], *cases: Case[T]) -> Iterator[str]:
    """Yields the message of the first case that holds, for each subject."""
    for subject in subjects:
        for is_wrong, message in cases:
            if value := is_wrong(subject, fmu):
                yield message.format_map(_Names(subject=subject, value=value))
                break


class _Names(dict[str, Any]):
    """Names in a message: attributes of the subject, those in XML if it is an element."""

    def __missing__(self, name: str) -> Any:
        subject = self["subject"]
        return subject.get(name) if etree.iselement(subject) else getattr(subject, name)


def anything(*_: Any) -> bool:
    """Whether a subject is wrong that is there only then: always."""
    return True


@dataclass(frozen=True)
class Repeat:
    """A name that occurs more than once, or of an element's children another attribute.

    tag: of that element. owner: its name, or that of the nearest around it that has one.
    """

    name: Any
    count: int
    attribute: str = ""
    tag: str = ""
    owner: str = ""

    @property
    def place(self) -> str:
        return f"{self.tag} {self.owner}".strip()


def repeats(names: Iterable[Any]) -> Iterator[Repeat]:
    for name, count in repeated(names).items():
        yield Repeat(name, count)


def alike(parents: str, child: str, attribute: str = "name") -> Callable[[FmuFile], Iterator[Repeat]]:
    """Returns the subjects of a row: what children of one parent have in common, by an attribute."""
    return lambda fmu: repeated_children(fmu.root, parents, child, attribute)


def repeated_children(root: Any, parents: str, child: str, attribute: str = "name") -> Iterator[Repeat]:
    """Yields what the children of each parent have in common: names, or what else an attribute holds."""
    for parent in root.iterfind(parents):
        for text, count in repeated(element.get(attribute) for element in parent.iterfind(child)).items():
            yield Repeat(text, count, attribute, parent.tag, owner(parent))


def elements(path: str) -> Callable[[FmuFile], Iterator[Any]]:
    """Returns the subjects of a row: the elements of the model description with a path."""
    return lambda fmu: fmu.root.iterfind(path)


def owner(element: Any) -> str:
    """Returns the name of an element, or of the nearest around it that has one."""
    names = (one.get("name") or one.get("modelName") for one in (element, *element.iterancestors()))
    return next(filter(None, names), "")
