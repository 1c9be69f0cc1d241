# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The problem to solve: bounds of distances, known sides and chiralities (Section 3)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import combinations
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.interval.intake import lower_bounds, upper_bounds

Matrix = NDArray[np.float64]


class InvalidProblemError(ValueError):
    """A malformed problem; contradictory measurements are a verdict, not an error."""


class Side(IntEnum):
    """Side of two points with respect to a hyperplane: the sigma of Section 3."""

    SAME = -1
    FREE = 0
    OPPOSITE = 1


@dataclass(frozen=True)
class SideConstraint:
    """
    Two points lie on the same side, or on opposite sides, of the hyperplane through a face.

    A point on the hyperplane itself satisfies both.

    Parameters
    ----------
    face : sequence of int
        The q points that span the hyperplane.
    first, second : int
        The two points compared.
    side : Side
        The sigma of Section 3; ``Side.FREE`` is no constraint.

    """

    face: tuple[int, ...]
    first: int
    second: int
    side: Side


@dataclass(frozen=True)
class Chirality:
    """
    The chirality of q + 1 points: the sign of det[p2 - p1, ..., p(q+1) - p1].

    Points in one hyperplane satisfy both signs.

    Parameters
    ----------
    points : sequence of int
        The q + 1 points, in order.
    sign : int
        +1 or -1.

    """

    points: tuple[int, ...]
    sign: int

    def sign_of(self, points: Sequence[int]) -> int:
        """Return the sign of the same points in another order."""
        places = [self.points.index(point) for point in points]
        inversions = sum(a > b for a, b in combinations(places, 2))
        return -self.sign if inversions % 2 else self.sign


def check_bounds(
    lower: ArrayLike, upper: ArrayLike, names: tuple[str, str] = ('lower', 'upper')
) -> tuple[Matrix, Matrix]:
    """
    Return bounds of squared distances in double precision, rounded outward.

    Parameters
    ----------
    lower, upper : array_like, shape (n, n)
        Real numbers of any kind.
    names : tuple of str, optional
        What they are called in messages.

    Returns
    -------
    tuple of ndarray, shapes (n, n)
        New arrays.

    Raises
    ------
    InvalidProblemError
        If the bounds are not real numbers or not square.

    """
    matrices = []
    for name, values, rounded in zip(
        names, (lower, upper), (lower_bounds, upper_bounds), strict=True
    ):
        try:
            matrix = rounded(values)
        except ValueError as error:
            raise InvalidProblemError(f'{name} {error}') from None
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
            raise InvalidProblemError(
                f'{name} has shape {matrix.shape}, a square matrix is needed'
            )
        matrices.append(matrix)
    return matrices[0], matrices[1]


def _is_whole(value: object) -> bool:
    """Return whether a value is an integer of Python or NumPy; truth values are none."""
    return type(value) is int or (isinstance(value, Integral) and not isinstance(value, bool))


def _checked_points(what: object, points: object, count: int, n_points: int) -> tuple[int, ...]:
    """Return the points of a constraint as integers of Python."""
    if not isinstance(points, Iterable):
        raise InvalidProblemError(f'{what}: {points!r} are no points')
    listed = tuple(points)
    if len(listed) != count:
        raise InvalidProblemError(f'{what}: {count} points are needed in this dimension')
    return _existing(what, listed, n_points)


def _existing(what: object, points: tuple[Any, ...], n_points: int) -> tuple[int, ...]:
    """Return points as integers of Python, different ones that the problem has."""
    for point in points:
        if not _is_whole(point):
            raise InvalidProblemError(f'{what}: point {point!r} is not an integer')
        if not 0 <= int(point) < n_points:
            raise InvalidProblemError(f'{what}: point {point} is not in 0..{n_points - 1}')
    checked = tuple(int(point) for point in points)
    if len(set(checked)) < len(checked):
        raise InvalidProblemError(f'{what}: points {checked} are not all different')
    return checked


