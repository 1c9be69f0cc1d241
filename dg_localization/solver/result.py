# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the solver answers: a verdict, the hypotheses, and how hard it was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from operator import add
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Verdict(Enum):
    """What a solve proves."""

    COVERED = 'covered'
    """Every placement lies in some hypothesis; a hypothesis may still hold none."""

    INFEASIBLE = 'infeasible'
    """No placement agrees with the measurements: no box is left."""

    OUT_OF_BUDGET = 'out_of_budget'
    """A limit stopped the search; every placement lies in some hypothesis all the same."""


@dataclass(frozen=True)
class Statistics:
    """
    The effort of a search; ``processed = empty + split + kept``.

    `empty` counts the boxes proved to hold nothing, the paper's figure of merit (Section 4);
    `pending` boxes were waiting when a limit stopped the search. The sum of two is the effort of
    both searches together.
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

    Without a chirality in the problem it stands for its mirror image too.

    Attributes
    ----------
    lower, upper : ndarray, shape (n, n)
        The hull of the component: bounds of every squared distance in m^2.
    boxes : ndarray, shape (k, 2, n, n)
        Its boxes, lower and upper bounds in m^2.
    positions : ndarray, shape (n, q), or None
        One placement in m, as good as could be found; None when none could be computed. It is
        sought when it, `proved` or `flexible` is first asked for, which may take as long as the
        call could, and not long after the call was cancelled.
    proved : bool
        Whether `positions` meets every constraint of the problem and lies in a box of the
        hypothesis, checked with outward rounding. Exact distances are met by no coordinates in
        floating point: where there are some, a placement that meets every constraint is proved to
        lie within 1e-9 of each coordinate, in units of the longest known distance.
    flexible : bool
        Whether the placements are a continuum even without measurement errors; also where there
        was no time to examine that.

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

    Where a limit stopped the call before pieces were known or begun, what is left of the fleet is
    one piece, with one flexible hypothesis and without joints.

    Attributes
    ----------
    points : tuple of int
        The points, ascending.
    hypotheses : tuple of Hypothesis
        What holds every placement of these points; rows and columns are in the order of `points`.
    patches : tuple of Piece
        Where the piece is large, the overlapping parts that it was solved in, each with its
        hypotheses. Where `hypotheses` does not tell these apart, this does.

    """

    points: tuple[int, ...]
    hypotheses: tuple[Hypothesis, ...]
    patches: tuple[Piece, ...] = ()


class JointKind(Enum):
    """What two pieces can still do to each other."""

    HINGE = 'hinge'
    """They share q - 1 points and turn: about a point in the plane, about a line in space."""

    REFLECTION = 'reflection'
    """They share q points; either side may be mirrored in the hyperplane through them."""

    LOOSE = 'loose'
    """They share fewer points: one, in space."""


@dataclass(frozen=True)
class Joint:
    """
    What pieces share.

    Attributes
    ----------
    pieces : tuple of int
        Two or more pieces, by their numbers in the order of the pieces.
    points : tuple of int
        The points that all of them share, ascending.
    kind : JointKind
        What the joint leaves open.

    """

    pieces: tuple[int, ...]
    points: tuple[int, ...]
    kind: JointKind


class WholeFleet(Protocol):
    """What the hypotheses of the pieces make together, computed when it is asked for."""

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Hypotheses of all points."""
        ...

    @property
    def is_bound(self) -> bool:
        """Whether some of the hypotheses that are counted may hold no placement."""
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
        What is proved.
    statistics : Statistics
        The effort of all searches.
    pieces : tuple of Piece
        The rigid parts. Where a contradiction was found, only a piece that it leaves without a
        hypothesis.
    joints : tuple of Joint
        What the pieces share.
    n_hypotheses : int
        How many hypotheses of the whole fleet the pieces make together, which may be far more than
        could be listed. An open joint counts once, however the pieces turn about it. The number
        is never too small; `n_hypotheses_is_bound` tells whether it may be too large.

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
        Whether there may be fewer hypotheses that hold a placement than `n_hypotheses`.

        False is a proof, looked for when first asked: each hypothesis counted has a proved
        placement, or one proved placement of the whole fleet can be mirrored at every joint,
        because nothing but the distances within pieces is known. True where a limit stopped the
        call, where some hypothesis is not proved, and where loops or constraints between pieces
        leave more combinations than `SolverOptions.max_hypotheses`.
        """
        return self.whole_fleet.is_bound

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """
        The hypotheses of the whole fleet, built when first asked for.

        Where there are several pieces, at most `SolverOptions.max_hypotheses` combinations of
        theirs; what a contraction of the whole fleet proves to be empty is left out. Where the
        first thousand choices are all empty and others are left, one hypothesis without a
        placement holds all of these.
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
