"""Matrices and vectors as tuples, row by row; tables in one and two dimensions, and ramps in time."""

from collections.abc import Sequence
from functools import reduce
from itertools import pairwise
from typing import Any

from fmus.numerics.choice import clip, where
from fmus.numerics.symbols import are_numbers

__all__ = ["interp", "interp2d", "matmul", "ramp_rates", "ramps", "solve", "transpose"]

Vector = tuple[Any, ...]
Matrix = tuple[Vector, ...]


def matmul(a: Any, b: Any) -> Any:
    """Returns the product of two matrices, a matrix and a vector, or two vectors, as NumPy's `@`.

    Parameters
    ----------
    a, b : tuple, or tuple of rows
        Vectors of n numbers, or matrices of m rows; lists and arrays of constants are taken, too.

    Returns
    -------
    tuple or float
        A matrix, a vector, or, of two vectors, a number.

    Raises
    ------
    ValueError
        If `a` has another number of columns than `b` has rows.

    Examples
    --------
    >>> matmul(((1.0, 2.0), (3.0, 4.0)), (1.0, 1.0))
    (3.0, 7.0)
    """
    a, b = _tuples(a), _tuples(b)
    if len(a[0] if isinstance(a[0], tuple) else a) != len(b):
        raise ValueError(f"matmul of {_size(a)} and {_size(b)}: expected as many columns as rows")
    if not isinstance(a[0], tuple):
        return matmul((a,), b)[0] if isinstance(b[0], tuple) else _dot(a, b)
    if not isinstance(b[0], tuple):
        return tuple(_dot(row, b) for row in a)
    return tuple(tuple(_dot(row, column) for column in zip(*b, strict=True)) for row in a)


def _tuples(value: Any) -> Any:
    """Returns a vector or matrix, given as tuples, lists or an array of constants, as tuples."""
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(map(_tuples, value)) if isinstance(value, tuple | list) else value


def _size(value: Any) -> str:
    rows = f"{len(value)}"
    return f"{rows} x {len(value[0])}" if isinstance(value[0], tuple) else f"a vector of {rows}"


def _dot(a: Vector, b: Vector) -> Any:
    # Python's sum begins with 0, which makes 0 of -0, and rounds otherwise since Python 3.12
    return reduce(lambda one, other: one + other, (x * y for x, y in zip(a, b, strict=True)))


def transpose(a: Matrix) -> Matrix:
    """Returns the rows of a matrix as columns.

    Parameters
    ----------
    a : tuple of m rows
        Matrix; lists and arrays of constants are taken, too.

    Returns
    -------
    tuple of rows

    Examples
    --------
    >>> transpose(((1.0, 2.0), (3.0, 4.0)))
    ((1.0, 3.0), (2.0, 4.0))
    """
    return tuple(zip(*_tuples(a), strict=True))


