# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The way of a robot in the plane as its odometry states it, and how wrong it may be.

Plain floating point: it serves an estimate. What is proved comes from `fleet.odometry`.
"""

from __future__ import annotations

from bisect import bisect_left
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.odometry import MotionLimits
from dg_localization.fleet.odometry_error import OdometryErrorModel
from dg_localization.fleet.vocabulary import OdometryReading

FloatArray = NDArray[np.float64]

MOST_SAMPLES = 200
"""Between them the way is straight."""


class StatedWay:
    """
    Odometry since some time, thinned.

    Parameters
    ----------
    track : tuple of OdometryReading
        Oldest first, at least one.
    since_s : float
        What is older is left out.
    error : OdometryErrorModel
    limits : MotionLimits
        They bound what the robot did where odometry was silent.

    """

    def __init__(
        self,
        track: tuple[OdometryReading, ...],
        since_s: float,
        error: OdometryErrorModel,
        limits: MotionLimits,
    ) -> None:
        self._error, self._limits = error, limits
        first = max(0, bisect_left(track, since_s, key=lambda reading: reading.stamp_s) - 1)
        every = max(1, (len(track) - first) // MOST_SAMPLES)
        # The newest one counts most.
        readings = track[::-1][: len(track) - first : every][::-1]
        self.stamps_s = np.array([reading.stamp_s for reading in readings])
        self._positions_m = np.array([reading.position_m[:2] for reading in readings])
        rotations = np.array([reading.rotation for reading in readings])
        self._yaws_rad = np.unwrap(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))
        steps_m = np.linalg.norm(np.diff(self._positions_m, axis=0), axis=1)
        self._way_m = np.concatenate([[0.0], np.cumsum(steps_m)])
        self._turned_rad = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(self._yaws_rad)))])
        stamps_s = np.array([reading.stamp_s for reading in track[first:]])
        steps_s = np.diff(stamps_s)
        silent_s = np.where(steps_s > error.max_gap_s, steps_s, 0.0)
        self._sampled_s = stamps_s, np.concatenate([[0.0], np.cumsum(silent_s)])

    def poses(self, times_s: FloatArray) -> FloatArray:
        """Return x, y and yaw at some times, shape (m, 3); the first and the last one beyond."""
        columns = (*self._positions_m.T, self._yaws_rad)
        return np.stack([np.interp(times_s, self.stamps_s, c) for c in columns], axis=-1)

    def errors(self, before_s: FloatArray, after_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the greatest errors between some times, in m and in rad."""
        error = self._error
        ways, turns = (
            np.interp(after_s, self.stamps_s, sums) - np.interp(before_s, self.stamps_s, sums)
            for sums in (self._way_m, self._turned_rad)
        )
        unknown_m, unknown_rad = self.unknown_motion(before_s, after_s)
        of_way_m = error.translation_per_m * ways + error.translation_per_rad * turns
        of_way_rad = error.rotation_per_m * ways + error.rotation_per_rad * turns
        return (
            of_way_m + error.constant_m + unknown_m,
            of_way_rad + error.constant_rad + unknown_rad,
        )

    def unknown_motion(
        self, first_s: FloatArray, second_s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """
        Return what the stated motion between times leaves open, as half widths in m and rad.

        That is how far the robot can have gone while odometry was silent. It is as likely as not
        that it went on at full speed, so that half width counts as a deviation. Stamps that are
        late misplace what was done at either end; most of it was done at both.
        """
        silent_s = np.abs(self._silent_s(second_s) - self._silent_s(first_s))
        late_s = np.minimum(self._error.latency_s, np.abs(second_s - first_s))
        open_s = math.sqrt(3.0) * silent_s + late_s
        return self._limits.speed_m_s * open_s, self._limits.turn_rate_rad_s * open_s

    def _silent_s(self, times_s: FloatArray) -> FloatArray:
        """Return for how long odometry was silent up to some times, after its last message too."""
        stamps_s, silent_s = self._sampled_s
        return np.interp(times_s, stamps_s, silent_s) + np.maximum(times_s - stamps_s[-1], 0.0)


def seen_from(origins: FloatArray, poses: FloatArray) -> FloatArray:
    """Return poses (x, y, yaw) seen from others, shape (m, 3)."""
    dx, dy, turn = np.moveaxis(poses - origins, -1, 0)
    c, s = np.cos(origins[..., 2]), np.sin(origins[..., 2])
    return np.stack([c * dx + s * dy, c * dy - s * dx, turn], axis=-1)
