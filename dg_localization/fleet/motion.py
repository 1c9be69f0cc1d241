# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds of the motion of a robot between two times, by speed limits and odometry."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
import math
from statistics import median

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.error_models import quoted
from dg_localization.fleet.odometry_error import OdometryErrorModel
from dg_localization.fleet.rotations import level_rotations, rotation_angle_rad
from dg_localization.fleet.vocabulary import OdometrySample
from dg_localization.fleet.window.memory import MOST_OBSERVATIONS, STAMP_S
from dg_localization.interval.angles import angle_up
from dg_localization.interval.bounds import elapsed_up, product_up, sum_up
from dg_localization.interval.rounding import rounding_error, step_up

ROUNDING = 1.0 + 1e-9
"""Margin for rounding, so that a robot at its limits does not count as a restart."""

ZERO_M, ZERO_RAD = 0.05, 0.05
"""A restarted driver reports a first pose at most this far from zero."""

PAUSE, PERIODS = 1.5, 9
"""A pause is longer than `PAUSE` times the median of the last `PERIODS` times between messages."""

NOT_TURNED = np.eye(3)
NOT_TURNED.flags.writeable = False

ROUNDED = 12
"""Rounding operations in two positions: each coordinate is rounded when reported and scaled."""


class OdometryTrack:
    """
    The newest odometry of one robot, oldest first.

    Attributes
    ----------
    answered_s : float
        The time of the last answer: the next one carries its pose sets on from there.
    restart : str
        A sentence on why the odometry last restarted; empty if it never did.

    """

    def __init__(self, config: FleetConfig, robot: str) -> None:
        self._robot = robot
        self.adopt(config)
        # A body that pitches turns by more than its heading.
        self._in_plane = config.dimension == 2
        self._readings: list[OdometrySample] = []
        self._restarted_s = 0.0
        self.restart = ''
        self.answered_s = math.inf

    def adopt(self, config: FleetConfig) -> None:
        """Adopt settings for the readings that are added from now on."""
        self._max_speed_m_s = config.speed_m_s(self._robot)
        self._max_turn_rate_rad_s = config.max_turn_rate_rad_s
        self._error = config.odometry_error_of(self._robot)
        self._keep_s = max(config.max_age_s, config.memory_s) + config.max_future_s

    @property
    def readings(self) -> tuple[OdometrySample, ...]:
        """The stored readings."""
        return tuple(self._readings)

    @property
    def newest(self) -> OdometrySample:
        """The last reading; there is one from the first `append` on."""
        return self._readings[-1]

    def append(self, reading: OdometrySample) -> None:
        """
        Add a reading, which must be newer than the last one.

        A step or turn beyond the limits of the robot is a restart of the odometry; so is a new
        frame name. Only the limits of the robot bound its motion across a restart. If there are
        no limits, the older readings are forgotten.
        """
        way_m, turned_rad = reading.way_m, reading.turned_rad
        if self._readings:
            last = self._readings[-1]
            step_m = _distance_up_m(reading.position_m, last.position_m)
            turn_rad = self._turn_up_rad(last.rotation, reading.rotation)
            elapsed_s = elapsed_up(reading.stamp_s, last.stamp_s)
            # Far from the origin, rounding of reported positions may look like a faster step.
            least_m = max(0.0, step_m - _rounding_up_m(reading.position_m, last.position_m))
            restart, unknown_m, unknown_rad = '', 0.0, 0.0
            if reading.frame != last.frame:
                restart = f'frame {quoted(last.frame)} has become {quoted(reading.frame)}'
            elif elapsed_s > self._error.restart_gap_s:
                restart = (
                    f'no message for {elapsed_s:.3f} s, restart_gap is '
                    f'{self._error.restart_gap_s:g} s'
                )
            elif self._is_back_at_zero(last, reading):
                restart = f'it is back at its origin after {elapsed_s:.3f} s without a message'
            elif self._is_too_fast(least_m, turn_rad, elapsed_s):
                # The limits may be wrong instead of the step.
                unknown_m, unknown_rad = step_m, turn_rad
                restart = (
                    f'{step_m:.3f} m and {turn_rad:.3f} rad in {elapsed_s:.3f} s are more than '
                    f'max_speed {self._max_speed_m_s:g} m/s and max_turn_rate '
                    f'{self._max_turn_rate_rad_s:g} rad/s allow'
                )
            if restart:
                self._restarted_s, self.restart = reading.stamp_s, f'started anew: {restart}'
                step_m, turn_rad = self._longest(unknown_m, unknown_rad, elapsed_s)
                step_m = sum_up(step_m, 2.0 * self._error.constant_m)
                turn_rad = sum_up(turn_rad, 2.0 * self._error.constant_rad)
            elif reading.stamp_s - last.stamp_s > self._error.max_gap_s:
                step_m, turn_rad = self._longest(step_m, turn_rad, elapsed_s)
            # In space, limits do not bound the heading of a steeply pitched body.
            if restart and not (self._in_plane and step_m < math.inf and turn_rad < math.pi):
                self._readings.clear()
            else:
                way_m, turned_rad = sum_up(last.way_m, step_m), sum_up(last.turned_rad, turn_rad)
        self._readings.append(
            replace(reading, way_m=way_m, turned_rad=turned_rad, restarted_s=self._restarted_s)
        )
        self._forget_outdated()

    def _is_back_at_zero(self, last: OdometrySample, reading: OdometrySample) -> bool:
        """
        Return whether a driver seems to have restarted at zero.

        The sign is a pose near the identity after a pause, with the pose before not near it. If
        the robot truly came back during the pause, forgetting its odometry is still sound.
        """
        if _is_near_zero(last) or not _is_near_zero(reading):
            return False
        periods_s = [b.stamp_s - a.stamp_s for a, b in pairwise(self._readings[-PERIODS - 1 :])]
        return not periods_s or reading.stamp_s - last.stamp_s > PAUSE * median(periods_s)

    def _turn_up_rad(self, before: np.ndarray, after: np.ndarray) -> float:
        """Return an upper bound of the angle between two rotations."""
        if self._in_plane:
            before, after = level_rotations(np.array([before, after]))
        return angle_up(rotation_angle_rad(before.T @ after))

    def _is_too_fast(self, step_m: float, turn_rad: float, elapsed_s: float) -> bool:
        """Return whether a step or a turn is more than the robot can do in that time."""
        longest_s = sum_up(elapsed_s, 2.0 * self._error.latency_s)
        error_m, error_rad = greatest_errors(self._error, step_m, turn_rad)
        farthest_m = sum_up(product_up(self._max_speed_m_s, longest_s), error_m)
        farthest_rad = sum_up(product_up(self._max_turn_rate_rad_s, longest_s), error_rad)
        return step_m > farthest_m * ROUNDING or turn_rad > angle_up(farthest_rad * ROUNDING)

    def _longest(self, step_m: float, turn_rad: float, elapsed_s: float) -> tuple[float, float]:
        """Return bounds of path length and turn between two readings if some are missing."""
        longest_s = sum_up(elapsed_s, 2.0 * self._error.latency_s)
        by_speed_m = product_up(self._max_speed_m_s, longest_s)
        by_rate_rad = product_up(self._max_turn_rate_rad_s, longest_s)
        return max(step_m, by_speed_m), max(turn_rad, by_rate_rad)

    def _forget_outdated(self) -> None:
        """Drop older readings than memory or the last answer need, except the last of them."""
        outdated, unneeded = (
            bisect_left(self._readings, until_s - self._keep_s, key=STAMP_S)
            for until_s in (self._readings[-1].stamp_s, self.answered_s)
        )
        # Their number is limited, since it would grow while there is no answer.
        first_kept = min(outdated, max(unneeded, outdated - MOST_OBSERVATIONS))
        del self._readings[: max(0, first_kept - 1)]


