# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Counted covers: where a body is, by how many readings it may have broken on its way there.

A cover is carried from one time to the next by odometry and cut by the readings in between (a
set-membership filter). A pose that breaks a reading is counted, and lost when it breaks more than
are tolerated: level j of a cell holds every pose that a motion within the bounds of the odometry
reaches and that breaks j readings at most (Jaulin, Robust set-membership state estimation,
Automatica 45(1), 2009, with the count kept along the way).

The cells stand still in the odometry frame. What odometry is sure of moves nothing from one cell
to another; only its errors make the cover wider.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math
from typing import Self

import numpy as np

from dg_localization.interval.angles import angle_down, angle_up
from dg_localization.interval.environment import default_environment
from dg_localization.pairs.counted_kernels import ALONG_X, cut_cells, gather_cells, move_cells
from dg_localization.pairs.cover import Cover, arc_around
from dg_localization.pairs.half_spaces import HIGH, LOW, YAW, Y
from dg_localization.pairs.readings import PairReadings, PastPoses, center_and_half
from dg_localization.pairs.search import PairOptions, cover_poses
from dg_localization.pairs.turns import HALF_TURN_UP, TURN

MOST_PLACES = 500_000
"""Places of a grid, most of which are empty."""

COARSER = 1.15
"""Cells that are too many grow by this."""

LEAST_SIDE = 1e-6
"""Of a cell, in m or rad."""

FARTHEST_M = 1e9
"""A step of so much says nothing."""


@dataclass(frozen=True)
class CellOptions:
    """
    How finely a counted cover is resolved.

    Parameters
    ----------
    across, slices : int
        Cells along the sides of the cover, and of its yaws. Fine yaws are worth more: a step goes
        where the yaw points.
    max_cells : int
        Where there would be more, they are larger.

    """

    across: int = 14
    slices: int = 40
    max_cells: int = 3000


