"""Imported by the processes that tests start: they note the lines that they execute."""

import os
from contextlib import suppress

if "L1_DEPTH_MUTATION_LINES" in os.environ:
    with suppress(ImportError):
        from tests.mutation.lines import trace_this_process

        trace_this_process()
