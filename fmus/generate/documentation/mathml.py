"""Equations of a guide, lines of ASCII, as an HTML table of text and MathML.

Columns of a line are two spaces or more apart; the first " = " begins another column. In a column,
`theta_hat_i`, `x'`, `A^T`, `|x|_inf`, `a / b` and Greek names become mathematics, words stay text.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from itertools import groupby

_NAMES = (
    "alpha beta gamma delta eps zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi"
    " psi omega Gamma Delta Theta Lambda Xi Pi Sigma Phi Psi Omega inf sum int"
)
_LETTERS: dict[str, str] = dict(zip(_NAMES.split(), "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΦΨΩ∞∑∫", strict=True))
_SIGNS = {"<=": "≤", ">=": "≥", "+-": "±", "~": "\u223c", "..": "…"}
_ACCENTS = {"hat": "^", "tilde": "~"}
_CLOSING = {"(": ")", "[": "]", "|": "|"}
_TOKEN = re.compile(
    r" *(?:(?P<word>\d+ [NV]\b|[A-Za-z]+_\.\.\.)|(?P<number>\d+(?:\.\d+)?)"
    r"|(?P<name>[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*(?:(?<=_i)\+1)?'*)"
    r"|(?P<sign><=|>=|\+-|\.\.+|[^ ]))"
)
_SPACE = '<mspace width=".2em"></mspace>'
_WIDE_SPACE = 4 * _SPACE
_MATH = '<math displaystyle="true">'


def equations_table(text: str) -> str:
    """Returns the HTML table of a guide's equations, a row a line."""
    rows = [_columns(line) for line in text.strip("\n").splitlines()]
    width = max(map(len, rows))
    body = "\n".join(f"<tr>{''.join(_cells(columns, width))}</tr>" for columns in rows)
    return f'<div class="scroll"><table class="equations">\n{body}\n</table></div>'


def _columns(line: str) -> list[str]:
    # spaces after a comma stand between two equations of one column
    first, *others = re.split(r"(?<=[^,; ]) {2,}", line.rstrip())
    if line.startswith("  "):
        return ["", first.strip(), *others]
    left, equals, right = first.partition(" = ")
    # a sentence with an equation in it has words on the left
    is_equation = equals and not re.search(r"[a-z_]{3,} [a-z_]{3,}", left)
    return [left.strip(), f"= {right}", *others] if is_equation else [first, *others]


def _cells(columns: list[str], width: int) -> Iterator[str]:
    """Yields the cells of a row; the last one spans the columns that the row lacks."""
    *others, last = map(mathematics, columns)
    yield from (f"<td>{cell}</td>" for cell in others)
    missing = width - len(others)
    yield f'<td colspan="{missing}">{last}</td>' if missing > 1 else f"<td>{last}</td>"


def mathematics(text: str) -> str:
    """Returns the HTML of a line: its words as they are, its formulas as MathML."""
    parts = []
    for is_text, items in groupby(_Reader(_tokens(text)).items(), key=lambda item: item[0]):
        content = [html for _, html in items]
        parts += content if is_text else [f"{_MATH}{''.join(content)}</math>"]
    # browsers break lines between formulas alone
    html = " ".join(parts).replace(f"{_WIDE_SPACE}</math>", "</math>&#8195;")
    return re.sub(r" ([,;:.])", r"\1", html.replace(_WIDE_SPACE, f"</math>&#8195; {_MATH}"))


@dataclass(frozen=True)
class _Token:
    """A word, a number, a name or a sign; tight: whether no space stands before it."""

    kind: str
    text: str
    tight: bool


def _tokens(text: str) -> list[_Token]:
    tokens = []
    for match in _TOKEN.finditer(text.strip()):
        kind = match.lastgroup or ""
        tokens.append(_Token(kind, match[kind], match.start() == match.start(kind)))
    for i, token in enumerate(tokens):
        if token.kind == "name" and not _is_symbol(tokens, i):
            tokens[i] = _Token("word", token.text, token.tight)
    return tokens


def _is_symbol(tokens: list[_Token], i: int) -> bool:
    """Whether a name stands for a number or a function; other names are words, or variables of the FMU."""
    base, *subscripts = tokens[i].text.rstrip("'").split("_")
    after = tokens[i + 1] if i + 1 < len(tokens) else _Token("", "", tight=False)
    after_word = i > 0 and tokens[i - 1].kind == "word"
    if base in _LETTERS or base == "a":
        # "augmentation pi", "over a line": after a word, it is a word, too
        return bool(subscripts) or not after_word
    is_called = after.tight and after.text in ("(", "^")
    is_indexed = bool(subscripts) and not after_word and all(len(index) == 1 for index in subscripts)
    return len(base) == 1 or is_called or is_indexed or bool(re.fullmatch("[A-Z][A-Za-z]|dt", base))