@dataclass(frozen=True)
class Stated:
    """The pose that odometry states, in its own frame, in which cells stand still."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0


SOMEWHERE = Stated()


@dataclass(frozen=True)
class CountedCover:
    """
    Cells of poses of B in the frame of A, in the plane.

    Parameters
    ----------
    cells : numpy.ndarray, shape (n, k + 1, 2, 4)
        Level j of a cell bounds the poses in it that broke j readings at most: x, y, z in m and
        yaw in rad. It is part of level j + 1, and empty where its lower bounds are infinite.
    coarser : float, optional
        How much larger than asked the cells were last, so that they are not too many.

    """

    cells: np.ndarray
    coarser: float = 1.0

    @classmethod
    @default_environment()
    def started(
        cls,
        readings: PairReadings,
        options: PairOptions,
        *,
        stopped: Callable[[], bool] = lambda: False,
    ) -> Self | None:
        """
        Return where B is by some readings alone.

        Parameters
        ----------
        readings : PairReadings
        options : PairOptions
        stopped : callable, optional
            As for `cover_poses`.

        Returns
        -------
        CountedCover or None
            None where they do not bound the position of B.

        """
        levels = [cover_poses(readings, options, stopped=stopped)]
        if not levels[0].bounded:
            return None
        for most in range(options.max_outliers - 1, -1, -1):
            fewer = replace(options, max_outliers=most)
            levels.append(cover_poses(readings, fewer, within=levels[-1], stopped=stopped))
        cells = np.empty((sum(map(len, levels)), len(levels), 2, 4))
        cells[:, :, LOW], cells[:, :, HIGH] = math.inf, -math.inf
        first = 0
        for level, cover in enumerate(reversed(levels)):
            cells[first : first + len(cover), level:] = cover.boxes[:, None]
            first += len(cover)
        return cls(cells)

    @property
    def empty(self) -> bool:
        """Whether no pose is left, which proves that a measurement or a bound is wrong."""
        return len(self.cells) == 0

    @property
    def cover(self) -> Cover:
        """The poses that broke as many readings as are tolerated at most."""
        return Cover(self.cells[:, -1])

    @property
    def uncounted(self) -> Self:
        """The same poses, without what they broke."""
        return type(self)(self.cells[:, -1:])

    def moved(
        self,
        step: PastPoses,
        options: CellOptions,
        stated: Stated = SOMEWHERE,
        ball_m: float = 0.0,
    ) -> Self | None:
        """
        Return the cover after B has moved, in new cells.

        Parameters are those of `carried` and of `gathered`.
        """
        carried = self.carried(step, ball_m)
        return None if carried is None else carried.gathered(options, stated)

    @default_environment()
    def carried(self, step: PastPoses, ball_m: float = 0.0) -> Self | None:
        """
        Return the cover after B has moved, in cells that overlap.

        Parameters
        ----------
        step : PastPoses
            One pose: where B is now, seen from where it was.
        ball_m : float, optional
            How far from that it may be besides, in any direction.

        Returns
        -------
        CountedCover or None
            None where the step is not bounded.

        """
        position_m, half_m = center_and_half(step.position_m)
        turn_rad, half_rad = center_and_half(step.yaw_rad)
        added = np.array([[*position_m[0], turn_rad[0]], [*half_m[0], half_rad[0]]])
        if not (np.all(np.abs(added) < FARTHEST_M) and ball_m < FARTHEST_M):
            return None
        moved = np.empty_like(self.cells)
        move_cells(self.cells, added, ball_m, moved)
        return type(self)(moved, self.coarser)

    @default_environment()
    def gathered(self, options: CellOptions, stated: Stated = SOMEWHERE) -> Self:
        """
        Return the same poses in new cells, which do not overlap.

        Parameters
        ----------
        options : CellOptions
        stated : Stated, optional
            Where odometry states B to be now.

        """
        if self.empty:
            return self
        cells = self._cells_within_a_turn()
        low, high = cells[:, -1, LOW].min(axis=0), cells[:, -1, HIGH].max(axis=0)
        room = np.empty((options.max_cells, *cells.shape[1:]))
        extent = np.max((high - low)[: Y + 1]), high[YAW] - low[YAW]
        sides = np.maximum(np.array(extent) / [options.across, options.slices], LEAST_SIDE)
        # Their number goes with the third power of their sides.
        coarser = max(1.0, self.coarser * (1.1 * len(cells) / options.max_cells) ** (1.0 / 3.0))
        while True:
            grid, starts = _grid(low, high, coarser * sides, stated)
            places = float(np.prod(grid[ALONG_X:]))
            if places <= MOST_PLACES:
                slots = np.full(int(places), -1, np.int32)
                count = gather_cells(cells, grid, starts, slots, room)
                if count <= options.max_cells:
                    return type(self)(room[:count].copy(), coarser)
            coarser *= COARSER

    @default_environment()
    def cut(self, readings: PairReadings) -> Self:
        """Return what readings leave, each of which counts once."""
        kept = np.empty_like(self.cells)
        count = cut_cells(self.cells, readings.table, kept)
        return type(self)(kept[:count].copy(), self.coarser)

    def _cells_within_a_turn(self) -> np.ndarray:
        """Return the cells, their yaws in one piece where they would spread over turns."""
        yaws = self.cells[:, -1, :, YAW]
        if np.ptp(yaws) < 1.5 * TURN:
            return self.cells
        cells = self.cells.copy()
        low, high = cells[:, :, LOW, YAW], cells[:, :, HIGH, YAW]
        round_about = high - low >= TURN
        low[round_about], high[round_about] = -HALF_TURN_UP, HALF_TURN_UP
        turns = np.floor((low[:, -1] - arc_around(low[:, -1], high[:, -1])[0]) / TURN)
        shift = np.broadcast_to(turns[:, None] * TURN, low.shape)
        there = low <= high
        low[there] = angle_down(low[there] - shift[there])
        high[there] = angle_up(high[there] - shift[there])
        return cells


def _grid(
    low: np.ndarray, high: np.ndarray, sides: np.ndarray, stated: Stated
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return a grid between bounds as the kernel wants it, and where each slice of yaws begins.

    In a slice the odometry frame is turned by the middle of the slice.
    """
    side_m, side_rad = sides
    first = math.floor((low[YAW] - stated.yaw_rad) / side_rad)
    slices = max(1, math.ceil((high[YAW] - stated.yaw_rad) / side_rad) - first)
    if slices > MOST_PLACES:
        return np.array([0.0, side_m, side_rad, 1.0, 1.0, slices]), np.empty((0, 2))
    turns = (first + 0.5 + np.arange(slices)) * side_rad
    c, s = np.cos(turns), np.sin(turns)
    offsets = np.stack([c * stated.x_m - s * stated.y_m, s * stated.x_m + c * stated.y_m], -1)
    starts = offsets + np.floor((low[: Y + 1] - offsets) / side_m) * side_m
    counts = np.ceil((high - low)[: Y + 1] / side_m) + 1.0
    grid = np.array([stated.yaw_rad + first * side_rad, side_m, side_rad, *counts, slices])
    return grid, starts
