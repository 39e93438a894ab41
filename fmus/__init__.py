"""How a block becomes an FMU: the only package that knows FMI export."""

import time

IMPORTED_AT = time.time()  # by this process [s since the epoch], before any module of a block
