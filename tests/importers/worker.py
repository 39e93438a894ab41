"""One importer runs a job, in a process of its own."""

from importlib import import_module

from fmus.process import Parent


def run_job(parent: Parent) -> None:
    """Run the job that is sent with the name of an importer; send its trajectory."""
    importer, job = parent.receive()
    parent.send(import_module(f"tests.importers.{importer}").run(job))