class Problem:
    """
    Interval squared distances of n points in q dimensions, with known sides and chiralities.

    Parameters
    ----------
    lower, upper : array_like, shape (n, n)
        Bounds of the squared distances in m^2, symmetric, with zero diagonal. ``upper = inf``
        means that there is no upper bound; an unknown pair is ``[0, inf]``. Numbers that are no
        doubles (large integers, long doubles, fractions, decimals) are rounded outward.
    dimension : int, optional
        The dimension q of the space: 1, 2 or 3.
    sides : sequence of SideConstraint, optional
        Known sides.
    chiralities : sequence of Chirality, optional
        Known chiralities. Without any, a placement and its mirror image are not distinguished.

    Raises
    ------
    InvalidProblemError
        If a bound is no real number (masked, complex, a truth value, text), NaN, negative,
        reversed or asymmetric, a lower bound is infinite, the diagonal is not zero, the dimension
        is not 1, 2 or 3, or a constraint does not name different existing points in the right
        number. Contradictory measurements are no error.

    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        dimension: int = 2,
        sides: Sequence[SideConstraint] = (),
        chiralities: Sequence[Chirality] = (),
    ) -> None:
        if not _is_whole(dimension) or dimension not in (1, 2, 3):
            raise InvalidProblemError(f'dimension is {dimension!r}, it must be 1, 2 or 3')
        for name, given in (('sides', sides), ('chiralities', chiralities)):
            if not isinstance(given, Iterable):
                raise InvalidProblemError(f'{name} is {given!r}, a sequence is needed')
        self.lower, self.upper = check_bounds(lower, upper)
        self.dimension = int(dimension)
        self._check_bounds()
        self.sides = tuple(self._checked_side(side) for side in sides)
        self.chiralities = tuple(self._checked_chirality(known) for known in chiralities)
        self.lower.flags.writeable = False
        self.upper.flags.writeable = False

    @classmethod
    def unchecked(
        cls,
        lower: Matrix,
        upper: Matrix,
        dimension: int,
        sides: Sequence[SideConstraint],
        chiralities: Sequence[Chirality],
    ) -> Problem:
        """Return a problem of new arrays and of constraints that are known to be valid."""
        problem = cls.__new__(cls)
        problem.lower, problem.upper = lower, upper
        problem.dimension = dimension
        problem.sides, problem.chiralities = tuple(sides), tuple(chiralities)
        problem.lower.flags.writeable = False
        problem.upper.flags.writeable = False
        return problem

    @property
    def n_points(self) -> int:
        """The number of points."""
        return len(self.lower)

    def _check_bounds(self) -> None:
        lower, upper = self.lower, self.upper
        if lower.shape != upper.shape:
            raise InvalidProblemError(f'lower is {lower.shape}, upper is {upper.shape}')
        if len(lower) == 0:
            raise InvalidProblemError('there are no points')
        for name, matrix in (('lower', lower), ('upper', upper)):
            for wrong, what in (
                (np.isnan(matrix), 'is NaN'),
                (matrix < 0.0, 'is negative'),
                (matrix != matrix.T, 'differs from its transpose'),
                (np.diag(np.diag(matrix) != 0.0), 'must be 0: it is on the diagonal'),
            ):
                if wrong.any():
                    i, j = np.argwhere(wrong)[0]
                    raise InvalidProblemError(f'{name}[{i},{j}] = {matrix[i, j]} m^2 {what}')
        if np.isinf(lower).any():
            i, j = np.argwhere(np.isinf(lower))[0]
            raise InvalidProblemError(f'lower[{i},{j}] is infinite')
        if (lower > upper).any():
            i, j = np.argwhere(lower > upper)[0]
            raise InvalidProblemError(
                f'lower[{i},{j}] = {lower[i, j]} m^2 exceeds upper[{i},{j}] = {upper[i, j]} m^2'
            )

    def _checked_side(self, constraint: SideConstraint) -> SideConstraint:
        """Return a side constraint with its points as integers of Python."""
        if not isinstance(constraint, SideConstraint):
            raise InvalidProblemError(f'{constraint!r} among the sides is no SideConstraint')
        face = _checked_points(constraint, constraint.face, self.dimension, self.n_points)
        if not _is_whole(constraint.side) or constraint.side not in (-1, 0, 1):
            raise InvalidProblemError(f'{constraint}: the side must be -1, 0 or +1')
        points = (*face, constraint.first, constraint.second)
        *face_points, first, second = _existing(constraint, points, self.n_points)
        return SideConstraint(tuple(face_points), first, second, Side(constraint.side))

    def _checked_chirality(self, chirality: Chirality) -> Chirality:
        """Return a chirality with its points as integers of Python."""
        if not isinstance(chirality, Chirality):
            raise InvalidProblemError(f'{chirality!r} among the chiralities is no Chirality')
        points = _checked_points(chirality, chirality.points, self.dimension + 1, self.n_points)
        if not _is_whole(chirality.sign) or chirality.sign not in (-1, 1):
            raise InvalidProblemError(f'{chirality}: the sign must be -1 or +1')
        return Chirality(points, int(chirality.sign))
