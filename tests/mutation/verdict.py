"""What becomes of a mutant when the tests run: killed, and by which test, or survived.

A mutant is killed if a test fails, is in error, ends the process or does not end with it, twice, and passes
without it before and after all mutants. So a test that a busy machine disturbs kills no mutant, nor does an
environment in which a test fails anyway: there the measurement ends. A mutant of C code that is compiled to
the same machine code is no mistake.
"""

from pathlib import Path

from tests.mutation.collected import BrokenEnvironmentError, CollectedTests, Measured
from tests.mutation.mutants import Mutant, statement_lines

SURVIVED, SAME_CODE = "survived", "the same machine code"
KILLED_BY, TIME_LIMIT = "killed by ", "time limit of "
_ATTEMPTS = 3
_NEIGHBOURS = 3  # of a mutant, whose killers run first


class Judge:
    """Runs for each mutant the tests that execute its statement, the cheapest first, until one fails.

    Those that killed its neighbours run before the others. For a source in C these are all tests.
    budget: CPU time [s] of the tests that are chosen for a mutant, without what they share; others that
        could notice it do not run
    """

    def __init__(self, measured: Measured, budget: float) -> None:
        self._measured, self._budget = measured, budget
        self._killers: dict[Path, list[tuple[int, str]]] = {}

    def verdict(self, mutant: Mutant, tests: CollectedTests) -> str:
        """SURVIVED and of how many tests, SAME_CODE, or KILLED_BY or TIME_LIMIT and the test.

        The mutant's file in the copy of the project has the mutated content until this returns.
        """
        file = tests.folder / mutant.path
        content = file.read_text()
        chosen, known = self._chosen(mutant, content)
        file.write_text(mutant.source(content))
        try:
            test, is_endless = _failing_twice(tests, (mutant.path, mutant.source(content)), chosen)
            if not test and mutant.path.suffix in (".c", ".h") and tests.has_the_same_machine_code():
                return SAME_CODE
        finally:
            file.write_text(content)
        if not test:
            return f"{SURVIVED} {len(chosen)} of {known} tests"
        self._killers.setdefault(mutant.path, []).append((mutant.line(content), test))
        return (TIME_LIMIT if is_endless else KILLED_BY) + test

    def _chosen(self, mutant: Mutant, content: str) -> tuple[dict[str, float], int]:
        """The tests for a mutant with their costs, in the order in which they run, and of how many."""
        line, seconds = mutant.line(content), self._measured.seconds
        tests = set(seconds)
        if mutant.path.suffix == ".py":
            lines = statement_lines(content, line)
            tests = set().union(
                *(self._measured.lines.get((str(mutant.path), near), set()) for near in lines)
            )
        killers = sorted(self._killers.get(mutant.path, []), key=lambda killer: abs(killer[0] - line))
        first = [test for _, test in killers[:_NEIGHBOURS] if test in tests]
        chosen, total = dict[str, float](), 0.0
        for test in dict.fromkeys((*first, *sorted(tests, key=seconds.__getitem__))):
            total += self._measured.own[test]
            if chosen and total > self._budget:
                break
            chosen[test] = seconds[test]
        return chosen, len(tests)


def check_killers(verdicts: dict[str, str], room: str, tests: CollectedTests, measured: Measured) -> None:
    """Run the tests that killed mutants of a folder without any; of one that fails the kills are dropped.

    Raises BrokenEnvironmentError if there is one.
    """
    own = {mutant: verdict for mutant, verdict in verdicts.items() if mutant.startswith(room)}
    killers = {verdict.removeprefix(KILLED_BY) for verdict in own.values() if verdict.startswith(KILLED_BY)}
    costs = {test: seconds for test, seconds in measured.seconds.items() if test in killers}
    if costs and (test := tests.first_failure(costs)[0]):
        for mutant in [mutant for mutant, verdict in own.items() if verdict == KILLED_BY + test]:
            del verdicts[mutant]
        raise BrokenEnvironmentError(f"{test} fails without a mutant")


def _failing_twice(
    tests: CollectedTests, mutant: tuple[Path, str], chosen: dict[str, float]
) -> tuple[str, bool]:
    """The first test that fails, and again alone, and whether it does not end; "" if none."""
    test = ""
    for _ in range(_ATTEMPTS if chosen else 0):
        test, is_endless = tests.first_failure(chosen, mutant)
        if not test or tests.first_failure({test: chosen[test]}, mutant, again=True)[0]:
            return test, test != "" and is_endless
    if test:
        raise BrokenEnvironmentError(f"{test} fails now and then")
    return "", False
