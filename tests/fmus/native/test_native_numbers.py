"""Numbers in the messages of the C layer."""

import subprocess
from pathlib import Path

from fmus.native import toolchain
from tests.shared_builds import c_sources_of

from .blocks import EVERYTHING
from .session import GUID

_COMMA = """
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int print(char *text, size_t size, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    const int length = vsnprintf(text, size, format, arguments);
    va_end(arguments);
    for (char *c = text; *c; c++) *c = *c == '.' ? ',' : *c;
    return length;
}

static double read(const char *text, char **end) {
    char plain[64];
    strcpy(plain, text);
    for (char *c = plain; *c; c++) *c = *c == ',' ? '.' : *c;
    return strtod(plain, end);
}

#define snprintf print
#define strtod read
#define STANDARD fmi2
#define LogMessageCallback CallbackLogger
#define LOG_ESCAPED "%#"
#include "fmi2Functions.h"
#include "log.h"

int main(int count, char **texts) {
    for (int i = 1; i < count; i++) puts(DECIMAL(read(texts[i], NULL)));
    return log_category("logAll") != LOG_ALL;
}
"""


def test_numbers_in_messages_are_the_shortest_with_a_point_also_where_the_host_prints_commas(
    tmp_path: Path,
) -> None:
    for name, text in (c_sources_of(EVERYTHING, GUID) | {"comma.c": _COMMA}).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    toolchain.zig(
        ["cc", *toolchain.FLAGS, "-I", str(toolchain.FMI_HEADERS), "-o", "comma", "comma.c"], tmp_path
    )
    numbers = ["0.5", "0.1", "1e-07", "0.30000000000000004", "-1.7976931348623157e+308", "3", "nan", "inf"]
    command = [str(tmp_path / "comma"), *numbers]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.split() == numbers
