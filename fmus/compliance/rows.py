"""Rules as rows of data: the subjects in an FMU, a predicate for wrong ones, and the message."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from fmus.compliance.fmu_file import FmuFile, etree
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Check, Condition, Rule, Stage, add_rule, always
from fmus.compliance.sentences import sentences_of

T = TypeVar("T")
Case = tuple[Callable[[T, Any], object], str]
"""Whether something is wrong with a subject, and the message: a template of `str.format`. The names in it are
attributes of the subject, `subject` is the subject itself, `value` what the function returned, given the
subject and the FMU, or the probe that calls it.
"""


Row = tuple[str, Check]
"""Name and check of one rule."""


def row(name: str, subjects: Callable[[Any], Iterable[T]], *cases: Case[T]) -> Row:
    """Returns a rule about subjects in an FMU, with one message for the first case that holds of each."""
    return name, lambda source: dict.fromkeys(_told(source, subjects(source), *cases))


def add_rows(
    module: str, stage: Stage, rows: Iterable[Row], condition: Condition = always, **options: Any
) -> None:
    """Makes rows the rules of a module, with one stage and condition, and the clauses of their sentences.

    options: last and interface, as in `rule`
    """
    for name, check in rows:
        clause = ", ".join(dict.fromkeys(sentence.clause for sentence in sentences_of(name)))
        add_rule(Rule(name, clause, "", stage, check, condition, module=module, **options))


def _told(source: Any, subjects: Iterable[T], *cases: Case[T]) -> Iterator[str]:
    """Yields the message of the first case that holds, for each subject."""
    for subject in subjects:
        for is_wrong, message in cases:
            if value := is_wrong(subject, source):
                text = message.format_map(_Names(subject=subject, value=value))
                if isinstance(source, Probe):
                    source.shared.subjects.setdefault(text, subject)
                yield text
                break


class _Names(dict[str, Any]):
    """Names in a message: attributes of the subject, those in XML if it is an element."""

    def __missing__(self, name: str) -> Any:
        subject = self["subject"]
        return subject.get(name) if etree.iselement(subject) else getattr(subject, name)


def anything(*_: Any) -> bool:
    """Returns True: the presence of such a subject is wrong."""
    return True


def elements(path: str) -> Callable[[FmuFile], Iterable[Any]]:
    """Returns the subjects of a row: the elements or attributes of the model description with an XPath."""
    return lambda fmu: fmu.root.xpath(path)


def repeats(elements: str, attribute: str = "name") -> str:
    """Returns the XPath of elements that have an attribute in common with one before, beside them."""
    return f"{elements}[@{attribute}=preceding-sibling::*/@{attribute}]"
