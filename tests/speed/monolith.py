"""A plan as one C program: what a closed loop costs when there is nothing between its equations.

The same equations as in the FMUs (their own sources), joined by assignments: the yardstick of
`python -m tests.speed`.
"""

from pathlib import Path

_PROGRAM = """\
/* monolith TABLE RESULT REPEAT. Generated from a plan. */
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

{declarations}

enum {{ ROWS = {rows}, COLUMNS = {columns}, RECORDS = {records} }};

static double table[ROWS][COLUMNS], result[ROWS][RECORDS];

static double seconds(void) {{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}}

static void initialise({pointers}) {{
{resets}
{settings}
    {{
        const double *row = table[0];
{signals}
    }}
    for (int pass = 0; pass <= {components}; pass++) {{
{refreshes}
{links}
    }}
{refreshes}
{begins}
}}

static void run({pointers}) {{
    for (int i = 0; i < ROWS; i++) {{
        const double *row = table[i];
        const double t = row[0];
{signals}
{recordings}
        if (i == ROWS - 1) break;
        const double h = table[i + 1][0] - t;
{links}
{advances}
    }}
}}

int main(int argc, char **argv) {{
{values}
    FILE *file = argc == 4 ? fopen(argv[1], "rb") : NULL;
    if (!file || fread(table, sizeof table, 1, file) != 1) return 1;
    fclose(file);
    for (int i = 0; i < atoi(argv[3]); i++) {{
        initialise({arguments});
        const double start = seconds();
        run({arguments});
        printf("%.9f\\n", seconds() - start);
    }}
    file = fopen(argv[2], "wb");
    return !file || fwrite(result, sizeof result, 1, file) != 1 || fclose(file) != 0;
}}
"""


def part(component: int, function: str) -> str:
    """C name of a function of a component's equations (c/equations.c)."""
    return f"part{component}_{function}"


def program(plan: Path) -> str:
    """The main program of a plan; one part is compiled from c/equations.c for each of its components."""
    statements = [line.split(maxsplit=5) for line in plan.read_text(encoding="utf-8").splitlines()]
    count = sum(words[0] == "component" for words in statements)
    (rows,) = [int(words[1]) for words in statements if words[0] == "table"]
    settings = [f"v{a}[{r}] = {value}" for _, a, _, r, value in _of("set", statements)]
    links = [f"v{b}[{s}] = v{a}[{r}]" for _, a, r, b, s in _of("connect", statements)]
    signals = [f"v{a}[{r}] = row[{i}]" for i, (_, a, r) in enumerate(_of("signal", statements), 1)]
    records = [f"result[i][{i}] = v{a}[{r}]" for i, (_, a, r) in enumerate(_of("record", statements))]
    every = range(count)
    return _PROGRAM.format(
        declarations="\n".join(_declaration(i) for i in every),
        rows=rows,
        columns=len(signals) + 1,
        records=len(records),
        components=count,
        pointers=", ".join(f"double *v{i}" for i in every),
        arguments=", ".join(f"v{i}" for i in every),
        values=_lines([f"double *v{i} = {part(i, 'values')}()" for i in every], 1),
        resets=_lines([f"{part(i, 'reset')}()" for i in every], 1),
        refreshes=_lines([f"if (!{part(i, 'refresh')}(table[0][0])) exit(1)" for i in every], 2),
        begins=_lines([f"{part(i, 'begin')}(table[1][0] - table[0][0])" for i in every], 1),
        advances=_lines([f"{part(i, 'advance')}(t, h)" for i in every], 2),
        settings=_lines(settings, 1),
        signals=_lines(signals, 2),
        recordings=_lines(records, 2),
        links=_lines(links, 2),
    )


def _of(verb: str, statements: list[list[str]]) -> list[list[str]]:
    return [words for words in statements if words[0] == verb]


def _declaration(component: int) -> str:
    functions = (
        "double *{}(void)",
        "void {}(void)",
        "int {}(double)",
        "void {}(double)",
        "void {}(double, double)",
    )
    names = ("values", "reset", "refresh", "begin", "advance")
    return "\n".join(f"{f.format(part(component, n))};" for f, n in zip(functions, names, strict=True))


def _lines(statements: list[str], depth: int) -> str:
    return "\n".join(f"{'    ' * depth}{statement};" for statement in statements)
