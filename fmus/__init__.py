"""How a block becomes an FMU: the only package that knows FMI export."""
