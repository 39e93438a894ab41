"""What a mutant is, and how it is judged."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from fmus.compliance.examine import examine, static_results
from fmus.compliance.fmu_file import FmuFile


@dataclass(frozen=True)
class Mutant:
    """An FMU that breaks one sentence, and the rules that find it: these and no others.

    write: writes the FMU into a folder and returns its path.
    is_static: what the file holds is judged alone; otherwise the FMU is run too.
    """

    name: str
    clause: str
    rules: frozenset[str]
    write: Callable[[Path], Path]
    is_static: bool = True

    def broken_rules(self, folder: Path) -> dict[str, tuple[str, ...]]:
        """Rule -> its messages, of the rules that the mutant breaks. The FMU is written into the folder."""
        return broken_rules(self.write(folder), self.is_static)


def broken_rules(path: Path, is_static: bool = True) -> dict[str, tuple[str, ...]]:
    """Rule -> its messages, of the rules that an FMU breaks."""
    results = static_results(FmuFile(path)) if is_static else examine(path)
    return {r.rule.name: r.messages for r in results if r.messages}


def unexpected(mutant: Mutant, broken: dict[str, tuple[str, ...]]) -> Iterator[str]:
    """What is wrong with the rules that a mutant breaks."""
    for name in sorted(mutant.rules - broken.keys()):
        yield f"{name} does not find it"
    for name in sorted(broken.keys() - mutant.rules):
        yield f"{name} finds it too: {broken[name][0]}"
