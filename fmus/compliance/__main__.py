"""`python -m fmus.compliance FMU...`: exit status 1 if an FMU breaks a rule, 2 for bad usage."""

import sys

from fmus.errors import MissingExtraError

try:
    from fmus.compliance.check import main

    status = main()
except MissingExtraError as error:
    sys.exit(f"python -m fmus.compliance: {error}")

sys.exit(status)
