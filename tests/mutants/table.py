"""All mutants."""

from tests.mutants.archive import ARCHIVE_MUTANTS
from tests.mutants.behaviour import BEHAVIOUR_MUTANTS
from tests.mutants.listed import LISTED_MUTANTS
from tests.mutants.oscillator import OSCILLATOR_MUTANTS

STATIC_MUTANTS = (*LISTED_MUTANTS, *ARCHIVE_MUTANTS)
RUN_MUTANTS = (*BEHAVIOUR_MUTANTS, *OSCILLATOR_MUTANTS)
MUTANTS = (*STATIC_MUTANTS, *RUN_MUTANTS)