class _Reader:
    """Reads tokens from the first to the last."""

    def __init__(self, tokens: list[_Token]) -> None:
        self._tokens = [*reversed(tokens)]

    def items(self, closing: str = "") -> list[tuple[bool, str]]:
        """Returns (whether it is text, HTML) of the tokens before a closing sign, or of all."""
        items: list[tuple[bool, str]] = []
        # factors at the end of the items: a division takes all of them
        factors = 0
        while self._tokens and self._tokens[-1].text != (closing or None):
            token = self._tokens[-1]
            if token.kind == "word" and not closing:
                items.append((True, escape(self._tokens.pop().text)))
                factors = 0
            elif token.text == "/" and factors:
                self._tokens.pop()
                above = _row([_bare(html) if factors == 1 else html for _, html in items[-factors:]])
                items[-factors:] = [(False, f"<mfrac>{above}{_bare(self._factor())}</mfrac>")]
                factors = 1
            elif token.kind == "sign" and token.text not in _CLOSING:
                self._tokens.pop()
                in_text = token.text in ",;:." and bool(items) and items[-1][0]
                sign = escape(_SIGNS.get(token.text, token.text))
                form = ' form="prefix"' if not items or items[-1][1].startswith(("<mo>", "<mo ")) else ""
                space = _WIDE_SPACE if token.text == "," and not closing else ""
                items.append((in_text, sign if in_text else f"<mo{form}>{sign}</mo>{space}"))
                factors = 0
            else:
                items.append((False, (_SPACE if factors else "") + self._factor()))
                factors += 1
        return items

    def _factor(self) -> str:
        """Returns a number, a symbol or a bracket with what belongs to it: exponent, index, arguments."""
        if not self._tokens:
            return "<mrow></mrow>"
        token = self._tokens.pop()
        closing = _CLOSING.get(token.text, "")
        if closing and any(other.text == closing for other in self._tokens):
            html = _bracketed(token.text, "".join(html for _, html in self.items(closing)), closing)
            self._tokens.pop()
        else:
            html = _symbol(token)
        while self._follows("^") or self._follows("_"):
            element = "msup" if self._tokens.pop().text == "^" else "msub"
            minus = "<mo>-</mo>" if self._follows("-") and self._tokens.pop() else ""
            html = f"<{element}>{html}{_row([minus, _bare(self._factor())])}</{element}>"
        if token.kind == "name" and self._follows("("):
            html = _row([html, self._factor()])
        return html

    def _follows(self, sign: str) -> bool:
        """Whether a sign follows without a space."""
        return bool(self._tokens) and self._tokens[-1].tight and self._tokens[-1].text == sign


def _symbol(token: _Token) -> str:
    """Returns the MathML of a token that is no bracket."""
    if token.kind != "name":
        element = "mn" if token.kind == "number" else "mtext"
        return f"<{element}>{escape(token.text)}</{element}>"
    name = token.text.rstrip("'")
    base, *subscripts = name.split("_")
    html = f"<mi>{_LETTERS.get(base, base)}</mi>"
    if subscripts and subscripts[0] in _ACCENTS:
        html = f'<mover accent="true">{html}<mo>{_ACCENTS[subscripts.pop(0)]}</mo></mover>'
    if subscripts:
        below = _row([f"<mi>{_LETTERS.get(index, index)}</mi>" for index in subscripts])
        html = f"<msub>{html}{below}</msub>"
    primes = "\u2032" * (len(token.text) - len(name))
    return _row([html, f'<mo lspace="0" rspace="0">{primes}</mo>']) if primes else html


def _row(parts: list[str]) -> str:
    return f"<mrow>{''.join(parts)}</mrow>"


def _bracketed(opening: str, content: str, closing: str) -> str:
    # accents and primes alone would stretch a bracket, too
    stretchy = "" if "<mfrac>" in content else ' stretchy="false"'
    first, last = (f"<mo{form}{stretchy}>" for form in (' form="prefix"', ' form="postfix"'))
    return f"<mrow>{first}{opening}</mo>{content}{last}{closing}</mo></mrow>"


def _bare(factor: str) -> str:
    """Returns a factor without its parentheses, which a fraction and an exponent replace."""
    match = re.fullmatch(r"<mrow><mo[^>]*>\(</mo>(.*)<mo[^>]*>\)</mo></mrow>", factor)
    return _row([match[1]]) if match else factor
