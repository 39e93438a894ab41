"""The browser that opens pages."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from selenium import webdriver

from orchestration.report.find import found_results
from orchestration.report.render import render
from tests.orchestration.results.opened import OpenedPage


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """The made-up results are of shipped scenarios."""


@pytest.fixture
def opened(browser: "webdriver.Chrome", tmp_path: Path) -> Iterator[Callable[..., OpenedPage]]:
    """Opens the page of some results; afterwards nothing must have gone wrong and nothing been fetched."""
    pages: list[OpenedPage] = []

    def open_page(*results: Path, title: str = "") -> OpenedPage:
        file = tmp_path / "report.html"
        file.write_text(render(found_results(results), title), encoding="utf-8")
        pages.append(OpenedPage(browser, file))
        return pages[-1]

    yield open_page
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    for opened_page in pages:
        assert opened_page.complaints() == []
        assert opened_page.fetched() == []
