"""Tests of the program that fetches links to other sites, with a local server in their place."""

import runpy
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

PROGRAM = runpy.run_path(str(Path(__file__).parent.parent / ".ci" / "external_links.py"))


class _Answer(BaseHTTPRequestHandler):
    """A handler that answers /N with status N."""

    def do_GET(self) -> None:
        self.send_response(int(self.path.removeprefix("/")))
        self.end_headers()

    def log_message(self, format: str, *arguments: Any) -> None:
        """Logs nothing: standard error is for the tests."""


@pytest.fixture
def site() -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), _Answer) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_a_link_that_leads_nowhere_is_named_with_its_files(
    site: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, other = tmp_path / "page.md", tmp_path / "other.md"
    page.write_text(f"[good]({site}/200), [gone]({site}/404), [for a browser]({site}/403) and [own](own.md)")
    other.write_text(f"<{site}/404>")
    assert PROGRAM["main"]([str(page), str(other)]) == 1
    first, last = capsys.readouterr().out.splitlines()
    assert first == f"{site}/404: status 404; in page.md, other.md"
    assert last == "3 links, 1 that cannot be fetched"
    page.write_text(f"[good]({site}/200)")
    assert PROGRAM["main"]([str(page)]) == 0


def test_a_server_that_is_not_there_is_a_link_that_cannot_be_fetched(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    page.write_text("[nobody](http://127.0.0.1:1/)")
    assert PROGRAM["main"]([str(page)]) == 1
    assert "Connection refused" in capsys.readouterr().out
