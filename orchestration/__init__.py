"""Everything that uses FMUs, through their model descriptions alone."""
