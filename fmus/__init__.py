"""FMUs of FMI 2.0 and 3.0: their declaration as blocks, build, run-time interface and check."""

import sys
import time

IMPORTED_AT = time.time()  # by this process [s since the epoch]
IMPORTED_BEFORE = frozenset(sys.modules)  # their files may have changed before that time
