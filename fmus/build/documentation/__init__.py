"""What goes inside an FMU: page, icon, terminals, reference results."""
