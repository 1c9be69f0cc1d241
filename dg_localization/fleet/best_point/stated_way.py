# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The way of a robot in the plane as its odometry states it, and what it may be off.

Plain floating point: it serves an estimate. What is proved comes from `fleet.odometry`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.snapshot import Snapshot

FloatArray = NDArray[np.float64]

STEP_ERROR = 1e-3
"""Odometry is never as exact as its bounds may say, in m and in rad."""


class StatedWay:
    """The odometry of a robot since a time."""

    def __init__(self, snapshot: Snapshot, robot: str, oldest_s: float) -> None:
        config = snapshot.config
        path = snapshot.carried.path(config.robots.index(robot))
        self._error = config.odometry_error_of(robot)
        self._limits = config.speed_m_s(robot), config.max_turn_rate_rad_s
        self._now_s, self.latency_s = snapshot.stamp_s, self._error.latency_s
        first = max(0, int(np.searchsorted(path.stamps_s, oldest_s)) - 1)
        self._stamps_s, self._stated = path.stamps_s[first:], path.poses[first:]
        # Where it was before its odometry began is not known.
        self.since_s = max(oldest_s, float(self._stamps_s[0]))
        self._stated[:, 2] = np.unwrap(self._stated[:, 2])
        steps = np.diff(self._stated, axis=0)
        silent_s = np.where(path.is_known[first:], 0.0, np.diff(self._stamps_s))
        each = np.stack([np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2]), silent_s])
        # The way, the turns, and for how long nothing came, up to each sample.
        self._sums = np.pad(np.cumsum(each, axis=1), ((0, 0), (1, 0)))

    def poses(self, times_s: FloatArray) -> FloatArray:
        """Return x, y and yaw at some times, shape (m, 3); the ends of the way beyond."""
        columns = self._stated.T
        return np.stack([np.interp(times_s, self._stamps_s, one) for one in columns], axis=-1)

    def poses_now(self, times_s: FloatArray) -> FloatArray:
        """Return the poses at some times seen from that of now, shape (m, 3)."""
        return seen_from(self.poses(np.array([self._now_s])), self.poses(times_s))

    def driven(self, first_s: FloatArray, second_s: FloatArray) -> FloatArray:
        """Return the stated ways and turns between times, in m and in rad, shape (2, m)."""
        ends = [
            [np.interp(times_s, self._stamps_s, sums) for times_s in (first_s, second_s)]
            for sums in self._sums[:2]
        ]
        return np.asarray(np.abs(np.diff(ends, axis=1)[:, 0]))

    def errors(self, first_s: FloatArray, second_s: FloatArray) -> FloatArray:
        """Return the errors of the ways between times, in m and in rad, shape (2, m)."""
        error = self._error
        rates = [
            [error.translation_per_m, error.translation_per_rad],
            [error.rotation_per_m, error.rotation_per_rad],
        ]
        errors = rates @ self.driven(first_s, second_s) + self.unknown(first_s, second_s)
        return np.maximum(errors + [[error.constant_m], [error.constant_rad]], STEP_ERROR)

    def most_late(self) -> FloatArray:
        """Return how far the robot can get and turn within the latency of its odometry."""
        return np.multiply(self._limits, self.latency_s)

    def late(self, ages_s: FloatArray) -> FloatArray:
        """Return the poses at some ages seen from those before the latency, shape (m, 3)."""
        times_s = self._now_s - ages_s
        return seen_from(self.poses(times_s - self.latency_s), self.poses(times_s))

    def unknown(self, first_s: FloatArray, second_s: FloatArray) -> FloatArray:
        """
        Return what the stated motion between times leaves open, in m and rad, shape (2, m).

        That is how far the robot can have gone while odometry was silent. It is as likely as not
        that it went on at full speed, so that half width counts as a deviation.
        """
        silent_s = np.abs(self._silent_s(second_s) - self._silent_s(first_s))
        return np.multiply.outer(self._limits, math.sqrt(3.0) * silent_s)

    def _silent_s(self, times_s: FloatArray) -> FloatArray:
        """Return for how long odometry was silent up to some times, after its last message too."""
        known_s = np.interp(times_s, self._stamps_s, self._sums[2])
        return known_s + np.maximum(times_s - self._stamps_s[-1], 0.0)


def seen_from(origins: FloatArray, poses: FloatArray) -> FloatArray:
    """Return poses (x, y, yaw) seen from others, shape (..., 3)."""
    dx, dy, turn = np.moveaxis(poses - origins, -1, 0)
    c, s = np.cos(origins[..., 2]), np.sin(origins[..., 2])
    return np.stack([c * dx + s * dy, c * dy - s * dx, turn], axis=-1)


def points_on(poses: FloatArray, arms_m: FloatArray) -> FloatArray:
    """Return where points on bodies are, shape (m, 2), by the poses (x, y, yaw) of these."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = arms_m.T
    return np.asarray(poses[:, :2] + np.stack([c * x - s * y, s * x + c * y], axis=-1))
