# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Interval arithmetic on numpy arrays, rounded outward, for coordinates and directions.

The steps outward are those of `rounding`, on whole arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dg_localization.interval.rounding import LARGEST, TINIEST, UNIT

# Arrays, since converting a Python number to an array takes longer than a short sum.
_UNIT, _TINIEST = np.array(UNIT), np.array(TINIEST)
_LEAST, _MOST = np.array(-LARGEST), np.array(LARGEST)


def up(values: ArrayLike) -> np.ndarray:
    """Return numbers above the exact values whose nearest doubles are `values`."""
    values = np.maximum(values, _LEAST)
    return np.asarray(values + (np.abs(values) * _UNIT + _TINIEST))


def down(values: ArrayLike) -> np.ndarray:
    """Return numbers below the exact values whose nearest doubles are `values`."""
    values = np.minimum(values, _MOST)
    return np.asarray(values - (np.abs(values) * _UNIT + _TINIEST))


def total_up(values: np.ndarray) -> np.ndarray:
    """Return upper bounds of the sums of non-negative numbers along the last axis."""
    total = values.sum(axis=-1)
    return np.asarray(total + values.shape[-1] * (total * UNIT + TINIEST))


def elapsed_up(first_s: np.ndarray, second_s: np.ndarray) -> np.ndarray:
    """Return upper bounds of the times between stamps, as `bounds.elapsed_up` does for one."""
    units_s = np.spacing(np.maximum(np.abs(first_s), np.abs(second_s)))
    return up(up(np.abs(first_s - second_s)) + units_s)


@dataclass(frozen=True)
class Interval:
    """
    Arrays of closed intervals; every operation contains all results of its members.

    Parameters
    ----------
    lower, upper : numpy.ndarray
        Bounds of equal shape. An element with ``lower > upper`` is empty.

    """

    lower: np.ndarray
    upper: np.ndarray

    @staticmethod
    def around(center: np.ndarray | float, radius: np.ndarray | float) -> Interval:
        """Return [center - radius, center + radius]."""
        return Interval(down(np.subtract(center, radius)), up(np.add(center, radius)))

    @staticmethod
    def between(lower: ArrayLike, upper: ArrayLike) -> Interval:
        """Return [lower, upper]."""
        return Interval(np.asarray(lower, dtype=float), np.asarray(upper, dtype=float))

    @staticmethod
    def point(values: ArrayLike) -> Interval:
        """Return intervals of one number each."""
        array = np.asarray(values, dtype=float)
        return Interval(array, array)

    @staticmethod
    def stack(parts: list[Interval], axis: int = -1) -> Interval:
        """Return the parts joined along a new axis."""
        return Interval(
            np.stack([p.lower for p in parts], axis), np.stack([p.upper for p in parts], axis)
        )

    def __getitem__(self, index: Any) -> Interval:
        return Interval(self.lower[index], self.upper[index])

    def __neg__(self) -> Interval:
        return Interval(-self.upper, -self.lower)

    def __add__(self, other: Interval) -> Interval:
        return Interval(down(self.lower + other.lower), up(self.upper + other.upper))

    def __sub__(self, other: Interval) -> Interval:
        return Interval(down(self.lower - other.upper), up(self.upper - other.lower))

    def __mul__(self, other: Interval) -> Interval:
        with np.errstate(invalid='ignore'):
            corners = np.array(
                [a * b for a in (self.lower, self.upper) for b in (other.lower, other.upper)]
            )
        # Zero times infinity is zero, as bounds need it (IEEE 1788-2015, 10.5.3).
        corners[np.isnan(corners)] = 0.0
        return Interval(down(corners.min(axis=0)), up(corners.max(axis=0)))

    def square(self) -> Interval:
        """Return the squares, never below zero."""
        low = np.where(
            (self.lower <= 0.0) & (self.upper >= 0.0),
            0.0,
            np.minimum(np.abs(self.lower), np.abs(self.upper)),
        )
        high = np.maximum(np.abs(self.lower), np.abs(self.upper))
        return Interval(np.maximum(down(low * low), 0.0), up(high * high))

    def sqrt(self) -> Interval:
        """Return the roots; negative numbers count as zero."""
        return Interval(
            np.maximum(down(np.sqrt(np.maximum(self.lower, 0.0))), 0.0),
            up(np.sqrt(np.maximum(self.upper, 0.0))),
        )

    def over(self, divisor: Interval) -> Interval:
        """Return the quotients by intervals of non-negative numbers; the whole line for zero."""
        with np.errstate(divide='ignore'):
            inverse = Interval(np.maximum(down(1.0 / divisor.upper), 0.0), up(1.0 / divisor.lower))
        return self * inverse

    def intersect(self, other: Interval) -> Interval:
        """Return the intersections."""
        return Interval(np.maximum(self.lower, other.lower), np.minimum(self.upper, other.upper))

    def hull(self, other: Interval) -> Interval:
        """Return the smallest intervals that contain both."""
        return Interval(np.minimum(self.lower, other.lower), np.maximum(self.upper, other.upper))

    def empty(self) -> bool:
        """Return whether any interval has no member."""
        return bool(np.any(self.lower > self.upper))

    def sign(self) -> int:
        """Return the sign that all members of a single interval share, or 0."""
        if self.lower > 0.0:
            return 1
        return -1 if self.upper < 0.0 else 0


def determinant(rows: Interval) -> Interval:
    """
    Return the determinants of square matrices of order 1, 2 or 3.

    Parameters
    ----------
    rows : Interval, shape (..., q, q)

    Returns
    -------
    Interval, shape (...)

    """
    if rows.lower.shape[-1] == 1:
        return rows[..., 0, 0]
    if rows.lower.shape[-1] == 2:
        products = rows[..., 0, :] * rows[..., 1, ::-1]
        return products[..., 0] - products[..., 1]
    minors = cross(rows[..., 1, :], rows[..., 2, :])
    return dot(rows[..., 0, :], minors)


def dot(a: Interval, b: Interval) -> Interval:
    """Return the inner products along the last axis."""
    return _sum(a * b)


def _sum(terms: Interval) -> Interval:
    """Return the sums along the last axis."""
    total = terms[..., 0]
    for k in range(1, terms.lower.shape[-1]):
        total = total + terms[..., k]
    return total


def cross(a: Interval, b: Interval) -> Interval:
    """Return the vector products along the last axis, of length 3."""
    first, second = [1, 2, 0], [2, 0, 1]
    return a[..., first] * b[..., second] - a[..., second] * b[..., first]


def squared_norm(vectors: Interval) -> Interval:
    """Return the squared lengths along the last axis."""
    return _sum(vectors.square())


def normalized(vectors: Interval) -> Interval:
    """Return the unit vectors along the last axis, within [-1, 1]."""
    units = vectors.over(squared_norm(vectors).sqrt()[..., None])
    one = np.ones_like(units.lower)
    return units.intersect(Interval(-one, one))


def rotate(matrix: Interval, points: Interval) -> Interval:
    """
    Return matrix times each point.

    Parameters
    ----------
    matrix : Interval, shape (q, q)
    points : Interval, shape (n, q)

    Returns
    -------
    Interval, shape (n, q)

    """
    return dot(matrix[None], points[:, None, :])
