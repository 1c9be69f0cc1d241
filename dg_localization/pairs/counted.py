# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Counted covers: where a body is, by how many readings it may have broken on its way there.

A cover is carried from one time to the next by odometry and cut by the readings in between (a
set-membership filter). A pose that breaks a reading is counted, and lost when it breaks more than
are tolerated: level j holds every pose that a motion within the bounds of the odometry reaches
and that breaks j readings at most (Jaulin, Robust set-membership state estimation,
Automatica 45(1), 2009, with the count kept along the way).

Yaws are sliced thinly, and each slice has a convex polygon of places. Where the yaw is known, a
range and a ray leave all but a convex set, a step is a translation, and its errors are a ball.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math
from typing import Self

import numpy as np

from dg_localization.interval.angles import LARGEST_ANGLE_RAD, angle_down, angle_up
from dg_localization.interval.arrays import up
from dg_localization.interval.environment import default_environment
from dg_localization.pairs.cover import Cover, arc_around
from dg_localization.pairs.half_spaces import HIGH, LOW, YAW, X, Y, Z
from dg_localization.pairs.polygon_kernels import (
    DIRECTIONS,
    SIDES,
    cut_slices,
    join_slices,
    move_slices,
)
from dg_localization.pairs.readings import PairReadings, PastPoses, center_and_half
from dg_localization.pairs.search import PairOptions, cover_poses
from dg_localization.pairs.turns import TURN
from dg_localization.pairs.yaw_slices import MOST_PER_TURN, YawSlices

FEW_SLICES, MOST_SLICES = 48, 128
"""Fewer slices are halved, more are joined. Twice as many make the cover of a robot 2 % narrower,
in a quarter more time."""

LEVEL_M = 1e-100
"""Smaller heights are zeros that were rounded outward."""

FARTHEST_M = 1e9
"""A step of so much says nothing."""


