"""The problem to solve: bounds of distances, known sides and chiralities (Section 3)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray


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


def _square_matrix(name: str, values: ArrayLike) -> NDArray[np.float64]:
    matrix = np.array(values, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise InvalidProblemError(f'{name} has shape {matrix.shape}, a square matrix is needed')
    return matrix


def _check_points(what: str, points: Iterable[int], n_points: int) -> None:
    points = tuple(points)
    for point in points:
        if not 0 <= point < n_points:
            raise InvalidProblemError(f'{what}: point {point} is not in 0..{n_points - 1}')
    if len(set(points)) < len(points):
        raise InvalidProblemError(f'{what}: points {points} are not all different')


class Problem:
    """
    Interval squared distances of n points in q dimensions, with known sides and chiralities.

    Parameters
    ----------
    lower, upper : array_like, shape (n, n)
        Bounds of the squared distances in m^2, symmetric, with zero diagonal. ``upper = inf``
        means that there is no upper bound; an unknown pair is ``[0, inf]``.
    dimension : int, optional
        The dimension q of the space: 1, 2 or 3.
    sides : sequence of SideConstraint, optional
        Known sides.
    chiralities : sequence of Chirality, optional
        Known chiralities. Without any, a placement and its mirror image are not distinguished.

    Raises
    ------
    InvalidProblemError
        If a bound is NaN, negative, reversed or asymmetric, a lower bound is infinite, the
        diagonal is not zero, the dimension is not 1, 2 or 3, or a constraint does not name
        different existing points in the right number. Contradictory measurements are no error.

    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        dimension: int = 2,
        sides: Sequence[SideConstraint] = (),
        chiralities: Sequence[Chirality] = (),
    ) -> None:
        if dimension not in (1, 2, 3):
            raise InvalidProblemError(f'dimension is {dimension!r}, it must be 1, 2 or 3')
        self.lower = _square_matrix('lower', lower)
        self.upper = _square_matrix('upper', upper)
        self.dimension = dimension
        self.sides = tuple(sides)
        self.chiralities = tuple(chiralities)
        self._check_bounds()
        self._check_constraints()
        self.lower.flags.writeable = False
        self.upper.flags.writeable = False

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

    def _check_constraints(self) -> None:
        for constraint in self.sides:
            if len(constraint.face) != self.dimension:
                raise InvalidProblemError(
                    f'{constraint}: a face has {self.dimension} points in this dimension'
                )
            if constraint.side not in tuple(Side):
                raise InvalidProblemError(f'{constraint}: the side must be -1, 0 or +1')
            apexes = (constraint.first, constraint.second)
            _check_points(str(constraint), (*constraint.face, *apexes), self.n_points)
        for chirality in self.chiralities:
            if len(chirality.points) != self.dimension + 1:
                raise InvalidProblemError(
                    f'{chirality}: {self.dimension + 1} points are needed in this dimension'
                )
            if chirality.sign not in (-1, 1):
                raise InvalidProblemError(f'{chirality}: the sign must be -1 or +1')
            _check_points(str(chirality), chirality.points, self.n_points)
