# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""How far a robot can have moved and turned between two times: speed limits and odometry."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, replace
import math

import numpy as np

from dg_localization.fleet.vocabulary import OdometryReading
from dg_localization.interval.angles import angle_up
from dg_localization.interval.bounds import elapsed_up, product_up, sum_up
from dg_localization.interval.rounding import step_up


def rotation_of_quaternion(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a unit quaternion."""
    x, y, z, w = quaternion_xyzw
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation_angle_rad(rotation: np.ndarray) -> float:
    """Return the angle of a rotation matrix, in [0, pi]."""
    axis = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    return math.atan2(float(np.linalg.norm(axis)), float(np.trace(rotation)) - 1.0)


class OdometryTrack:
    """
    The newest odometry of one robot, oldest first.

    Parameters
    ----------
    max_speed_m_s, max_turn_rate_rad_s : float
        Limits of the robot.
    relative_error : float
        Greatest error of odometry as a fraction of the path and the turn at full speed.
    keep_s : float
        How long readings are kept.

    """

    def __init__(
        self,
        max_speed_m_s: float,
        max_turn_rate_rad_s: float,
        relative_error: float,
        keep_s: float,
    ) -> None:
        self._max_speed_m_s = max_speed_m_s
        self._max_turn_rate_rad_s = max_turn_rate_rad_s
        self._tolerance = 1.0 + relative_error + 1e-9
        self._keep_s = keep_s
        self._readings: list[OdometryReading] = []
        self._restarted_s = 0.0

    @property
    def readings(self) -> tuple[OdometryReading, ...]:
        """The readings that are kept."""
        return tuple(self._readings)

    @property
    def newest(self) -> OdometryReading:
        """The last reading; there is one from the first `append` on."""
        return self._readings[-1]

    def append(self, reading: OdometryReading) -> None:
        """
        Add a reading, which must be newer than the last one.

        A step or a turn that is faster than the robot can be is a restart of the odometry, and so
        is another frame. It says nothing about the motion before it, so the older readings are
        forgotten.
        """
        if self._readings and self._restarted(self._readings[-1], reading):
            self._readings.clear()
            self._restarted_s = reading.stamp_s
        self._readings.append(replace(reading, restarted_s=self._restarted_s))
        self._forget_before(reading.stamp_s - self._keep_s)

    def _restarted(self, last: OdometryReading, reading: OdometryReading) -> bool:
        """Return whether a reading is of another frame, or more than the robot can do away."""
        if reading.frame != last.frame:
            return True
        step_m = float(np.linalg.norm(reading.position_m - last.position_m))
        turn_rad = rotation_angle_rad(last.rotation.T @ reading.rotation)
        longest_s = elapsed_up(reading.stamp_s, last.stamp_s) * self._tolerance
        too_far = step_m > self._max_speed_m_s * longest_s
        return too_far or turn_rad > angle_up(self._max_turn_rate_rad_s * longest_s)

    def _forget_before(self, stamp_s: float) -> None:
        """Drop readings older than `stamp_s`, except the last of them."""
        first_kept = bisect_left(self._readings, stamp_s, key=lambda reading: reading.stamp_s)
        del self._readings[: max(0, first_kept - 1)]


@dataclass(frozen=True)
class Motion:
    """
    Bounds of how far every point can have moved and turned between two times.

    Parameters
    ----------
    max_speed_m_s : mapping of str to float
        By point.
    max_turn_rate_rad_s : float
    relative_error : float
        Of odometry, as a fraction of the path and the turn at full speed. The path itself is not
        known: between two poses a robot may have gone back and forth.
    odometry : mapping of str to tuple of OdometryReading
        By robot, oldest first.

    """

    max_speed_m_s: Mapping[str, float]
    max_turn_rate_rad_s: float
    relative_error: float
    odometry: Mapping[str, tuple[OdometryReading, ...]]

    def displacement_m(self, point: str, first_s: float, second_s: float) -> float:
        """Return an upper bound of how far `point` moved between two times."""
        speed_m_s = self.max_speed_m_s[point]
        by_speed_m = product_up(speed_m_s, elapsed_up(first_s, second_s))
        track = self.odometry.get(point)
        if not track:
            return by_speed_m
        start, end = _nearest(track, first_s), _nearest(track, second_s)
        by_odometry_m = sum_up(
            _distance_up_m(start.position_m, end.position_m),
            product_up(speed_m_s, self._unknown_up_s(start, end, first_s, second_s)),
        )
        return min(by_speed_m, by_odometry_m)

    def turn(self, point: str, first_s: float, second_s: float) -> tuple[np.ndarray, float]:
        """
        Return how `point` turned between two times.

        Returns
        -------
        rotation : numpy.ndarray, shape (3, 3)
            Takes a fixed direction from body coordinates at the first time to body coordinates
            at the second.
        half_width_rad : float
            Greatest angle by which that may be wrong.

        """
        rate_rad_s = self.max_turn_rate_rad_s
        by_rate_rad = product_up(rate_rad_s, elapsed_up(first_s, second_s))
        track = self.odometry.get(point)
        if track:
            start, end = _nearest(track, first_s), _nearest(track, second_s)
            unknown_s = self._unknown_up_s(start, end, first_s, second_s)
            error_rad = angle_up(product_up(rate_rad_s, unknown_s))
            if error_rad < by_rate_rad:
                return end.rotation.T @ start.rotation, error_rad
        return np.eye(3), by_rate_rad

    def turn_up_rad(self, point: str, first_s: float, second_s: float) -> float:
        """Return an upper bound of the angle by which `point` turned between two times."""
        rotation, half_width_rad = self.turn(point, first_s, second_s)
        return angle_up(sum_up(angle_up(rotation_angle_rad(rotation)), half_width_rad))

    def _unknown_up_s(
        self, start: OdometryReading, end: OdometryReading, first_s: float, second_s: float
    ) -> float:
        """
        Return for how long at full speed the motion between two times is unknown.

        That is the time beyond the two readings, and the error of odometry between them.
        """
        return sum_up(
            product_up(self.relative_error, elapsed_up(start.stamp_s, end.stamp_s)),
            elapsed_up(start.stamp_s, first_s),
            elapsed_up(end.stamp_s, second_s),
        )


def _distance_up_m(first: np.ndarray, second: np.ndarray) -> float:
    """Return an upper bound of the distance of two positions."""
    # math.dist subtracts, which errs by half a unit, and is exact to one unit from there.
    return step_up(step_up(math.dist(first.tolist(), second.tolist())))


def _nearest(track: tuple[OdometryReading, ...], stamp_s: float) -> OdometryReading:
    """Return the reading whose stamp is nearest."""
    after = bisect_left(track, stamp_s, key=lambda reading: reading.stamp_s)
    around = track[max(0, after - 1) : after + 1]
    return min(around, key=lambda reading: abs(reading.stamp_s - stamp_s))
