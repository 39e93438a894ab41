"""Documentation inside an FMU: page, licences, icon, terminals, reference results."""
