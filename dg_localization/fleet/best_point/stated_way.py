# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The way of a robot in the plane as its odometry states it: its bodies now and before.

Plain floating point: it serves an estimate. What is proved comes from `fleet.odometry`.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
import copy
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.terms import LEAST_HALF_WIDTH, STEP, TURN, Terms
from dg_localization.fleet.snapshot import Snapshot

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOST_SAMPLES = 200
"""Between them the way is straight."""

STEP_ERROR = 1e-3
"""Odometry is never as exact as its bounds may say, in m and in rad."""


class StatedWay:
    """The odometry of a robot since a time, thinned; `row` is its body of now."""

    def __init__(self, snapshot: Snapshot, robot: str, oldest_s: float, row: int) -> None:
        config, track = snapshot.config, snapshot.motion.odometry[robot]
        self._error = config.odometry_error_of(robot)
        self._limits = config.speed_m_s(robot), config.max_turn_rate_rad_s
        self.row, self._now_s, self._oldest_s = row, snapshot.stamp_s, oldest_s
        first = max(0, bisect_left(track, oldest_s, key=lambda one: one.stamp_s) - 1)
        every = max(1, (len(track) - first) // MOST_SAMPLES)
        # The newest one counts most.
        readings = track[::-1][: len(track) - first : every][::-1]
        self._stamps_s = np.array([reading.stamp_s for reading in readings])
        # Where it was before its odometry began, or started anew, is not known.
        self.since_s = max(oldest_s, float(self._stamps_s[0]))
        positions_m = np.array([reading.position_m[:2] for reading in readings])
        rotations = np.array([reading.rotation for reading in readings])
        yaws_rad = np.unwrap(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))
        self._columns = (*positions_m.T, yaws_rad)
        steps_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
        turns_rad = np.abs(np.diff(yaws_rad))
        self._sums = [np.append(0.0, np.cumsum(steps)) for steps in (steps_m, turns_rad)]
        stamps_s = np.array([reading.stamp_s for reading in track[first:]])
        steps_s = np.diff(stamps_s)
        silent_s = np.where(steps_s > self._error.max_gap_s, steps_s, 0.0)
        self._sampled_s = stamps_s, np.append(0.0, np.cumsum(silent_s))
        self.place_bodies(row + 1, 1)

    def place_bodies(self, first_past: int, count: int) -> None:
        """Give the robot bodies at `count` earlier times, numbered from `first_past`."""
        span_s = self._now_s - self._oldest_s
        self.times_s = self._now_s - np.linspace(0.0, span_s, count + 1)
        self._bodies = np.concatenate([[self.row], first_past + np.arange(count)])
        self._stated = self._poses(self.times_s)

    def ends(self, stamps_s: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """
        Return the bodies nearest to some times, and the pose at each time in their frames.

        The last array, shape (m, 2), is what silent odometry leaves open of each, in m and rad.
        """
        spacing_s = self.times_s[0] - self.times_s[1]
        nearest = np.rint((self.times_s[0] - stamps_s) / spacing_s).astype(int)
        nearest = np.clip(nearest, 0, len(self.times_s) - 1)
        unknown = self._unknown_motion(stamps_s, self.times_s[nearest])
        poses = seen_from(self._stated[nearest], self._poses(stamps_s))
        return self._bodies[nearest], poses, unknown.T

    def poses_now(self, stamps_s: FloatArray) -> FloatArray:
        """Return the poses at some times, seen from that of now, shape (m, 3)."""
        return seen_from(self._stated[0], self._poses(stamps_s))

    def steps(self) -> Iterator[Terms]:
        """Yield the terms that odometry makes of the bodies."""
        bodies = np.stack([self._bodies[:-1], self._bodies[1:]], axis=-1)
        between = seen_from(self._stated[:-1], self._stated[1:])
        error, times_s = self._error, self.times_s
        driven = [-np.diff(np.interp(times_s, self._stamps_s, sums)) for sums in self._sums]
        rates = [
            [error.translation_per_m, error.translation_per_rad],
            [error.rotation_per_m, error.rotation_per_rad],
        ]
        errors = rates @ np.array(driven) + self._unknown_motion(times_s[1:], times_s[:-1])
        errors += np.array([[error.constant_m], [error.constant_rad]])
        errors_m, errors_rad = np.maximum(errors, STEP_ERROR)
        ends = np.zeros((len(bodies), 2, 3))
        ends[:, 0, :2] = between[:, :2]
        nothing = np.zeros((len(bodies), 3))
        yield packed(STEP, bodies, ends, nothing, errors_m)
        axes = directions(between[:, 2])
        yield packed(TURN, bodies, np.zeros((len(bodies), 2, 3)), axes, errors_rad)

    def erring(self) -> Iterator[StatedWay]:
        """Yield ways whose odometry errs as far as its bounds allow all along, for one reason."""
        error, (x_m, y_m, yaws_rad) = self._error, self._columns
        places_m = x_m + 1j * y_m
        yield self._changed((1.0 + error.translation_per_m) * places_m, yaws_rad)
        for turns_rad in (error.rotation_per_rad * yaws_rad, error.rotation_per_m * self._sums[0]):
            steps_m = np.diff(places_m) * np.exp(0.5j * (turns_rad[1:] + turns_rad[:-1]))
            yield self._changed(np.append(0.0, np.cumsum(steps_m)), yaws_rad + turns_rad)
        yield self._changed(places_m, yaws_rad, error.latency_s)

    def _changed(
        self, places_m: NDArray[np.complex128], yaws_rad: FloatArray, late_s: float = 0.0
    ) -> StatedWay:
        """Return this way with other stated poses, which are late."""
        changed = copy.copy(self)
        changed._columns = (places_m.real, places_m.imag, yaws_rad)
        changed._stamps_s = self._stamps_s + late_s
        changed._stated = changed._poses(self.times_s)
        return changed

    def _poses(self, times_s: FloatArray) -> FloatArray:
        """Return x, y and yaw at some times, shape (m, 3); the first and the last one beyond."""
        return np.stack([np.interp(times_s, self._stamps_s, c) for c in self._columns], axis=-1)

    def _unknown_motion(self, first_s: FloatArray, second_s: FloatArray) -> FloatArray:
        """
        Return what the stated motion between times leaves open, in m and rad, shape (2, m).

        That is how far the robot can have gone while odometry was silent. It is as likely as not
        that it went on at full speed, so that half width counts as a deviation.
        """
        silent_s = np.abs(self._silent_s(second_s) - self._silent_s(first_s))
        return np.multiply.outer(self._limits, math.sqrt(3.0) * silent_s)

    def _silent_s(self, times_s: FloatArray) -> FloatArray:
        """Return for how long odometry was silent up to some times, after its last message too."""
        stamps_s, silent_s = self._sampled_s
        return np.interp(times_s, stamps_s, silent_s) + np.maximum(times_s - stamps_s[-1], 0.0)


def packed(
    kind: int, bodies: IntArray, arms_m: FloatArray, values: FloatArray, half_widths: FloatArray
) -> Terms:
    """Return terms of one kind."""
    weights = 1.0 / np.maximum(half_widths, LEAST_HALF_WIDTH)
    return Terms(np.full(len(bodies), kind), bodies, arms_m, values, weights)


def directions(angles_rad: FloatArray) -> FloatArray:
    """Return unit vectors in the plane, shape (m, 3)."""
    return np.stack([np.cos(angles_rad), np.sin(angles_rad), np.zeros(len(angles_rad))], axis=-1)


def seen_from(origins: FloatArray, poses: FloatArray) -> FloatArray:
    """Return poses (x, y, yaw) seen from others, shape (m, 3)."""
    dx, dy, turn = np.moveaxis(poses - origins, -1, 0)
    c, s = np.cos(origins[..., 2]), np.sin(origins[..., 2])
    return np.stack([c * dx + s * dy, c * dy - s * dx, turn], axis=-1)
