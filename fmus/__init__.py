"""FMUs of FMI 2.0: their declaration as blocks, their build, their check, and what running one needs."""

import sys
import time

IMPORTED_AT = time.time()  # by this process [s since the epoch]
IMPORTED_BEFORE = frozenset(sys.modules)  # their files may have changed before that time