def solve(a: Matrix, b: Any) -> Any:
    """Returns the x of a x = b, as `np.linalg.solve`.

    The method is Gaussian elimination with partial pivoting. The compiled code grows with the cube of the
    number of rows: use it for up to about ten. A singular matrix is a division by zero.

    Parameters
    ----------
    a : tuple of n rows
        Square matrix.
    b : tuple of n numbers, or of n rows
        Right-hand side, or several as columns.

    Returns
    -------
    tuple
        The solution in the shape of `b`.

    Raises
    ------
    ValueError
        If the shapes do not fit.

    Examples
    --------
    >>> solve(((2.0, 0.0), (0.0, 4.0)), (2.0, 2.0))
    (1.0, 0.5)
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


def interp(x: float, xp: Sequence[float], fp: Sequence[float]) -> float:
    """Returns the straight line through the points (xp, fp) at x, held before the first and after the last.

    Parameters
    ----------
    x : float
        Where the line is evaluated.
    xp : sequence of float
        Ascending numbers or symbols. Two equal ones are a jump, where the later value holds.
    fp : sequence of float
        Values, as many as points.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If the points do not ascend, or their number is not that many values. Points that are parameters are
        not checked here: write a requirement of the block.

    Examples
    --------
    >>> interp(0.5, (0.0, 1.0, 2.0), (0.0, 10.0, 40.0))
    5.0
    """
    _check_points(xp, len(fp), jumps=True)

    def piece(i: int) -> float:
        """Returns the line from point i - 1 to point i; the first and the last piece are constant."""
        # no x lies in a jump, but symbols evaluate every piece: no division by zero
        if i in (0, len(xp)) or (are_numbers(xp[i - 1], xp[i]) and xp[i - 1] == xp[i]):
            return fp[min(i, len(xp) - 1)]
        width = xp[i] - xp[i - 1]
        if not are_numbers(width):
            # 0 times infinity would be no number in an adjoint derivative
            width = where(width == 0.0, 1.0, width)
        return (fp[i] - fp[i - 1]) / width * (x - xp[i - 1]) + fp[i - 1]

    def one_of(first: int, last: int) -> float:
        """Returns the value at x among these pieces."""
        # halved in turn: a chain of choices would be as deep as the table is long
        if first == last:
            return piece(first)
        middle = (first + last) // 2
        return where(x < xp[middle], lambda: one_of(first, middle), lambda: one_of(middle + 1, last))

    return one_of(0, len(xp))


def interp2d(
    x: float, y: float, xp: Sequence[float], yp: Sequence[float], fp: Sequence[Sequence[float]]
) -> float:
    """Returns the bilinear interpolation of a table at (x, y), held outside.

    Parameters
    ----------
    x, y : float
        Where the table is evaluated.
    xp, yp : sequence of float
        Ascending numbers or symbols, without jumps.
    fp : sequence of rows
        `fp[i][j]` is the value at (xp[i], yp[j]).

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If points do not ascend, or rows and columns are not as many as points.

    Examples
    --------
    >>> interp2d(0.5, 0.5, (0.0, 1.0), (0.0, 1.0), ((0.0, 1.0), (2.0, 3.0)))
    1.5
    """
    _check_points(xp, len(fp))
    for row in fp:
        _check_points(yp, len(row))
    weights_x, weights_y = _weights(x, xp), _weights(y, yp)
    return matmul(weights_x, matmul(fp, weights_y))


def _check_points(points: Sequence[float], values: int, jumps: bool = False) -> None:
    """Raises ValueError for points that do not ascend, or another number of values; jumps: equal points."""
    if len(points) != values:
        raise ValueError(f"{len(points)} points and {values} values: expected as many")
    if are_numbers(*points) and not all(a < b or (jumps and a == b) for a, b in pairwise(points)):
        raise ValueError(
            f"points {tuple(points)}: expected ascending numbers; requirements refuse other parameters"
        )


def _weights(x: float, points: Sequence[float]) -> list[float]:
    """Returns the weights of the points at x: positive for its neighbours, with a sum of 1."""
    rises = [clip((x - a) / (b - a), 0.0, 1.0) for a, b in pairwise(points)]
    return [1.0 * (before - after) for before, after in zip([1.0, *rises], [*rises, 0.0], strict=True)]


def ramps(t: float, times: Sequence[float], values: Sequence[float], smooth: bool | float) -> float:
    """Returns ramps through (time, value) at time t, held before the first and after the last point.

    Parameters
    ----------
    t : float
        Time [s].
    times : sequence of float
        Times of the points [s], each later than the one before.
    values : sequence of float
        Values at the points.
    smooth : bool
        Whether ramps are quintic, 10 s^3 - 15 s^4 + 6 s^5, with first and second derivatives of 0 at the
        points, and not straight.

    Returns
    -------
    float

    Examples
    --------
    >>> ramps(0.5, (0.0, 1.0), (0.0, 4.0), smooth=False)
    2.0
    """
    points = list(zip(times, values, strict=True))
    value = points[-1][1]
    for (t_0, y_0), (t_1, y_1) in reversed(list(pairwise(points))):
        s = (t - t_0) / (t_1 - t_0)
        quintic = s**3 * (10.0 + s * (6.0 * s - 15.0))
        value = where(t <= t_1, y_0 + (y_1 - y_0) * where(smooth, quintic, s), value)
    return where(t <= points[0][0], points[0][1], value)


def ramp_rates(
    t: float, times: Sequence[float], values: Sequence[float], smooth: bool | float
) -> tuple[float, float]:
    """Returns the first and second derivative of `ramps` at time t; at a point, of the ramp after it.

    The second derivative of straight ramps is 0 everywhere, also where the first one jumps.

    Parameters
    ----------
    t, times, values, smooth
        See `ramps`.

    Returns
    -------
    tuple of two floats
        Derivatives in the unit of the values per s and per s2.

    Examples
    --------
    >>> ramp_rates(0.5, (0.0, 1.0), (0.0, 4.0), smooth=False)
    (4.0, 0.0)
    """
    points = list(zip(times, values, strict=True))
    start, duration, rise = times[-1], 1.0, 0.0
    for (t_0, y_0), (t_1, y_1) in reversed(list(pairwise(points))):
        start, duration, rise = where(t < t_1, (t_0, t_1 - t_0, y_1 - y_0), (start, duration, rise))
    slope = where(t < times[0], 0.0, rise) / duration
    s = (t - start) / duration
    rest = s * (1.0 - s)
    rate = slope * where(smooth, 30.0 * rest * rest, 1.0)
    return rate, where(smooth, slope / duration * 60.0 * rest * (1.0 - 2.0 * s), 0.0)
