"""Equations of a guide as MathML: each form that the guides use."""

import re
from typing import Any

import pytest
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]

from fmus.generate import builder
from fmus.generate.documentation.mathml import equations_table, mathematics


def plain(html: str) -> str:
    """The MathML without what only spaces it."""
    return re.sub(
        r"<mspace[^>]*></mspace>| displaystyle=\"true\"|</?mrow>| (stretchy|form)=\"\w+\"", "", html
    )


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("x_1", "<math><msub><mi>x</mi><mi>1</mi></msub></math>"),
        ("A^T", "<math><msup><mi>A</mi><mi>T</mi></msup></math>"),
        ("2 pi", "<math><mn>2</mn><mi>π</mi></math>"),
        ("a x / (b + 1)", "<math><mfrac><mi>a</mi><mi>x</mi><mi>b</mi><mo>+</mo><mn>1</mn></mfrac></math>"),
        ("e^-s", "<math><msup><mi>e</mi><mo>-</mo><mi>s</mi></msup></math>"),
        ("a <= b", "<math><mi>a</mi><mo>≤</mo><mi>b</mi></math>"),
        ("held over the step", "held over the step"),
        ("augmentation pi", "augmentation pi"),
        ("0 V for 0 N", "0 V for 0 N"),
        ("F_1 fore", "<math><msub><mi>F</mi><mi>1</mi></msub></math> fore"),
        ("t_i+1 - t", "<math><msub><mi>t</mi><mi>i+1</mi></msub><mo>-</mo><mi>t</mi></math>"),
    ],
)
def test_a_form_of_the_guides_becomes_mathml(source: str, expected: str) -> None:
    assert plain(mathematics(source)) == expected


def test_a_line_may_break_between_two_formulas() -> None:
    """Browsers break no line within a formula, and a phone has room for one."""
    html = mathematics("x = 1, y = 2, else z")
    assert html.count("<math ") == 3
    assert html.startswith(mathematics("x = 1,"))
    assert mathematics("f(a, b)").count("<math ") == 1


def test_an_estimate_has_its_accent_index_and_prime() -> None:
    accent = '<mover accent="true"><mi>θ</mi><mo>^</mo></mover>'
    prime = '<mo lspace="0" rspace="0">\u2032</mo>'
    assert plain(mathematics("theta_hat_i'")) == f"<math><msub>{accent}<mi>i</mi></msub>{prime}</math>"


def test_a_division_takes_the_product_before_it_and_one_factor_after_it() -> None:
    html = plain(mathematics("beta / T (z - z_p)"))
    assert html.startswith("<math><mfrac><mi>β</mi><mi>T</mi></mfrac><mo>(</mo>")


def test_columns_of_a_line_become_cells_and_the_equals_sign_begins_one() -> None:
    table: Any = etree.fromstring(equations_table("B(z)   = B_0     submerged\n       0        emerged\n"))
    rows = [["".join(cell.itertext()) for cell in row] for row in table.iter("tr")]
    assert rows == [["B(z)", "=B0", "submerged"], ["", "0", "emerged"]]


def test_a_sentence_with_an_equation_stays_one_cell() -> None:
    table: Any = etree.fromstring(equations_table("With law pi, theta = 0 at t:\nx = 1     off\n"))
    first = next(table.iter("td"))
    assert first.get("colspan") == "3"


@pytest.mark.parametrize("name", builder.block_names())
def test_the_equations_of_every_block_are_well_formed_and_lose_no_token(name: str) -> None:
    source = builder.load_block(name).guide.equations
    table: Any = etree.fromstring(equations_table(source))
    shown = "".join(table.itertext())
    for number in re.findall(r"(?<![\w.])\d+(?:\.\d+)?(?!\w)", source):
        assert number in shown
    for word in re.findall(
        r"(?<![\w^'])[a-z]{5,}(?![\w^'])", re.sub(r"alpha|gamma|delta|theta|sigma|omega|lambda", "", source)
    ):
        assert word in shown


@pytest.mark.parametrize(
    "source", ["(", ")", "a ^", "a /", "|x", "[1, 2", "^", "_", "a^^b", "/ /", "<b>&", ""]
)
def test_an_unfinished_formula_is_shown_and_not_refused(source: str) -> None:
    table: Any = etree.fromstring(equations_table(source or " "))
    assert "b" not in {element.tag for element in table.iter()}
