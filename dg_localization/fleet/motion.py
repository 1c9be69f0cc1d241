"""How far a robot can have moved and turned between two times: speed limits and odometry."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
import math

import numpy as np

from dg_localization.fleet.vocabulary import OdometryReading
from dg_localization.interval.arrays import ROUNDING_RAD


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


def elapsed_s(first_s: float, second_s: float) -> float:
    """
    Return an upper bound of the time between two stamps.

    Nanoseconds since 1970 do not fit a double: each stamp may be half a unit off.
    """
    if first_s == second_s:
        return math.ulp(first_s)
    return abs(first_s - second_s) + 2.0 * math.ulp(max(abs(first_s), abs(second_s)))


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

    @property
    def readings(self) -> tuple[OdometryReading, ...]:
        """The readings that are kept."""
        return tuple(self._readings)

    def append(self, reading: OdometryReading) -> None:
        """
        Add a reading, which must be newer than the last one.

        A step or a turn that is faster than the robot can be is a restart of the odometry. It
        says nothing about the motion before it, so the older readings are forgotten.
        """
        if self._readings:
            last = self._readings[-1]
            step_m = float(np.linalg.norm(reading.position_m - last.position_m))
            turn_rad = rotation_angle_rad(last.rotation.T @ reading.rotation)
            if self._restarted(step_m, turn_rad, elapsed_s(reading.stamp_s, last.stamp_s)):
                self._readings.clear()
        self._readings.append(reading)
        self._forget_before(reading.stamp_s - self._keep_s)

    def _restarted(self, step_m: float, turn_rad: float, seconds: float) -> bool:
        """Return whether a step or a turn is more than the robot can do in that time."""
        span = seconds * self._tolerance
        return (
            step_m > self._max_speed_m_s * span
            or turn_rad > self._max_turn_rate_rad_s * span + ROUNDING_RAD
        )

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
        speed = self.max_speed_m_s[point]
        limit = speed * elapsed_s(first_s, second_s)
        track = self.odometry.get(point)
        if track:
            start, end = _nearest(track, first_s), _nearest(track, second_s)
            gaps_s = elapsed_s(start.stamp_s, first_s) + elapsed_s(end.stamp_s, second_s)
            limit = min(
                limit,
                float(np.linalg.norm(end.position_m - start.position_m))
                + self.relative_error * speed * elapsed_s(start.stamp_s, end.stamp_s)
                + speed * gaps_s,
            )
        # A handful of roundings, each below 1.2e-16 of the result.
        return limit * (1.0 + 1e-14)

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
        rate = self.max_turn_rate_rad_s
        blind_rad = rate * elapsed_s(first_s, second_s)
        track = self.odometry.get(point)
        if track:
            start, end = _nearest(track, first_s), _nearest(track, second_s)
            gaps_s = elapsed_s(start.stamp_s, first_s) + elapsed_s(end.stamp_s, second_s)
            error_rad = (
                self.relative_error * rate * elapsed_s(start.stamp_s, end.stamp_s)
                + rate * gaps_s
                + ROUNDING_RAD
            )
            if error_rad < blind_rad:
                return end.rotation.T @ start.rotation, error_rad
        return np.eye(3), blind_rad * (1.0 + 1e-14)


def _nearest(track: tuple[OdometryReading, ...], stamp_s: float) -> OdometryReading:
    """Return the reading whose stamp is nearest."""
    after = bisect_left(track, stamp_s, key=lambda reading: reading.stamp_s)
    around = track[max(0, after - 1) : after + 1]
    return min(around, key=lambda reading: abs(reading.stamp_s - stamp_s))