def _is_near_zero(reading: OdometrySample) -> bool:
    """Return whether a pose is near zero, as of a driver that has just started."""
    far_m = float(np.linalg.norm(reading.position_in_frame_m))
    return far_m <= ZERO_M and rotation_angle_rad(reading.rotation) <= ZERO_RAD


@dataclass(frozen=True)
class Motion:
    """
    Bounds of the motion and rotation of every point between two times.

    Parameters
    ----------
    config : FleetConfig
    odometry : mapping of str to tuple of OdometrySample
        The odometry of each robot, oldest first.

    """

    config: FleetConfig
    odometry: Mapping[str, tuple[OdometrySample, ...]]

    def by_speed_m(self, point: str, first_s: float, second_s: float) -> float:
        """Return an upper bound of the displacement of `point` between two times, by its speed."""
        speed_m_s = self.config.speed_m_s(self.config.robot_of(point))
        return most_between(speed_m_s, first_s, second_s, self.config.between_stamps_s)

    def displacement_m(self, point: str, first_s: float, second_s: float) -> float:
        """Return an upper bound of the displacement of `point` between two times."""
        by_speed_m = self.by_speed_m(point, first_s, second_s)
        robot = self.config.robot_of(point)
        track = self.odometry.get(robot)
        if not track:
            return by_speed_m
        error = self.config.odometry_error_of(robot)
        start, end = _nearest(track, first_s), _nearest(track, second_s)
        way_m, turned_rad = way_between(start, end)
        error_m = greatest_errors(error, way_m, turned_rad)[0]
        # An error of a turn swings the earlier path and lengthens no step.
        swing_rad = sum_up(
            product_up(error.rotation_per_m, way_m),
            product_up(error.rotation_per_rad, turned_rad),
        )
        chord_m = way_m
        if start.restarted_s == end.restarted_s:
            chord_m = _distance_up_m(start.position_m, end.position_m)
            chord_m = min(sum_up(chord_m, product_up(swing_rad, way_m)), way_m)
        # The constant errors of the poses turn with the track, too.
        error_m = sum_up(error_m, product_up(swing_rad, error.constant_m))
        beyond_s = _beyond_up_s(error, start, end, first_s, second_s)
        by_odometry_m = sum_up(
            chord_m, error_m, product_up(self.config.speed_m_s(robot), beyond_s)
        )
        return min(by_speed_m, by_odometry_m)

    def turn(self, point: str, first_s: float, second_s: float) -> tuple[np.ndarray, float]:
        """
        Return the rotation of `point` between two times, and a bound of its error as an angle.

        The rotation takes a fixed direction from body coordinates at the first time to body
        coordinates at the second.
        """
        config, robot = self.config, self.config.robot_of(point)
        rate_rad_s = config.max_turn_rate_rad_s
        by_rate_rad = most_between(rate_rad_s, first_s, second_s, config.between_stamps_s)
        track = self.odometry.get(robot)
        if track:
            error = config.odometry_error_of(robot)
            start, end = _nearest(track, first_s), _nearest(track, second_s)
            beyond_s = _beyond_up_s(error, start, end, first_s, second_s)
            error_rad = greatest_errors(error, *way_between(start, end))[1]
            error_rad = angle_up(
                sum_up(error_rad, 2.0 * error.least_tilt_rad, product_up(rate_rad_s, beyond_s))
            )
            if error_rad < by_rate_rad and start.restarted_s == end.restarted_s:
                before, after = start.rotation, end.rotation
                if config.dimension == 2:
                    # A ray in the plane turns with the heading; roll and pitch would bend it.
                    before, after = level_rotations(np.array([before, after]))
                return after.T @ before, error_rad
        return NOT_TURNED, by_rate_rad

    def newest(self, robot: str, stamp_s: float) -> OdometrySample | None:
        """Return the newest odometry of a robot up to a time; None without one."""
        readings = reversed(self.odometry.get(robot, ()))
        return next((reading for reading in readings if reading.stamp_s <= stamp_s), None)

    def turn_up_rad(self, point: str, first_s: float, second_s: float) -> float:
        """Return an upper bound of the angle by which `point` turned between two times."""
        rotation, half_width_rad = self.turn(point, first_s, second_s)
        return angle_up(sum_up(angle_up(rotation_angle_rad(rotation)), half_width_rad))


