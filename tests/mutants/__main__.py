"""Judge every mutant and print which rules find it. Exit status 1 if one is found by others than it names.

`python -m tests.mutants [WORD...]`, in the project's root, with the extra `check` installed: the mutants
whose name, clause and rules hold the words.
"""

import sys
import tempfile
from pathlib import Path

from tests.mutants.mutant import unexpected
from tests.mutants.slaves import MUTANTS


def main(words: list[str]) -> int:
    """The number of mutants that are found by others than the rules that they name."""
    chosen = [m for m in MUTANTS if all(word in f"{m.name} {m.clause} {' '.join(m.rules)}" for word in words)]
    wrong = 0
    for mutant in chosen:
        with tempfile.TemporaryDirectory() as folder:
            broken = mutant.broken_rules(Path(folder))
        problems = list(unexpected(mutant, broken))
        wrong += bool(problems)
        print(f"{mutant.clause:6} {mutant.name}: {', '.join(sorted(broken)) or 'no rule'}")
        for problem in problems:
            print(f"       expected otherwise: {problem}")
    print(f"{len(chosen)} mutants, {len(chosen) - wrong} found by exactly the rules that they name")
    return wrong


if __name__ == "__main__":
    sys.exit(1 if main(sys.argv[1:]) else 0)
