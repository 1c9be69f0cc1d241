# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The answer of the solver: a verdict, hypotheses, and statistics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from operator import add
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Verdict(Enum):
    """The statement that a solve proves."""

    COVERED = 'covered'
    """Every placement lies in some hypothesis; a hypothesis may still hold none."""

    INFEASIBLE = 'infeasible'
    """No placement agrees with the measurements: no box is left."""

    OUT_OF_BUDGET = 'out_of_budget'
    """A limit stopped the search; every placement still lies in some hypothesis."""


@dataclass(frozen=True)
class Statistics:
    """
    The effort of a search; ``processed = empty + split + kept``.

    `empty` counts the boxes proved to hold nothing, the paper's figure of merit (Section 4);
    `pending` boxes were waiting when a limit stopped the search. The sum of two statistics is the
    effort of both searches.
    """

    processed: int = 0
    empty: int = 0
    split: int = 0
    kept: int = 0
    pending: int = 0
    seconds: float = 0.0

    def __add__(self, other: Statistics) -> Statistics:
        return Statistics(*map(add, vars(self).values(), vars(other).values()))


@dataclass(frozen=True)
class Hypothesis:
    """
    One connected component of the cover: a set of placements that may be continuous.

    If the problem has no chirality, it also represents its mirror image.

    Attributes
    ----------
    lower, upper : ndarray, shape (n, n)
        The hull of the component: bounds of every squared distance in m^2.
    boxes : ndarray, shape (k, 2, n, n)
        Its boxes, lower and upper bounds in m^2.
    positions : ndarray, shape (n, q), or None
        The best placement found, in m; None if none could be computed. It is computed at the first
        use of `positions`, `proved` or `flexible`, which may take as long as the call was allowed;
        after the call was cancelled it ends soon.
    proved : bool
        Whether `positions` meets every constraint of the problem and lies in a box of the
        hypothesis, checked with outward rounding. No coordinates in floating point meet exact
        distances: if there are any, a placement that meets every constraint is proved to exist
        within 1e-9 of each coordinate, in units of the longest known distance.
    flexible : bool
        False if it was shown that the placement cannot move continuously without measurement
        errors; True if that was not shown or not examined.

    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    boxes: NDArray[np.float64]
    positions: NDArray[np.float64] | None
    proved: bool
    flexible: bool

    def bounds_of_pair(self, first: int, second: int) -> tuple[float, float]:
        """Return the bounds in m^2 of the squared distance of two points, by their rows."""
        return float(self.lower[first, second]), float(self.upper[first, second])

    def bounds_among(
        self, points: Sequence[int]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """
        Return the bounds of all pairs of some points.

        Parameters
        ----------
        points : sequence of int
            Points by their rows, k of them.

        Returns
        -------
        lower, upper : ndarray, shape (k, k)
            Bounds of the squared distances in m^2. For a large piece this is cheaper than `lower`
            and `upper`.

        """
        rows = np.array(points, dtype=np.int64)
        return self.lower[rows[:, None], rows], self.upper[rows[:, None], rows]


@dataclass(frozen=True)
class Piece:
    """
    Points that the measurements hold rigid, and all their placements.

    If a limit stopped the call before some pieces were known or begun, the rest of the fleet is
    one piece, with one flexible hypothesis and without joints.

    Attributes
    ----------
    points : tuple of int
        The points, ascending.
    hypotheses : tuple of Hypothesis
        Hypotheses that hold every placement; rows and columns are in the order of `points`.
    patches : tuple of Piece
        For a large piece, the overlapping parts in which it was solved, each with its hypotheses.
        They may distinguish placements that `hypotheses` does not.

    """

    points: tuple[int, ...]
    hypotheses: tuple[Hypothesis, ...]
    patches: tuple[Piece, ...] = ()


class JointKind(Enum):
    """The freedom that a joint leaves to its pieces."""

    HINGE = 'hinge'
    """They share q - 1 points and rotate about a point in the plane, or a line in space."""

    REFLECTION = 'reflection'
    """They share q points; either side may be mirrored in the hyperplane through them."""

    LOOSE = 'loose'
    """They share fewer points: one, in space."""


@dataclass(frozen=True)
class Joint:
    """
    Points that pieces share.

    Attributes
    ----------
    pieces : tuple of int
        Two or more pieces, by index.
    points : tuple of int
        The points that all of them share, ascending.
    kind : JointKind
        The freedom that the joint leaves.

    """

    pieces: tuple[int, ...]
    points: tuple[int, ...]
    kind: JointKind


class WholeFleet(Protocol):
    """The combinations of the hypotheses of all pieces, computed on demand."""

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Hypotheses of all points."""
        ...

    @property
    def is_bound(self) -> bool:
        """Whether some of the counted hypotheses may hold no placement."""
        ...

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper bounds of all squared distances in m^2."""
        ...


@dataclass(frozen=True)
class Result:
    """
    The answer to a problem.

    Attributes
    ----------
    verdict : Verdict
        The proved statement.
    statistics : Statistics
        The effort of all searches.
    pieces : tuple of Piece
        The rigid parts. After a contradiction, only a piece that has no hypothesis left.
    joints : tuple of Joint
        The joints between the pieces.
    n_hypotheses : int
        The number of combined hypotheses of the whole fleet, which may be far more than could be
        listed. An open joint counts once, for all rotations about it. Placements of a piece that
        are closer than the resolution count once, and so do the sides of a reflection that may be
        flat, and what the search does not tell apart (docs/rigor.md). `n_hypotheses_is_bound` says
        whether the number may be too large.

    """

    verdict: Verdict
    statistics: Statistics
    pieces: tuple[Piece, ...]
    joints: tuple[Joint, ...]
    n_hypotheses: int
    whole_fleet: WholeFleet = field(repr=False, compare=False)

    @property
    def n_hypotheses_is_bound(self) -> bool:
        """
        Whether fewer than `n_hypotheses` hypotheses may hold a placement.

        False is a proof, computed at first use: each counted hypothesis has a proved placement, or
        one proved placement of the whole fleet can be mirrored at every joint, because only
        distances within pieces are known. It is true if a limit stopped the call, if some
        hypothesis is not proved, or if loops or constraints between pieces leave more combinations
        than `SolverOptions.max_hypotheses`.
        """
        return self.whole_fleet.is_bound

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """
        The hypotheses of the whole fleet, built at first use.

        If there are several pieces, these are at most `SolverOptions.max_hypotheses` combinations,
        without those that a contraction of the whole fleet proves to be empty. If all examined
        choices are empty and others remain, one hypothesis without a placement holds the rest.
        """
        return self.whole_fleet.hypotheses

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lower bounds of all squared distances over all placements in m^2, shape (n, n)."""
        return self.whole_fleet.bounds[0]

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper bounds of all squared distances over all placements in m^2, shape (n, n)."""
        return self.whole_fleet.bounds[1]
