# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The way of a robot in the plane as its odometry states it, and how wrong it may be.

Plain floating point: it serves an estimate. What is proved comes from `fleet.odometry`.
"""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

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

    """

    def __init__(self, track: tuple[OdometryReading, ...], since_s: float) -> None:
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

    def poses(self, times_s: FloatArray) -> FloatArray:
        """Return x, y and yaw at some times, shape (m, 3); the first and the last one beyond."""
        columns = (*self._positions_m.T, self._yaws_rad)
        return np.stack([np.interp(times_s, self.stamps_s, c) for c in columns], axis=-1)

    def errors(
        self, error: OdometryErrorModel, before_s: FloatArray, after_s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the greatest errors between some times, in m and in rad."""
        ways, turns = (
            np.interp(after_s, self.stamps_s, sums) - np.interp(before_s, self.stamps_s, sums)
            for sums in (self._way_m, self._turned_rad)
        )
        return (
            error.translation_per_m * ways + error.translation_per_rad * turns + error.constant_m,
            error.rotation_per_m * ways + error.rotation_per_rad * turns + error.constant_rad,
        )


def seen_from(origins: FloatArray, poses: FloatArray) -> FloatArray:
    """Return poses (x, y, yaw) seen from others, shape (m, 3)."""
    dx, dy, turn = np.moveaxis(poses - origins, -1, 0)
    c, s = np.cos(origins[..., 2]), np.sin(origins[..., 2])
    return np.stack([c * dx + s * dy, c * dy - s * dx, turn], axis=-1)
