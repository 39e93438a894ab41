"""How a block becomes an FMU: the only package that knows FMI export."""

import sys
import time

IMPORTED_AT = time.time()  # by this process [s since the epoch]
IMPORTED_BEFORE = frozenset(sys.modules)  # their files may have changed before that time
