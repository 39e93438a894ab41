"""Fetch what the pages link to on other sites: python .ci/external_links.py [FILE ...]

By default README.md, CONTRIBUTING.md and all of docs/. Prints the links that cannot be fetched, each with its
files, and returns status 1 if there are any. It needs the internet, so `.ci/run` does not run it: before a
release somebody does.
"""

import re
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

ROOT = Path(__file__).parent.parent
_LINK = re.compile(r"\]\((https?://[^)\s]+)\)|<(https?://[^>\s]+)>")
_PATIENCE_S = 20.0
_REFUSED_TO_PROGRAMS = (401, 403, 429)  # the page is there, for a browser


def links(files: Iterable[Path]) -> dict[str, list[str]]:
    """Link -> the names of the files that have it."""
    files_of: dict[str, list[str]] = {}
    for file in files:
        for groups in _LINK.findall(file.read_text(encoding="utf-8")):
            files_of.setdefault("".join(groups), []).append(file.name)
    return files_of


def problem(link: str) -> str:
    """Why a link cannot be fetched; empty if it can."""
    try:
        with urlopen(Request(link, headers={"User-Agent": "Mozilla/5.0"}), timeout=_PATIENCE_S):
            return ""
    except HTTPError as error:
        return "" if error.code in _REFUSED_TO_PROGRAMS else f"status {error.code}"
    except (URLError, OSError) as error:
        return str(error)


def main(arguments: list[str]) -> int:
    default = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    files_of = links(map(Path, arguments) if arguments else default)
    with ThreadPoolExecutor(8) as pool:
        problems = dict(zip(files_of, pool.map(problem, files_of), strict=True))
    for link, reason in problems.items():
        if reason:
            print(f"{link}: {reason}; in {', '.join(files_of[link])}")
    print(f"{len(problems)} links, {sum(map(bool, problems.values()))} that cannot be fetched")
    return int(any(problems.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
