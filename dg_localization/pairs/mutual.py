# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Mutual covers: in which directions two bodies have each other, and how far they are apart.

Ranges and odometry alone tell the distance well at all times, and the directions slowly. A mutual
cover holds every relative pose that the motions of both within the bounds of their odometries
reach and that agrees with all ranges on the way (a set-membership filter). It has cells of both
directions, in the odometry frame of each body: turns that odometry knows move nothing. In each
cell the distance lies between two planes, which move with the cell (`mutual_kernels`): what is
known of the distance to a part of its bounds is kept from knot to knot.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Self

import numpy as np

from dg_localization.interval.angles import angle_down, angle_up
from dg_localization.interval.arrays import down, up
from dg_localization.interval.environment import default_environment
from dg_localization.interval.rounding import rounding_error
from dg_localization.pairs.cover import arc_around
from dg_localization.pairs.mutual_grid import OVERLAP_RAD, SUMS, gather_directions
from dg_localization.pairs.mutual_kernels import (
    ABOVE,
    BALL,
    BELOW,
    CELL,
    FAR,
    FIRST,
    HIGH_A,
    HIGH_B,
    LOW_A,
    LOW_B,
    NEAR,
    OPERATIONS,
    REF_A,
    REF_B,
    SECOND,
    WAY,
    WAY_A,
    WAY_B,
)
from dg_localization.pairs.mutual_steps import NO_ROOM, carry_cells
from dg_localization.pairs.readings import PastPoses, center_and_half, norm_up

COARSEST, FINEST = 64, 256
"""Cells of the full turn: as few as there are at first, and as many as may be."""

LEAST_ACROSS, WIDEST = 8, 12.0
"""The grid is made coarser down to so few, where cells are wider than so many of its own."""

MANY_CELLS = 2048
"""Cells are halved while there are no more than these by then."""

MOST_CELLS = 8192
"""Where there would be more, they are larger; at first there are half as many."""

ROOM = 4
"""So many times as many cells may come of some while they are carried."""

FARTHEST_M = 1e9
WIDEST_RAD = 1.0
"""A way that is longer, or a turn that errs by more, says nothing."""


