# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Numbers from outside as bounds in double precision, rounded outward.

Not every integer beyond 2^53, long double, fraction or decimal is a double. Such a bound, rounded
to the nearest double, may exclude the number that it bounds.
"""

from __future__ import annotations

from decimal import Decimal
import math
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

LARGEST_EXACT = 2**53
"""All integers up to this size are doubles."""


def lower_bounds(values: ArrayLike) -> NDArray[np.float64]:
    """
    Return the largest doubles that do not exceed given numbers.

    Parameters
    ----------
    values : array_like
        Real numbers: of Python (decimals and fractions included) or of NumPy, of any size.

    Returns
    -------
    ndarray
        A new array of doubles, of the same shape. NaN stays NaN.

    Raises
    ------
    ValueError
        If the values are masked, do not form an array, or are not real numbers: complex ones,
        truth values, text.

    """
    return _rounded(values, -math.inf)


def upper_bounds(values: ArrayLike) -> NDArray[np.float64]:
    """Return the least doubles that are not less than given numbers; see `lower_bounds`."""
    return _rounded(values, math.inf)


def _rounded(values: ArrayLike, towards: float) -> NDArray[np.float64]:
    """Return the doubles next to given numbers towards one of the infinities."""
    array = _as_array(values)
    if array.dtype.kind == 'f':
        return _round_floats(array, towards)
    if array.dtype.kind in 'iu' and _are_exact(array):
        return array.astype(np.float64)
    if array.dtype.kind not in 'iuO':
        raise ValueError(f'has entries of type {array.dtype}, real numbers are needed')
    result = np.empty(array.shape)
    for index, value in np.ndenumerate(array.astype(object)):
        result[index] = _round_number(value, towards, index)
    return result


def _as_array(values: ArrayLike) -> NDArray:
    """Return an array of the values, without rounding any of them."""
    parts = [values, *values] if isinstance(values, list | tuple) else [values]
    if any(isinstance(part, np.ma.MaskedArray) for part in parts):
        raise ValueError('is a masked array; give unknown pairs the bounds 0 and inf')
    if hasattr(values, '__array__'):
        return np.asarray(values)
    try:
        # NumPy would convert integers beside doubles to doubles.
        return np.array(values, dtype=object)
    except ValueError:
        raise ValueError('has rows of different lengths') from None


def _are_exact(integers: NDArray) -> bool:
    """Return whether all integers are exact doubles."""
    if integers.size == 0:
        return True
    return -LARGEST_EXACT <= int(integers.min()) and int(integers.max()) <= LARGEST_EXACT


def _round_floats(array: NDArray, towards: float) -> NDArray[np.float64]:
    """Round floating-point numbers of any precision."""
    with np.errstate(over='ignore', invalid='ignore'):
        nearest = array.astype(np.float64)
        if array.dtype.itemsize <= nearest.dtype.itemsize:
            return nearest
        again = nearest.astype(array.dtype)
        is_beyond = again < array if towards > 0.0 else again > array
        return np.where(is_beyond, np.nextafter(nearest, towards), nearest)


def _round_number(value: Any, towards: float, index: tuple[int, ...]) -> float:
    """Round a number of Python or of NumPy."""
    if not isinstance(value, Real | Decimal) or isinstance(value, bool):
        place = ','.join(map(str, index))
        raise ValueError(f'has the entry [{place}] = {value!r}, a real number is needed')
    if isinstance(value, Integral):
        value = int(value)  # NumPy compares its integers with doubles as doubles
    try:
        nearest = float(value)
    except OverflowError:
        nearest = math.inf if value > 0 else -math.inf
    if math.isnan(nearest):
        return nearest
    # Python compares a double with an integer, a fraction or a decimal exactly.
    is_beyond = nearest < value if towards > 0.0 else nearest > value
    return math.nextafter(nearest, towards) if is_beyond else nearest
