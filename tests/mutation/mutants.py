"""Small mistakes in a source of Python or C: one changed operator, constant, name or statement each."""

import ast
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_SYMBOLS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Pow: ("**", "*"),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}
_NAMES = {"min": "max", "minimum": "maximum", "sin": "cos", "any": "all", "True": "False", "floor": "ceil"}
_NAMES |= {other: name for name, other in _NAMES.items()}
_C_TOKENS = {
    **{"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "&&": "||", "||": "&&"},
    **{"+": "-", "-": "+", "*": "/", "/": "*", "true": "false", "false": "true", "break": "continue"},
    **{"0": "1", "1": "2", "0.0": "1.0", "1.0": "2.0", "NAN": "0.0", "!": "", "fmi2True": "fmi2False"},
    **{
        "fmi2False": "fmi2True",
        "fmi2OK": "fmi2Error",
        "fmi2Error": "fmi2Discard",
        "fmi2Discard": "fmi2Error",
    },
}
# a statement on a line of its own; an operator between spaces (no pointer, no ++); a word
_C_STATEMENT = re.compile(
    r"^[ \t]+(?=\w)(?!(?:return|break|continue|goto|typedef|static|const|unsigned|else|for|if|while|do)\b)"
    r"(?!\w+[ *]+\w+(?:[,;\[]| =))[^;{}\n]*[(=][^;{}\n]*;$",
    re.MULTILINE,
)
_C_TOKEN = re.compile(
    r"(?<= )(?:<=?|>=?|==|!=|&&|\|\||[-+*/])(?= )|!(?=[\w(])|(?<![\w.])(?:\d\.\d|[01]|[a-zA-Z]\w+)(?![\w.])"
)
_C_HIDDEN = re.compile(r'/\*.*?\*/|//[^\n]*|^[ \t]*#(?:[^\n]*\\\n)*[^\n]*|"(?:[^"\\\n]|\\.)*"', re.M | re.S)


@dataclass(frozen=True)
class Mutant:
    """A file with one mistake: `content[start:end]` became `replacement`."""

    path: Path
    start: int
    end: int
    replacement: str

    def source(self, content: str) -> str:
        return content[: self.start] + self.replacement + content[self.end :]

    def line(self, content: str) -> int:
        return content.count("\n", 0, self.start) + 1

    def describe(self, content: str) -> str:
        """File, line, column, and what became what."""
        line, column = self.line(content), self.start - content.rfind("\n", 0, self.start)
        before = " ".join(content[self.start : self.end].split())
        return f"{self.path}:{line}:{column}: {before} -> {' '.join(self.replacement.split()) or 'nothing'}"


def mutants_of(path: Path, content: str) -> list[Mutant]:
    """Every mutant of a file. Declarations of variables, messages and annotations have none."""
    changes = _of_python(content) if path.suffix == ".py" else _of_c(content)
    return [Mutant(path, start, end, replacement) for start, end, replacement in changes]


def chosen(mutants: list[Mutant], count: int, seed: int) -> list[Mutant]:
    """`count` of them, drawn without regard to the file, in an order by chance: fewer are a draw as well."""
    drawn = list(mutants)
    random.Random(seed).shuffle(drawn)
    return drawn[:count]


def statement_lines(content: str, line: int) -> range:
    """The lines of the statement in Python that a line is in, without the statements in that."""
    lines = range(line, line + 1)
    for node in ast.walk(ast.parse(content)):  # those that are further inside come later
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or 0):
            inner: list[ast.stmt] = getattr(node, "body", [])
            end = inner[0].lineno if inner else (node.end_lineno or 0) + 1
            lines = range(node.lineno, max(end, node.lineno + 1)) if line < end else lines
    return lines


def _of_c(content: str) -> Iterator[tuple[int, int, str]]:
    visible = _C_HIDDEN.sub(lambda hidden: re.sub(r"[^\n]", "\0", hidden[0]), content)
    for token in _C_TOKEN.finditer(visible):
        if token[0] in _C_TOKENS:
            yield token.start(), token.end(), _C_TOKENS[token[0]]
    for statement in _C_STATEMENT.finditer(visible):
        if visible[: statement.start()].rstrip()[-1] in ";{}\0":  # else it continues the line before
            yield statement.end() - len(statement[0].lstrip()), statement.end(), ";"


def _of_python(content: str) -> Iterator[tuple[int, int, str]]:
    starts = [0]
    for line in content.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    encoded = content.encode()

    def position(line: int, column: int) -> int:
        return len(encoded[: starts[line - 1] + column].decode())

    def span(node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return position(node.lineno, node.col_offset), position(node.end_lineno, node.end_col_offset)

    for function in ast.walk(ast.parse(content)):
        if isinstance(function, (ast.FunctionDef, ast.Lambda)):
            body = function.body if isinstance(function.body, list) else [function.body]
            for part in body:
                for node in _executed(part):
                    for left, right, symbol in _operators(node):
                        start, end = span(left)[1], span(right)[0]
                        before, after = _SYMBOLS[type(symbol)]
                        yield start, end, content[start:end].replace(before, after, 1)
                    yield from (
                        (*span(replaced), text) for replaced, text in _replacements(node, content, span)
                    )


def _executed(node: ast.AST) -> Iterator[ast.AST]:
    """A node and what is in it, but for other functions, annotations, messages and docstrings."""
    if isinstance(node, (ast.FunctionDef, ast.Lambda, ast.Raise, ast.JoinedStr)):
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name not in ("annotation", "decorator_list"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _executed(child)


def _operators(node: ast.AST) -> Iterator[tuple[ast.expr, ast.expr, ast.AST]]:
    if isinstance(node, ast.Compare):
        operands = [node.left, *node.comparators]
        yield from zip(operands, operands[1:], node.ops, strict=False)
    elif isinstance(node, ast.BoolOp):
        yield node.values[0], node.values[1], node.op
    elif isinstance(node, ast.BinOp) and type(node.op) in _SYMBOLS:
        yield node.left, node.right, node.op


def _replacements(node: ast.AST, content: str, span) -> Iterator[tuple[ast.expr | ast.stmt, str]]:
    def text(part: ast.expr) -> str:
        start, end = span(part)
        return content[start:end]

    match node:
        case ast.Constant(value=bool() as value):
            yield node, str(not value)
        case ast.Constant(value=int() as value):
            yield node, str(value + 1)
        case ast.Constant(value=float() as value):
            yield node, repr(2.0 * value or 1.0)
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield node, f"({text(operand)})"
        case ast.If(test=test) | ast.IfExp(test=test) | ast.While(test=test):
            yield test, f"(not ({text(test)}))"
        case ast.Name(id=name) | ast.Attribute(attr=name) if name in _NAMES:
            assert isinstance(node, ast.expr)
            yield node, text(node).removesuffix(name) + _NAMES[name]
        case ast.Expr(value=ast.Call()) | ast.AugAssign():
            assert isinstance(node, ast.stmt)
            yield node, "pass"
