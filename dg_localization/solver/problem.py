# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The problem to solve: bounds of distances, known sides and chiralities (Section 3)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dg_localization.solver.checks import (
    InvalidProblemError,
    Matrix,
    check_bounds,
    check_matrices,
    checked_pairs,
    checked_points,
    different_points,
    is_whole,
)
from dg_localization.solver.pair_bounds import PairBounds


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


Constraint = SideConstraint | Chirality


def points_of(constraint: Constraint) -> tuple[int, ...]:
    """Return the points that a constraint names."""
    if isinstance(constraint, Chirality):
        return tuple(constraint.points)
    return (*constraint.face, constraint.first, constraint.second)


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
        self._take_constraints_of(dimension, sides, chiralities)
        self._matrices: tuple[Matrix, Matrix] | None = check_bounds(lower, upper)
        self._pairs: PairBounds | None = None
        check_matrices(*self._matrices)
        self._protect()
        self._check_constraints()

    @classmethod
    def from_pairs(
        cls,
        n_points: int,
        i: ArrayLike,
        j: ArrayLike,
        lower: ArrayLike,
        upper: ArrayLike,
        dimension: int = 2,
        sides: Sequence[SideConstraint] = (),
        chiralities: Sequence[Chirality] = (),
    ) -> Problem:
        """
        Return a problem given by its measured pairs, without any n x n array.

        Parameters
        ----------
        n_points : int
            The number of points n.
        i, j : array_like of int, shape (m,)
            The points of each pair, in either order; each pair once.
        lower, upper : array_like, shape (m,)
            Bounds of their squared distances in m^2, as for `Problem`. A pair that is not listed
            is unknown, ``[0, inf]``.
        dimension, sides, chiralities : optional
            As for `Problem`.

        Returns
        -------
        Problem
            The problem. Its `lower` and `upper` are made at first use.

        Raises
        ------
        InvalidProblemError
            If an index is no integer or no point, if a pair joins a point to itself or is given
            twice, and for the errors of `Problem`. The message has the place in the lists, the
            pair and the value.

        """
        if not is_whole(n_points) or n_points < 1:
            raise InvalidProblemError(f'n_points is {n_points!r}, a positive integer is needed')
        problem = cls.__new__(cls)
        problem._take_constraints_of(dimension, sides, chiralities)
        problem._matrices = None
        problem._pairs = checked_pairs(int(n_points), i, j, lower, upper)
        problem._check_constraints()
        return problem

    @classmethod
    def unchecked(
        cls,
        bounds: tuple[Matrix, Matrix] | PairBounds,
        dimension: int,
        sides: Sequence[SideConstraint],
        chiralities: Sequence[Chirality],
    ) -> Problem:
        """Return a problem of new bounds and constraints that are valid by construction."""
        problem = cls.__new__(cls)
        problem._matrices = problem._pairs = None
        if isinstance(bounds, PairBounds):
            problem._pairs = bounds
        else:
            problem._matrices = bounds
            problem._protect()
        problem.dimension = dimension
        problem.sides, problem.chiralities = tuple(sides), tuple(chiralities)
        return problem

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Unpickled arrays are writable, and kernels would be compiled anew for them.
        self.__dict__.update(state)
        self._protect()

    def _protect(self) -> None:
        """Make the matrices read-only."""
        for matrix in self._matrices or ():
            matrix.flags.writeable = False

    def _take_constraints_of(
        self,
        dimension: int,
        sides: Sequence[SideConstraint],
        chiralities: Sequence[Chirality],
    ) -> None:
        """Keep the dimension and the constraints, which are checked when the points are known."""
        if not is_whole(dimension) or dimension not in (1, 2, 3):
            raise InvalidProblemError(f'dimension is {dimension!r}, it must be 1, 2 or 3')
        for name, given in (('sides', sides), ('chiralities', chiralities)):
            if not isinstance(given, Iterable):
                raise InvalidProblemError(f'{name} is {given!r}, a sequence is needed')
        self.dimension = int(dimension)
        self.sides, self.chiralities = tuple(sides), tuple(chiralities)

    def _check_constraints(self) -> None:
        self.sides = tuple(self._checked_side(side) for side in self.sides)
        self.chiralities = tuple(self._checked_chirality(known) for known in self.chiralities)

    @property
    def lower(self) -> Matrix:
        """Lower bounds of all squared distances in m^2, shape (n, n), read only."""
        return self._as_matrices()[0]

    @property
    def upper(self) -> Matrix:
        """Upper bounds of all squared distances in m^2, shape (n, n), read only."""
        return self._as_matrices()[1]

    @property
    def is_sparse(self) -> bool:
        """Whether the bounds are stored by pair, and no matrix was made."""
        return self._matrices is None

    def sparse(self) -> Problem:
        """Return the same problem with its bounds stored by pair."""
        if self.is_sparse:
            return self
        return Problem.unchecked(self.pairs, self.dimension, self.sides, self.chiralities)

    def bounds_among(self, points: Sequence[int]) -> tuple[Matrix, Matrix]:
        """Return the bounds in m^2 of all pairs of k points, as new arrays of shape (k, k)."""
        if self._matrices is None:
            return self.pairs.among(points)
        index = np.array(points)
        rows = index[:, None]
        return self._matrices[0][rows, index], self._matrices[1][rows, index]

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """The sides and the chiralities."""
        return (*self.sides, *self.chiralities)

    @cached_property
    def _constraints_at(self) -> dict[int, list[tuple[int, Constraint]]]:
        """The numbered sides and chiralities by the points that they name."""
        at: dict[int, list[tuple[int, Constraint]]] = {}
        for numbered in enumerate(self.constraints):
            for point in points_of(numbered[1]):
                at.setdefault(point, []).append(numbered)
        return at

    def constraints_among(self, points: Iterable[int]) -> list[Constraint]:
        """Return the sides and chiralities all of whose points are among some, in their order."""
        inside = set(points)
        found = dict(pair for p in inside for pair in self._constraints_at.get(p, ()))
        return [found[x] for x in sorted(found) if inside.issuperset(points_of(found[x]))]

    @property
    def pairs(self) -> PairBounds:
        """The bounds of the known pairs."""
        if self._pairs is None:
            self._pairs = PairBounds.from_matrices(*self._as_matrices())
        return self._pairs

    def _as_matrices(self) -> tuple[Matrix, Matrix]:
        if self._matrices is None:
            self._matrices = self.pairs.among(range(self.n_points))
            self._protect()
        return self._matrices

    @property
    def n_points(self) -> int:
        """The number of points."""
        return len(self._matrices[0]) if self._matrices else self.pairs.n_points

    def _checked_side(self, constraint: SideConstraint) -> SideConstraint:
        """Return a side constraint with its points as integers of Python."""
        if not isinstance(constraint, SideConstraint):
            raise InvalidProblemError(f'{constraint!r} among the sides is no SideConstraint')
        face = checked_points(constraint, constraint.face, self.dimension, self.n_points)
        if not is_whole(constraint.side) or constraint.side not in (-1, 0, 1):
            raise InvalidProblemError(f'{constraint}: the side must be -1, 0 or +1')
        points = (*face, constraint.first, constraint.second)
        *face_points, first, second = different_points(constraint, points, self.n_points)
        return SideConstraint(tuple(face_points), first, second, Side(constraint.side))

    def _checked_chirality(self, chirality: Chirality) -> Chirality:
        """Return a chirality with its points as integers of Python."""
        if not isinstance(chirality, Chirality):
            raise InvalidProblemError(f'{chirality!r} among the chiralities is no Chirality')
        points = checked_points(chirality, chirality.points, self.dimension + 1, self.n_points)
        if not is_whole(chirality.sign) or chirality.sign not in (-1, 1):
            raise InvalidProblemError(f'{chirality}: the sign must be -1 or +1')
        return Chirality(points, int(chirality.sign))
