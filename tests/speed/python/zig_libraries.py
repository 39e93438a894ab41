"""The compiler's own libraries for platforms, in either state: PLATFORM..."""

import sys

from fmus.native.toolchain import compile_library

# exported, as Zig ends with a fault where a library for macOS exports nothing
TEXT = '#include <math.h>\n__attribute__((visibility("default"))) double f(double x) { return sin(x); }\n'
for platform in sys.argv[1:]:
    compile_library("empty", {"empty.c": TEXT}, ["empty.c"], platform)
