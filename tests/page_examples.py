"""Runs the examples of a Markdown page in their order, in the present folder: python page_examples.py PAGE

    ```python, ```sh      run; all Python of a page shares one namespace
    ```text               output of the block before it; "..." stands for anything
    first line "# NAME"   the block is written to that file instead (Python, TOML, YAML)

In docs/tutorials every block is an example; on other pages a block below <!-- run -->, and a text after it.
Linked files beside the page, except pages, are saved first.
"""

import contextlib
import doctest
import io
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_BLOCK = re.compile(r"^(<!-- run -->\n)?```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_FILE = re.compile(r"# (\S+\.\w+)\n")
_OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@dataclass(frozen=True)
class Example:
    """A block of a page; `line` is where its code begins."""

    language: str
    code: str
    line: int

    @property
    def file(self) -> str:
        """Name of the file to write; empty if the block runs."""
        match = _FILE.match(self.code) if self.language != "sh" else None
        return match[1] if match else ""


def examples(page: Path) -> list[Example]:
    """Returns the examples in the order of the page."""
    text, is_tutorial = page.read_text(encoding="utf-8"), page.parent.name == "tutorials"
    found, is_example = list[Example](), False
    for match in _BLOCK.finditer(text):
        is_example = is_tutorial or bool(match[1]) or (is_example and match[2] == "text")
        if is_example:
            found.append(Example(match[2], match[3], text.count("\n", 0, match.start(3)) + 1))
    return found


def run(page: Path) -> None:
    """Raises what an example raises, and AssertionError for other output than the page shows."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    printed = None
    _save_linked_files(page)
    for example in examples(page):
        where = f"{page.name}:{example.line}"
        print(where)
        if example.language == "text":
            assert printed is not None, f"{where}: no example before this output"
            matches = doctest.OutputChecker().check_output(example.code, printed, _OPTIONS)
            assert matches, f"{where}: expected\n{example.code}\ngot\n{printed}"
        elif example.file:
            Path(example.file).parent.mkdir(parents=True, exist_ok=True)
            Path(example.file).write_text(example.code, encoding="utf-8")
        elif example.language == "python":
            printed = _python(example, where, namespace)
            print(printed)
        else:
            assert example.language == "sh", f"{where}: {example.language} can neither run nor be written"
            printed = _shell(example.code, where)
            print(printed)


def _save_linked_files(page: Path) -> None:
    for link in re.findall(r"\]\((\w[^):#]*\.(?!md)\w+)\)", page.read_text(encoding="utf-8")):
        Path(link).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(page.parent / link, link)


def _python(example: Example, where: str, namespace: dict[str, Any]) -> str:
    code = compile("\n" * (example.line - 1) + example.code, where.partition(":")[0], "exec")
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(code, namespace)
    return printed.getvalue()


def _shell(code: str, where: str) -> str:
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", code], stdout=subprocess.PIPE, text=True, check=False
    )
    assert not done.returncode, f"{where}: exit status {done.returncode}\n{done.stdout}"
    return done.stdout


if __name__ == "__main__":
    sys.path[0] = ""  # the present folder, not that of the tests
    run(Path(sys.argv[1]))
