"""The check of an FMU against FMI 2.0.5: rules of its archive, description, libraries and behaviour."""
