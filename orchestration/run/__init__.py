"""The compiled master algorithm: connects FMUs for co-simulation, FMI 2.0 or 3.0, and steps them together.

Communication points are t_i = start + i h, never accumulated; a last shorter step lands on the stop
time. At each point: scheduled changes are made, outputs are exchanged and recorded.

    Jacobi         every component steps from t_i to t_{i+1} with the outputs of t_i
    Gauss-Seidel   in the order of the components, each with the newest outputs there are

Inputs are held over a step, first order in h, or extrapolated with their last slope, second order.

    one_run.py         one run to its end, with every setting as an argument
    simulator.py       FMUs that stay loaded, and runs of them
    run.py, access.py  a run: it advances, reads, sets, saves and restores
    initialisation.py  initial values
    wiring.py, bus.py, loop_data.py  a prepared run as arrays
    loop.c             the communication loop over these arrays; compiled_loop.py calls it, also on threads
    step_control.py, tolerance.py  shorter steps: after a discard, and to meet a tolerance
    error_estimate.py  how far exchanging at communication points leads astray, by a second run
    saved_states.py, checkpoint.py  the system at one point, in memory and as a file
    run_recording.py   what a run returns and raises
    run_clock.py       the times of its phases, and real time
    subprocess_run.py  a run whose FMUs are in a process of their own
    process_guard.py   interrupts, floating-point mode, an end by `exit`, forked children
"""

from orchestration.run.one_run import simulate
from orchestration.run.run import Progress
from orchestration.run.simulator import Simulator

__all__ = ["Progress", "Simulator", "simulate"]
