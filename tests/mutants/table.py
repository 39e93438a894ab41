"""All mutants."""

from tests.mutants.static import STATIC_MUTANTS

MUTANTS = STATIC_MUTANTS
