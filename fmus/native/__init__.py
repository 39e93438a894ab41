"""The C layer of native FMUs, its compiler, and the compiled libraries with their bill of materials."""
