"""Command cache: files that are kept for this user between commands."""

import os
from typing import Annotated, Literal

import typer

from fmus import store
from fmus.errors import nearest
from fmus.registry import FOLDER_VARIABLE
from orchestration.cli.shared import fail

_CONTENT = {
    store.BUILDS: "records of what you built: unchanged FMUs are not built again, and run in ensembles",
    store.FMUS: "FMUs that scenarios run",
    "libraries": "compiled code of runs and ensembles",
    "gpu": "compiled code of runs on a GPU",
}


def cache(
    action: Annotated[
        Literal["show", "clear"], typer.Argument(help="Show what is kept, or remove it.")
    ] = "show",
    kinds: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KIND",
            help=f"Only these kinds: {', '.join(_CONTENT)}.",
            autocompletion=lambda: [*_CONTENT],
        ),
    ] = None,
) -> None:
    """Show or clear the files that are kept between commands: where they are, and how large.

    Cleared entries are made again when they are needed. So the cache can be cleared at any time, also while
    other commands run. Records of builds are cleared only if their kind is named: an FMU without its record
    runs like one of another tool.

    The entries that were used longest ago are removed automatically. Results are not in the cache: an
    interrupted sweep or tuning continues from the files beside its results.

    For example, l1-depth cache clear libraries removes the compiled code of runs.
    """
    for kind in kinds or ():
        if kind not in _CONTENT:
            fail(f"no kind {kind!r}; {nearest(kind, _CONTENT)}", 2)
    print(store.folder(), f"{'kind':<10}{'files':>7}{'MB':>10}", sep="\n")
    for kind in kinds or [kind for kind in _CONTENT if action == "show" or kind != store.BUILDS]:
        try:
            sizes = store.clear(kind) if action == "clear" else [size for _, size, _ in store.entries(kind)]
            note = "freed" if action == "clear" else _CONTENT[kind]
        except BlockingIOError:
            sizes, note = [], "kept: another command runs FMUs"
        note = store.reason_for_distrust(store.folder(kind)) or note
        print(f"{kind:<10}{len(sizes):>7}{sum(sizes) / 1e6:>10.2f}  {note}")
    if folder := os.environ.get(FOLDER_VARIABLE):
        print(f"FMUs of scenarios are in {folder}, as {FOLDER_VARIABLE} says: they are not counted and stay")