@dataclass(frozen=True)
class CountedCover:
    """
    Poses of B in the frame of A, in the plane.

    Parameters
    ----------
    slices : YawSlices
    supports : numpy.ndarray, shape (n, k + 1, SIDES)
        Level j of a slice bounds the places, in m along `DIRECTIONS`, of its poses that broke j
        readings at most. It is part of level j + 1; where there is none supports are -inf.

    """

    slices: YawSlices
    supports: np.ndarray

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
            In the plane: all points at one height, all rays level.
        options : PairOptions
        stopped : callable, optional
            As for `cover_poses`.

        Returns
        -------
        CountedCover or None
            None where they do not bound the position of B.

        Raises
        ------
        ValueError
            If the readings are not in the plane.

        """
        _check_level(readings)
        levels = [cover_poses(readings, options, stopped=stopped)]
        if not levels[0].bounded:
            return None
        for most in range(options.max_outliers - 1, -1, -1):
            fewer = replace(options, max_outliers=most)
            levels.append(cover_poses(readings, fewer, within=levels[-1], stopped=stopped))
        return cls.of_levels(levels[::-1])

    @classmethod
    def of_levels(cls, levels: list[Cover]) -> Self:
        """Return the poses of covers, each of which is part of the next."""
        yaws = levels[-1].boxes[:, :, YAW]
        if levels[-1].empty:
            slices = YawSlices.of_arc(0.0, 0.0, 1)[:0]
        else:
            slices = YawSlices.of_arc(*arc_around(yaws[:, LOW], yaws[:, HIGH]), 2 * FEW_SLICES)
        supports = np.full((len(slices), len(levels), SIDES), -math.inf)
        for number, level in enumerate(levels):
            reach = _supports_of(level.boxes)
            for place, meets in enumerate(_meetings(slices, level.boxes[:, :, YAW])):
                hull = np.max(reach[meets], axis=0, initial=-math.inf)
                supports[place, number:] = np.maximum(supports[place, number:], hull)
        return cls(slices, supports)._without_empty()

    @property
    def empty(self) -> bool:
        """Whether no pose is left, which proves that a measurement or a bound is wrong."""
        return len(self.slices) == 0

    @property
    def cover(self) -> Cover:
        """The poses that broke as many readings as are tolerated at most."""
        return self.level(self.supports.shape[1] - 1)

    def level(self, broken: int) -> Cover:
        """Return boxes around the poses that broke `broken` readings at most."""
        h = self.supports[:, broken]
        there = h[:, 0] > -math.inf
        yaws, quarter = self.slices.yaws[there], SIDES // 4
        boxes = np.zeros((len(yaws), 2, 4))
        boxes[:, HIGH, X], boxes[:, HIGH, Y] = h[there, 0], h[there, quarter]
        boxes[:, LOW, X], boxes[:, LOW, Y] = -h[there, 2 * quarter], -h[there, 3 * quarter]
        boxes[:, LOW, YAW] = angle_down(yaws[:, 0] - yaws[:, 1])
        boxes[:, HIGH, YAW] = angle_up(yaws[:, 0] + yaws[:, 1])
        return Cover(boxes)

    @property
    def uncounted(self) -> Self:
        """The same poses, without what they broke."""
        return replace(self, supports=np.ascontiguousarray(self.supports[:, -1:]))

    @default_environment()
    def carried(self, step: PastPoses, ball_m: float = 0.0) -> Self | None:
        """
        Return the cover after B has moved.

        Parameters
        ----------
        step : PastPoses
            One pose: where B is now, seen from where it was. Its height does not count.
        ball_m : float, optional
            How far from that it may be besides, in any direction.

        Returns
        -------
        CountedCover or None
            None where the step is not bounded.

        """
        position_m, half_m = center_and_half(step.position_m)
        turn_rad, half_rad = center_and_half(step.yaw_rad)
        added = np.stack([position_m[0, :Z], half_m[0, :Z]])
        if not (np.all(np.abs(added) < FARTHEST_M) and ball_m < FARTHEST_M):
            return None
        if not (abs(turn_rad[0]) <= LARGEST_ANGLE_RAD and half_rad[0] < math.inf):
            return None
        moved = np.empty_like(self.supports)
        move_slices(self.supports, self.slices.yaws, added, ball_m, moved)
        slices = self.slices.turned(float(turn_rad[0]), float(half_rad[0]))
        return replace(self, slices=slices, supports=moved)._in_slices()

    @default_environment()
    def cut(self, readings: PairReadings) -> Self:
        """
        Return what readings leave, each of which counts once.

        Parameters
        ----------
        readings : PairReadings
            In the plane: all points at one height, all rays level.

        Raises
        ------
        ValueError
            If the readings are not in the plane.

        """
        _check_level(readings)
        kept = np.empty_like(self.supports)
        cut_slices(self.supports, self.slices.yaws, readings.table, kept)
        return replace(self, supports=kept)._without_empty()

    def _without_empty(self) -> Self:
        """Return the slices that have poses."""
        there = self.supports[:, -1, 0] > -math.inf
        return type(self)(self.slices[there], self.supports[there])

    def _in_slices(self) -> Self:
        """Return the same poses in slices that overlap little and are as thin as they may be."""
        found = self
        if found.slices.beyond_rad >= found.slices.width_rad:
            found = found._joined(*found.slices.spread())
        while len(found.slices) > MOST_SLICES:
            found = found._joined(*found.slices.wider())
        while 0 < len(found.slices) <= FEW_SLICES and found.slices.per_turn < MOST_PER_TURN:
            found = found._joined(*found.slices.thinner())
        return found

    def _joined(self, slices: YawSlices, sources: np.ndarray, targets: np.ndarray) -> Self:
        """Return the poses in other slices."""
        hulls = np.full((len(slices), *self.supports.shape[1:]), -math.inf)
        join_slices(self.supports, sources, targets, hulls)
        return type(self)(slices, hulls)


def _check_level(readings: PairReadings) -> None:
    """Raise ValueError for readings that are not in the plane."""
    for name in ('points_a_m', 'points_b_m'):
        points = getattr(readings, name)
        if not np.all(np.abs([points.lower[:, Z], points.upper[:, Z]]) < LEVEL_M):
            raise ValueError(f'{name}: a counted cover is in the plane, all heights have to be 0')
    if np.any(readings.rays[:, Z] != 0.0):
        raise ValueError('rays: a counted cover is in the plane, all rays have to be level')


def _supports_of(boxes: np.ndarray) -> np.ndarray:
    """Return how far boxes (n, 2, 4) reach along each direction, shape (n, SIDES)."""
    farther = np.where(DIRECTIONS > 0.0, boxes[:, HIGH, None, :Z], boxes[:, LOW, None, :Z])
    along = up(DIRECTIONS * farther)
    return up(along[..., X] + along[..., Y])


def _meetings(slices: YawSlices, yaws: np.ndarray) -> np.ndarray:
    """Return which yaws (m, 2) have any in common with which slices, shape (n, m)."""
    middles, halves = slices.yaws.T[:, :, None]
    half = 0.5 * (yaws[:, HIGH] - yaws[:, LOW])
    apart = np.remainder(middles - (yaws[:, LOW] + half) + 0.5 * TURN, TURN) - 0.5 * TURN
    return np.abs(apart) <= angle_up(angle_up(halves + half))
