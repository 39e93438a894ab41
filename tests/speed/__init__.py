"""How fast the FMUs and the master are, as ratios measured in one run on one machine.

Medians over rounds; what is compared takes turns, so that all see the same disturbances.

    layers.py     one step of a block, through FMI and without
    scenarios.py  a whole scenario, down to the same equations as one C program
    importers.py  the overhead of a communication step, in this master and in every other importer
    loops/        what each of them does with the two FMUs of pair.py
    tables.py     what was measured, with the ratios that matter
"""

from tests.speed.importers import LOOPS, compare
from tests.speed.layers import layer
from tests.speed.scenarios import loop
from tests.speed.tables import machine, tables

__all__ = ["LOOPS", "compare", "layer", "loop", "machine", "tables"]