# Cached, since all readings of a robot at one time ask for the same value.
@lru_cache(maxsize=4096)
def most_between(rate: float, first_s: float, second_s: float, more_s: float) -> float:
    """Return an upper bound of the integral of a rate between two stamps."""
    elapsed_s = elapsed_up(first_s, second_s)
    return product_up(rate, sum_up(elapsed_s, more_s) if more_s else elapsed_s)


def greatest_errors(
    error: OdometryErrorModel, way_m: float, turned_rad: float
) -> tuple[float, float]:
    """Return the greatest errors of odometry along a path with turns, in m and in rad."""
    return (
        sum_up(
            product_up(error.translation_per_m, way_m),
            product_up(error.translation_per_rad, turned_rad),
            error.constant_m,
        ),
        sum_up(
            product_up(error.rotation_per_m, way_m),
            product_up(error.rotation_per_rad, turned_rad),
            error.constant_rad,
        ),
    )


def _rounding_up_m(first_m: np.ndarray, second_m: np.ndarray) -> float:
    """Return an upper bound of the change of a distance by the rounding of its two positions."""
    return rounding_error(max(map(abs, (*first_m.tolist(), *second_m.tolist()))), ROUNDED)


def _beyond_up_s(
    error: OdometryErrorModel,
    start: OdometrySample,
    end: OdometrySample,
    first_s: float,
    second_s: float,
) -> float:
    """Return an upper bound of the time between two times and the true times of two readings."""
    return sum_up(
        elapsed_up(start.stamp_s, first_s),
        elapsed_up(end.stamp_s, second_s),
        2.0 * error.latency_s,
    )


def way_between(first: OdometrySample, second: OdometrySample) -> tuple[float, float]:
    """Return upper bounds of the path length and the turns between two readings of a track."""
    if first is second:
        return 0.0, 0.0
    start, end = (first, second) if first.stamp_s <= second.stamp_s else (second, first)
    return sum_up(end.way_m, -start.way_m), sum_up(end.turned_rad, -start.turned_rad)


def _distance_up_m(first: np.ndarray, second: np.ndarray) -> float:
    """Return an upper bound of the distance of two positions."""
    # math.dist subtracts, which errs by half a unit, and is exact to one unit from there.
    return step_up(step_up(math.dist(first.tolist(), second.tolist())))


def _nearest(track: tuple[OdometrySample, ...], stamp_s: float) -> OdometrySample:
    """Return the reading whose stamp is nearest."""
    after = bisect_left(track, stamp_s, key=STAMP_S)
    around = track[max(0, after - 1) : after + 1]
    return min(around, key=lambda reading: abs(reading.stamp_s - stamp_s))
