"""Run a command; print the peak memory [bytes] of its largest process, CPU time of all [s], exit status.

A process starts with the peak of the one that starts it: hence this small one between. An interrupt of the
process group is for the command.
"""

import resource
import signal
import subprocess
import sys

signal.signal(signal.SIGINT, lambda *_: None)
status = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(1024.0 * used.ru_maxrss, used.ru_utime + used.ru_stime, status)
