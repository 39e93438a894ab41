"""`python -m fmus.compliance FMU...`: the same as `l1-depth check FMU...`."""

import sys

from fmus.compliance.check import main
from fmus.errors import MissingExtraError

try:
    sys.exit(main())
except MissingExtraError as error:
    sys.exit(f"python -m fmus.compliance: {error}")
