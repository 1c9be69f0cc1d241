# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A plain extended Kalman filter of robots among landmarks, which needs a true start.

The state is x, y and yaw of every robot together, so that what one robot sees of another corrects
both. Odometry predicts, each range with its bearing corrects at its time (Thrun, Burgard, Fox,
Probabilistic Robotics, 2005, Sections 5.4 and 7.4). Readings beyond three deviations are left out:
without that, misread markers throw it off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Deviations:
    """
    Standard deviations of the noise.

    Parameters
    ----------
    range_relative, bearing_rad : float
        Of what is seen; of a range as a fraction of it.
    way_per_m, turn_per_rad : float
        Of odometry, after a way of 1 m and a turn of 1 rad; the variance grows with either.
    turn_per_s : float
        Of the yaw, after 1 s.
    start : float
        Of the start, in m and in rad.

    """

    range_relative: float = 0.075
    bearing_rad: float = 0.06
    way_per_m: float = 0.1
    turn_per_rad: float = 0.2
    turn_per_s: float = 0.02
    start: float = 0.05


GATE = 9.0
"""Squared deviations from which on a reading is left out."""

LEAST_RANGE_M = 0.01


class KalmanFilter:
    """
    Follows robots from a true start.

    Parameters
    ----------
    poses : numpy.ndarray, shape (n, 3)
        x, y and yaw of the start.
    names : sequence of str
        Of the robots.
    landmarks : mapping of str to numpy.ndarray, shape (2,)
    deviations : Deviations

    """

    def __init__(
        self,
        poses: FloatArray,
        names: Sequence[str],
        landmarks: Mapping[str, FloatArray],
        deviations: Deviations,
    ) -> None:
        self._state = np.array(poses, dtype=float).ravel()
        self._covariance = np.eye(len(self._state)) * deviations.start**2
        self._rows = {name: 3 * k for k, name in enumerate(names)}
        self._landmarks = landmarks
        self._deviations = deviations
        self._odometry: dict[str, tuple[FloatArray, float]] = {}

    @property
    def poses(self) -> FloatArray:
        """x, y and yaw of all robots, shape (n, 3)."""
        return self._state.reshape(-1, 3)

    def predict(self, robot: str, pose: FloatArray, stamp_s: float) -> None:
        """Move a robot on by its odometry: x, y and yaw in a frame that stands still."""
        before, before_s = self._odometry.get(robot, (pose, stamp_s))
        self._odometry[robot] = pose, stamp_s
        dx, dy, turn = pose - before
        c, s = math.cos(before[2]), math.sin(before[2])
        ahead, left = c * dx + s * dy, c * dy - s * dx
        row, deviations = self._rows[robot], self._deviations
        c, s = math.cos(self._state[row + 2]), math.sin(self._state[row + 2])
        self._state[row : row + 3] += [c * ahead - s * left, s * ahead + c * left, turn]
        change = np.eye(len(self._state))
        change[row : row + 2, row + 2] = -s * ahead - c * left, c * ahead - s * left
        self._covariance = change @ self._covariance @ change.T
        step2 = deviations.way_per_m**2 * math.hypot(dx, dy)
        turn2 = deviations.turn_per_rad**2 * abs(turn)
        turn2 += deviations.turn_per_s**2 * (stamp_s - before_s)
        self._covariance[range(row, row + 3), range(row, row + 3)] += [step2, step2, turn2]

    def correct(self, observer: str, target: str, range_m: float, bearing_rad: float) -> None:
        """Correct all poses by what a robot saw of a landmark or of another robot."""
        row, other = self._rows[observer], self._rows.get(target)
        place = self._landmarks[target] if other is None else self._state[other : other + 2]
        line = place - self._state[row : row + 2]
        away = max(float(np.linalg.norm(line)), LEAST_RANGE_M)
        slopes = np.array([line / away, [-line[1] / away**2, line[0] / away**2]])
        change = np.zeros((2, len(self._state)))
        change[:, row : row + 2] = -slopes
        change[1, row + 2] = -1.0
        if other is not None:
            change[:, other : other + 2] = slopes
        seen_rad = bearing_rad - (math.atan2(line[1], line[0]) - self._state[row + 2])
        off = np.array([range_m - away, math.remainder(seen_rad, 2.0 * math.pi)])
        range_deviation_m = max(self._deviations.range_relative * range_m, LEAST_RANGE_M)
        noise = np.diag([range_deviation_m**2, self._deviations.bearing_rad**2])
        spread = change @ self._covariance @ change.T + noise
        if off @ np.linalg.solve(spread, off) > GATE:
            return
        gain = np.linalg.solve(spread, change @ self._covariance).T
        self._state += gain @ off
        self._covariance -= gain @ spread @ gain.T