@dataclass(frozen=True)
class Ways:
    """
    Where both bodies are at some times, seen from one time, in their odometry frames.

    Parameters
    ----------
    a_m, b_m : numpy.ndarray, shape (m, 2)
        The way of A and of B from there.
    ball_m : numpy.ndarray, shape (m,)
        Both together are no farther off than this.
    turn_a_rad, turn_b_rad : numpy.ndarray, shape (m,)
        The greatest errors of their yaws.

    """

    a_m: np.ndarray
    b_m: np.ndarray
    ball_m: np.ndarray
    turn_a_rad: np.ndarray
    turn_b_rad: np.ndarray

    @classmethod
    def of(
        cls,
        poses_a: PastPoses,
        poses_b: PastPoses,
        yaw_a_rad: float,
        yaw_b_rad: float,
        ball_m: float = 0.0,
    ) -> Self:
        """
        Return the ways to some poses.

        Parameters
        ----------
        poses_a, poses_b : PastPoses
            Poses of each body, seen from one of its poses; in the plane.
        yaw_a_rad, yaw_b_rad : float
            The yaws of these, in the odometry frames.
        ball_m : float
            By how much both may be off, in any direction, besides.

        """
        (a_m, off_a_m), (b_m, off_b_m) = _balls(poses_a, yaw_a_rad), _balls(poses_b, yaw_b_rad)
        return cls(
            a_m,
            b_m,
            up(up(off_a_m + off_b_m) + ball_m),
            angle_up(center_and_half(poses_a.yaw_rad)[1]),
            angle_up(center_and_half(poses_b.yaw_rad)[1]),
        )

    @property
    def bounded(self) -> bool:
        """Whether they and the turns are known well enough to say anything."""
        turns_rad = np.concatenate([self.turn_a_rad, self.turn_b_rad])
        return self.placed and bool(np.all(turns_rad < WIDEST_RAD))

    @property
    def placed(self) -> bool:
        """Whether they are known well enough, whatever the turns are."""
        # The middle of an unbounded interval is not a number, and smaller than nothing.
        numbers_m = np.concatenate([self.a_m.ravel(), self.b_m.ravel(), self.ball_m])
        return bool(np.all(np.abs(numbers_m) < FARTHEST_M))

    def rows(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return them with two more columns as the kernels take them, shape (m, WAY)."""
        rows = np.empty((len(self.ball_m), WAY))
        rows[:, WAY_A : WAY_A + 2], rows[:, WAY_B : WAY_B + 2] = self.a_m, self.b_m
        rows[:, BALL], rows[:, FIRST], rows[:, SECOND] = self.ball_m, first, second
        return rows


@dataclass(frozen=True)
class Ranges:
    """
    Distances of two bodies on their way.

    Parameters
    ----------
    ways : Ways
        Seen from where the way ends. The turns do not count.
    lower_m, upper_m : numpy.ndarray, shape (m,)
        Bounds of the distances.

    """

    ways: Ways
    lower_m: np.ndarray
    upper_m: np.ndarray

    @property
    def at_end_m(self) -> tuple[float, float]:
        """Bounds of the distance where the way ends."""
        moved_m = up(norm_up(self.ways.a_m) + norm_up(self.ways.b_m))
        moved_m = up(moved_m + self.ways.ball_m)
        lower_m, upper_m = down(self.lower_m - moved_m), up(self.upper_m + moved_m)
        return max(0.0, float(lower_m.max(initial=0.0))), float(upper_m.min(initial=math.inf))


@dataclass(frozen=True)
class MutualCover:
    """
    Cells of the directions in which two bodies have each other, in the plane.

    Parameters
    ----------
    cells : numpy.ndarray, shape (n, CELL)
    across : int
        Cells of the full turn.

    """

    cells: np.ndarray
    across: int

    @classmethod
    def started(cls, lower_m: float, upper_m: float, across: int = COARSEST) -> Self:
        """
        Return a cover of all directions.

        Parameters
        ----------
        lower_m, upper_m : float
            Bounds of the distance, finite.
        across : int, optional
            Cells of the full turn.

        """
        side = 2.0 * math.pi / across
        cells = np.zeros((across * across, CELL))
        middles = (np.arange(across) + 0.5) * side
        cells[:, REF_A], cells[:, REF_B] = np.repeat(middles, across), np.tile(middles, across)
        cells[:, [LOW_A, LOW_B]] = -0.5 * side - OVERLAP_RAD
        cells[:, [HIGH_A, HIGH_B]] = 0.5 * side + OVERLAP_RAD
        cells[:, [NEAR, BELOW]] = max(0.0, lower_m)
        cells[:, [FAR, ABOVE]] = upper_m
        return cls(cells, across)

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def empty(self) -> bool:
        """Whether no relative pose is left."""
        return len(self.cells) == 0

    @property
    def distance_m(self) -> tuple[float, float]:
        """Bounds of the distance; of a cover that is not empty."""
        return float(self.cells[:, NEAR].min()), float(self.cells[:, FAR].max())

    @property
    def arcs_rad(self) -> np.ndarray:
        """The arcs of the direction of B from A and of A from B, shape (2, 2); not if empty."""
        return np.array(
            [
                arc_around(
                    angle_down(self.cells[:, middle] + self.cells[:, low]),
                    angle_up(self.cells[:, middle] + self.cells[:, high]),
                )
                for middle, low, high in ((REF_A, LOW_A, HIGH_A), (REF_B, LOW_B, HIGH_B))
            ]
        )

    @default_environment()
    def carried(self, way: Ways, ranges: Ranges | None = None) -> Self | None:
        """
        Carry the cover on.

        Parameters
        ----------
        way : Ways
            One: where both are, seen from where they were.
        ranges : Ranges, optional
            Measured on the way.

        Returns
        -------
        MutualCover or None
            None where too little is known of the way, or where the bodies come too near to each
            other: there all directions may be.

        """
        if not way.bounded:
            return None
        near_m, far_m, rows = 0.0, math.inf, np.empty((0, WAY))
        if ranges is not None and ranges.ways.placed:
            near_m, far_m = ranges.at_end_m
            rows = ranges.ways.rows(ranges.lower_m, ranges.upper_m)
        carried = np.empty((ROOM * len(self.cells) + COARSEST, CELL))
        row = way.rows(way.turn_a_rad, way.turn_b_rad)[0]
        count = carry_cells(self.cells, row, rows, near_m, far_m, carried)
        return None if count == NO_ROOM else type(self)(carried[:count], self.across)

    @property
    def _mean_width(self) -> float:
        """How wide cells are in the mean, in turns."""
        sides = self.cells[:, [HIGH_A, HIGH_B]] - self.cells[:, [LOW_A, LOW_B]]
        return float(sides.mean()) / (2.0 * math.pi) if sides.size else 0.0

    @default_environment()
    def gathered(self) -> Self:
        """Return the cover in cells of a grid, as fine as there are few and they are small."""
        across, mean = self.across, self._mean_width
        while (
            across < FINEST and 4 * len(self.cells) <= MANY_CELLS and 2.0 * mean * across < WIDEST
        ):
            across *= 2
        while across > LEAST_ACROSS and mean * across > WIDEST:
            across //= 2
        while True:
            cells = np.empty((min(across * across, MOST_CELLS), CELL))
            slots, sums = np.full(across * across, -1), np.empty((len(cells), SUMS))
            count = gather_directions(self.cells, across, slots, sums, cells)
            if count != NO_ROOM:
                return type(self)(cells[:count].copy(), across)
            across //= 2


def _balls(poses: PastPoses, yaw_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where poses are, turned by a yaw, and how far off they may be: (m, 2) and (m,)."""
    middle, half = center_and_half(poses.position_m)
    x, y, c, s = middle[:, 0], middle[:, 1], math.cos(yaw_rad), math.sin(yaw_rad)
    rounded = rounding_error(float(np.abs(middle).max(initial=0.0)), OPERATIONS)
    return np.stack([c * x - s * y, s * x + c * y], axis=-1), up(norm_up(half[:, :2]) + rounded)
