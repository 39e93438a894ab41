"""Does an FMU keep the rules of FMI 2.0.5? Rules of its archive, description, libraries and behaviour."""
