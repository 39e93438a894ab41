"""How fast the FMUs and the master are, as ratios measured in one run on one machine.

Medians over rounds; what is compared takes turns, so that all see the same disturbances.

    layers.py     one step of a block, through FMI and without
    scenarios.py  a whole scenario, down to the same equations as one C program
    importers.py  the overhead of a communication step, in this master and in every other importer
    loops.py      what each of them does with the two FMUs of pair.py
    sweeps.py     metrics, and samples of a sweep beside their bare runs
    scale.py      how loading, preparing and stepping grow with the number of FMUs
    memory.py     memory of long recordings beside their raw size
    tables.py     what was measured, with the ratios that matter
"""
