"""Matrices of moderate size as tuples of tuples, row by row; a vector is a tuple."""

from functools import reduce
from typing import Any

from fmus.numerics.choice import where

Vector = tuple[Any, ...]
Matrix = tuple[Vector, ...]


def matmul(a: Any, b: Any) -> Any:
    """The product of two matrices, of a matrix and a vector, or of two vectors (a number), as NumPy's `@`."""
    a, b = _tuples(a), _tuples(b)
    if len(a[0] if isinstance(a[0], tuple) else a) != len(b):
        raise ValueError(f"matmul of {_size(a)} and {_size(b)}: expected as many columns as rows")
    if not isinstance(a[0], tuple):
        return matmul((a,), b)[0] if isinstance(b[0], tuple) else _dot(a, b)
    if not isinstance(b[0], tuple):
        return tuple(_dot(row, b) for row in a)
    return tuple(tuple(_dot(row, column) for column in zip(*b, strict=True)) for row in a)


def _tuples(value: Any) -> Any:
    """A vector or matrix as tuples, also one that is given as lists, or as an array of constants."""
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(map(_tuples, value)) if isinstance(value, tuple | list) else value


def _size(value: Any) -> str:
    rows = f"{len(value)}"
    return f"{rows} x {len(value[0])}" if isinstance(value[0], tuple) else f"a vector of {rows}"


def _dot(a: Vector, b: Vector) -> Any:
    # Python's sum begins with 0, which makes 0 of -0, and rounds otherwise since Python 3.12
    return reduce(lambda one, other: one + other, (x * y for x, y in zip(a, b, strict=True)))


def transpose(a: Matrix) -> Matrix:
    """Rows as columns."""
    return tuple(zip(*_tuples(a), strict=True))


def solve(a: Matrix, b: Any) -> Any:
    """The x of a x = b, for a square matrix and a vector or matrix b, as `np.linalg.solve`.

    Gaussian elimination with partial pivoting: for matrices of up to about ten rows, as the compiled code
    grows with their cube. A singular matrix is a division by zero.
    """
    a, b = _tuples(a), _tuples(b)
    if any(len(row) != len(a) for row in a) or len(b) != len(a):
        raise ValueError(f"solve of {_size(a)} and {_size(b)}: expected a square matrix with as many rows")
    if not isinstance(b[0], tuple):
        return tuple(row[0] for row in solve(a, tuple((x,) for x in b)))
    n, rows = len(a), [(*row, *right) for row, right in zip(a, b, strict=True)]
    for k in range(n):
        for i in range(k + 1, n):
            is_larger = abs(rows[i][k]) > abs(rows[k][k])
            rows[k], rows[i] = where(is_larger, (rows[i], rows[k]), (rows[k], rows[i]))
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            rows[i] = tuple(x - factor * p for x, p in zip(rows[i], rows[k], strict=True))
    solution: list[Vector] = []
    for k in reversed(range(n)):
        known = matmul(rows[k][k + 1 : n], tuple(solution)) if solution else (0.0,) * (len(rows[k]) - n)
        solution.insert(0, tuple((x - s) / rows[k][k] for x, s in zip(rows[k][n:], known, strict=True)))
    return tuple(solution)
