"""How fast the project is: the tables of docs/performance.md, by `python -m tests.speed`.

Medians over rounds; what is compared between two states takes turns, so that both see the same disturbances,
but for chains, memory and sweeps that grow. Each part is a module with a function
`measure(Options) -> Part` (part.py):

    commands.py   whole commands, beside the same loop in other importers
    steps.py      one step of a block, through FMI and without (layers.py), in two states of the project
    runs.py       a whole scenario in two states, and down to one C program (scenarios.py)
    sweeps.py     samples of a sweep beside their bare runs
    ensemble.py   a step of an ensemble beside one of a simulator
    scale.py      how loading, preparing and stepping grow with the number of FMUs; threads
    memory.py     memory of long recordings beside their raw size
    samples.py    memory and time of sweeps that grow
    stepping.py   a loop of the caller's own, and environments for agents
    importers.py  a communication step of the two FMUs of pair.py in every importer (loops.py)

A state (states.py) is a clone or a git revision; what runs in either is in python/.
"""
