"""pytest plugin: `pytest --fmu PATH` adds a test for each rule and FMU; otherwise it does nothing."""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from fmus.compliance.rule import Result


class BrokenRuleWarning(UserWarning):
    """An FMU breaks a rule whose level is below error."""


class BrokenRuleError(Exception):
    """An FMU breaks a rule."""


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("fmu", "compliance of FMUs with FMI 2.0")
    group.addoption(
        "--fmu",
        action="append",
        default=[],
        metavar="PATH",
        help="judge this FMU by every rule; can be repeated",
    )


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(
    session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Adds the rules after what the project's own tests are."""
    for path in config.getoption("--fmu") or ():
        file = FmuTests.from_parent(session, path=Path(path).resolve(), name=str(path))
        items.extend(file.collect())
        session.testscollected = len(items)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Ends the process that reads libraries."""
    if session.config.getoption("--fmu"):
        from fmus.compliance.library_reader import close_reader

        close_reader()


class FmuTests(pytest.File):
    """One FMU; examined once, when its first rule is run."""

    _results: "dict[str, Result] | None" = None

    def collect(self) -> Iterable["RuleTest"]:
        try:
            from fmus.compliance.library_reader import check_lief
            from fmus.compliance.rule import all_rules
            from fmus.compliance.sentences import rule_table

            check_lief()
        except ImportError as error:  # of the extra `check`
            raise pytest.UsageError(f"--fmu: {error}") from None
        names = [rule.name for rule in all_rules() if rule.name not in rule_table()["off"]]
        return [RuleTest.from_parent(self, name=name) for name in names]

    def result(self, name: str) -> "Result":
        if self._results is None:
            from fmus.compliance.examine import examine

            try:
                self._results = {result.rule.name: result for result in examine(self.path)}
            except ImportError as error:  # of LIEF, which no FMU can be judged without
                pytest.exit(f"--fmu: {error}", returncode=pytest.ExitCode.USAGE_ERROR)
        return self._results[name]


class RuleTest(pytest.Item):
    """One rule of one FMU: an error fails, a finding below it warns, what does not apply is skipped."""

    def runtest(self) -> None:
        parent = self.parent
        assert isinstance(parent, FmuTests)
        result = parent.result(self.name)
        if reason := result.not_applicable or result.not_judged:
            pytest.skip(reason)
        text = f"{self.name} ({result.rule.clause}): " + "; ".join(result.messages)
        if result.outcome == "error":
            raise BrokenRuleError(text)
        if result.messages:
            warnings.warn(BrokenRuleWarning(f"{parent.path.name}: {text}"), stacklevel=1)

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        if isinstance(excinfo.value, (BrokenRuleError, OSError)):
            return str(excinfo.value)
        return super().repr_failure(excinfo)

    def reportinfo(self) -> tuple[Path, None, str]:
        return self.path, None, f"{self.path.name}: {self.name}"
