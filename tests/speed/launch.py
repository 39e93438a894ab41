"""Run a command; print its time [s], CPU time of all its processes [s] and the peak of the largest [bytes].

A process starts with the peak of the one that starts it: hence this small one between.
"""

import json
import resource
import subprocess
import sys
import time

start = time.perf_counter()
status = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([time.perf_counter() - start, used.ru_utime + used.ru_stime, 1024 * used.ru_maxrss]))
sys.exit(status)
