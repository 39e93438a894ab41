"""The C layer of native FMUs, and its compiler."""
