# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The path of a robot in the plane as its odometry states it: its bodies now and before.

This is plain floating point for an estimate; proved bounds come from `fleet.odometry`. While
little is measured of a robot, its likeliest pose is that of an earlier fit, carried by its
odometry: a fit of the remaining window would lose information that the earlier fit had.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.terms import LEAST_HALF_WIDTH, STEP, TURN, UNIFORM, Terms
from dg_localization.fleet.estimate import Placement
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.memory import MOST_OBSERVATIONS

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

VARIANTS = 5
"""Variants of a path: as stated, and with each of four odometry errors along the whole path."""

STEP_ERROR = 1e-3
"""Least odometry error of a step, in m and in rad, even if its bounds are smaller."""


AXES = [0, 1, 5]
"""The rows of x, y and yaw in a covariance of position and rotation."""


class StatedWay:
    """The odometry of a robot since a time, thinned; `row` is its body of now."""

    def __init__(self, snapshot: Snapshot, robot: str, oldest_s: float, row: int) -> None:
        config = snapshot.config
        path = snapshot.carried.path(config.rows[robot])
        self._error = config.odometry_error_of(robot)
        self._limits = config.speed_m_s(robot), config.max_turn_rate_rad_s
        self.row, self._now_s, self._oldest_s = row, snapshot.stamp_s, oldest_s
        first = max(0, int(np.searchsorted(path.stamps_s, oldest_s)) - 1)
        stamps_s = path.stamps_s[first:]
        steps_s, known = np.diff(stamps_s), path.is_known[first:]
        self._sampled_s = stamps_s, np.append(0.0, np.cumsum(np.where(known, 0.0, steps_s)))
        # The path is straight between samples. Thin from the newest backward: it counts most.
        every = slice(None, None, -max(1, len(stamps_s) // MOST_OBSERVATIONS))
        self._stamps_s, poses = stamps_s[every][::-1], path.poses[first:][every][::-1]
        # Poses before the first odometry sample are unknown.
        self.since_s = max(oldest_s, float(self._stamps_s[0]))
        yaws_rad = np.unwrap(poses[:, 2])
        steps_m = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
        turns_rad = np.abs(np.diff(yaws_rad))
        self._sums = [np.append(0.0, np.cumsum(steps)) for steps in (steps_m, turns_rad)]
        self._variants = [*self._erring(poses[:, 0] + 1j * poses[:, 1], yaws_rad)]

    def place_bodies(self, first_past: int, count: int) -> None:
        """Give the robot bodies at `count` earlier times, numbered from `first_past`."""
        span_s = self._now_s - self._oldest_s
        self.times_s = self._now_s - np.linspace(0.0, span_s, count + 1)
        self._bodies = np.concatenate([[self.row], first_past + np.arange(count)])
        self._poses_of_bodies = self._poses(self.times_s)

    def ends(self, stamps_s: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """
        Return the bodies nearest to some times, and the pose at each time in their frames.

        The poses of all variants have the shape (v, m, 3). The last array, shape (m, 2), is the
        uncertainty from silent odometry, in m and rad.
        """
        nearest = np.abs(self.times_s[:, None] - stamps_s).argmin(axis=0)
        unknown = self._unknown_motion(stamps_s, self.times_s[nearest])
        poses = seen_from(self._poses_of_bodies[:, nearest], self._poses(stamps_s))
        return self._bodies[nearest], poses, unknown.T

    def poses_now(self, stamps_s: FloatArray) -> FloatArray:
        """Return the stated poses at some times relative to the pose now, shape (m, 3)."""
        poses = self._poses(np.append(self._now_s, stamps_s), 1)[0]
        return seen_from(poses[0], poses[1:])

    def steps(self) -> Terms:
        """Return the odometry terms between successive bodies, in all variants."""
        bodies = np.stack([self._bodies[:-1], self._bodies[1:]], axis=-1)
        between = seen_from(self._poses_of_bodies[:, :-1], self._poses_of_bodies[:, 1:])
        errors_m, errors_rad = self._errors(self.times_s)
        nothing = np.zeros((VARIANTS, len(bodies), 3))
        ends = np.stack([nothing, nothing], axis=-2)
        ends[:, :, 0, :2] = between[..., :2]
        axes = directions(between[..., 2])
        turned = packed(TURN, bodies, np.zeros_like(ends), axes, errors_rad)
        return Terms.joined([packed(STEP, bodies, ends, nothing, errors_m), turned])

    def whole(self) -> tuple[FloatArray, float, float]:
        """Return the pose now relative to the oldest one, and its errors in m and in rad."""
        times_s = np.array([self._now_s, self._oldest_s])
        now, then = self._poses(times_s, 1)[0]
        ((error_m,), (error_rad,)) = self._errors(times_s)
        # Both ends may be late, by different latencies.
        off_m, off_rad = self.constants()
        return seen_from(then, now), float(error_m + 2.0 * off_m), float(error_rad + 2.0 * off_rad)

    def constants(self) -> tuple[float, float]:
        """Return the odometry error at one time without drift along the path, in m and in rad."""
        speed_m_s, rate_rad_s = (limit if self._error.latency_s else 0.0 for limit in self._limits)
        late_s = self._error.latency_s
        constant_m = self._error.constant_m + late_s * speed_m_s
        return constant_m, self._error.constant_rad + late_s * rate_rad_s

    def _errors(self, times_s: FloatArray) -> FloatArray:
        """Return the errors between successive descending times, in m and rad, shape (2, m)."""
        error = self._error
        driven = [-np.diff(np.interp(times_s, self._stamps_s, sums)) for sums in self._sums]
        rates = [
            [error.translation_per_m, error.translation_per_rad],
            [error.rotation_per_m, error.rotation_per_rad],
        ]
        errors = rates @ np.array(driven) + self._unknown_motion(times_s[1:], times_s[:-1])
        errors += np.array([[error.constant_m], [error.constant_rad]])
        return np.maximum(errors, STEP_ERROR)

    def _erring(
        self, places_m: NDArray[np.complex128], yaws_rad: FloatArray
    ) -> Iterator[tuple[FloatArray, FloatArray, FloatArray, float]]:
        """
        Yield x, y and yaw of each variant, and its latency.

        The first is the stated path. In the others odometry errs to its bounds all the way.
        """
        error = self._error
        yield places_m.real, places_m.imag, yaws_rad, 0.0
        scaled_m = (1.0 + error.translation_per_m) * places_m
        yield scaled_m.real, scaled_m.imag, yaws_rad, 0.0
        for turns_rad in (error.rotation_per_rad * yaws_rad, error.rotation_per_m * self._sums[0]):
            steps_m = np.diff(places_m) * np.exp(0.5j * (turns_rad[1:] + turns_rad[:-1]))
            bent_m = np.append(0.0, np.cumsum(steps_m))
            yield bent_m.real, bent_m.imag, yaws_rad + turns_rad, 0.0
        yield places_m.real, places_m.imag, yaws_rad, error.latency_s

    def _poses(self, times_s: FloatArray, count: int = VARIANTS) -> FloatArray:
        """Return the poses of the first variants at times, clamped to the path, (v, m, 3)."""
        stamps_s = self._stamps_s
        return np.array(
            [
                [np.interp(times_s - late_s, stamps_s, column) for column in columns]
                for *columns, late_s in self._variants[:count]
            ]
        ).swapaxes(1, 2)

    def _unknown_motion(self, first_s: FloatArray, second_s: FloatArray) -> FloatArray:
        """
        Return the uncertainty of the motion while odometry was silent, in m and rad, shape (2, m).

        The robot may well have continued at full speed, so the greatest motion counts as a
        standard deviation, not as a half width.
        """
        silent_s = np.abs(self._silent_s(second_s) - self._silent_s(first_s))
        return np.multiply.outer(self._limits, math.sqrt(3.0) * silent_s)

    def _silent_s(self, times_s: FloatArray) -> FloatArray:
        """Return the silent time of odometry up to some times, also after its last message."""
        stamps_s, silent_s = self._sampled_s
        return np.interp(times_s, stamps_s, silent_s) + np.maximum(times_s - stamps_s[-1], 0.0)


def packed(
    kind: int, bodies: IntArray, arms_m: FloatArray, values: FloatArray, half_widths: FloatArray
) -> Terms:
    """Return terms of one kind."""
    weights = 1.0 / np.maximum(half_widths, LEAST_HALF_WIDTH)
    return Terms(np.full(len(bodies), kind), bodies, arms_m, values, weights)


def directions(angles_rad: FloatArray) -> FloatArray:
    """Return unit vectors in the plane, shape (..., 3)."""
    c, s = np.cos(angles_rad), np.sin(angles_rad)
    return np.stack([c, s, np.zeros_like(c)], axis=-1)


def seen_from(origins: FloatArray, poses: FloatArray) -> FloatArray:
    """Return poses (x, y, yaw) relative to origins, shape (..., 3)."""
    dx, dy, turn = np.moveaxis(poses - origins, -1, 0)
    c, s = np.cos(origins[..., 2]), np.sin(origins[..., 2])
    return np.stack([c * dx + s * dy, c * dy - s * dx, turn], axis=-1)


class LikelyPose(NamedTuple):
    """
    The likeliest pose of a robot in the plane among the anchors at a time.

    Parameters
    ----------
    stamp_s : float
    pose : numpy.ndarray, shape (3,)
        x, y and yaw.
    covariance : numpy.ndarray, shape (3, 3)

    """

    stamp_s: float
    pose: FloatArray
    covariance: FloatArray

    @property
    def variances(self) -> FloatArray:
        """The variances of x and y (m^2) and of the yaw (rad^2); infinite where unknown."""
        variances = np.diag(self.covariance)
        return np.where(np.isnan(self.pose) | np.isnan(variances), np.inf, variances)

    def is_better_than(self, other: LikelyPose) -> bool:
        """Return whether both the position and the yaw are known better than those of another."""
        mine, others = self.variances, other.variances
        return bool(mine[:2].sum() < others[:2].sum() and mine[2] < others[2])

    def agrees(self, snapshot: Snapshot, robot: str, box_m: FloatArray) -> bool:
        """Return whether the position is in a bounded box (2, q) and fits the ranges of now."""
        here_m, off_m = self.pose[:2], 3.0 * math.sqrt(self.variances[:2].sum())
        if not np.isfinite(box_m).all() or np.any((here_m < box_m[0]) | (here_m > box_m[1])):
            return False
        for _, place, distance in snapshot.ranges_of_anchors([robot]):
            apart_m = np.linalg.norm(0.5 * (place.lower + place.upper) - here_m)
            if not distance.lower_m - off_m <= apart_m <= distance.upper_m + off_m:
                return False
        return True

    def carried(self, snapshot: Snapshot, robot: str) -> LikelyPose | None:
        """Return the pose at the time of a snapshot; None if odometry does not reach back."""
        track = snapshot.motion.odometry.get(robot)
        if not track or not track[0].stamp_s <= self.stamp_s <= snapshot.stamp_s:
            return None
        way = StatedWay(snapshot, robot, self.stamp_s, 0)
        (dx, dy, turn_rad), error_m, error_rad = way.whole()
        x, y, yaw_rad = self.pose
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        dx, dy = c * dx - s * dy, s * dx + c * dy
        change = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
        # At worst the errors are equal along the whole step.
        off_m2 = (error_m**2 + (error_rad * math.hypot(dx, dy)) ** 2) / UNIFORM
        errors = np.diag([off_m2, off_m2, error_rad**2 / UNIFORM])
        return LikelyPose(
            snapshot.stamp_s,
            np.array([x + dx, y + dy, yaw_rad + turn_rad]),
            _sum_at_worst(change @ self.covariance @ change.T, errors),
        )


def carried_on(
    snapshot: Snapshot, placement: Placement, before: Mapping[str, LikelyPose]
) -> tuple[Placement, dict[str, LikelyPose]]:
    """
    Return a placement among anchors, and the likeliest poses of its robots.

    Where the pose of an earlier fit, carried to now by odometry, agrees with the enclosure and the
    readings of now and is known better than that of the last fit, it replaces that.
    """
    positions_m, covariances = placement.positions_m.copy(), placement.covariances
    yaws_rad, poses = placement.fitted_yaws_rad, dict[str, LikelyPose]()
    if covariances is None or yaws_rad is None:
        return placement, poses
    covariances, yaws_rad = covariances.copy(), yaws_rad.copy()
    for row, robot in enumerate(snapshot.config.robots):
        among = np.ix_([row], AXES, AXES)
        pose = np.array([*positions_m[row], yaws_rad[row]])
        fitted = LikelyPose(snapshot.stamp_s, pose, covariances[among][0])
        if np.isfinite(fitted.variances).all():
            poses[robot] = fitted
        carried = before[robot].carried(snapshot, robot) if robot in before else None
        if carried is None or not carried.agrees(snapshot, robot, placement.enclosure_m[row]):
            continue
        if carried.is_better_than(fitted):
            positions_m[row], yaws_rad[row] = carried.pose[:2], carried.pose[2]
            covariances[among] = carried.covariance
            poses[robot] = carried
        else:
            poses.setdefault(robot, carried)
    moved = not np.array_equal(positions_m, placement.positions_m, equal_nan=True)
    placement = replace(
        placement,
        positions_m=positions_m,
        covariances=covariances,
        fitted_yaws_rad=yaws_rad,
        proved=placement.proved and not moved,
    )
    return placement, poses


def _sum_at_worst(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return a bound of the covariance of the sum of two errors, however they correlate."""
    if not (first.any() and second.any()):
        return first + second
    share = math.sqrt(np.trace(second) / np.trace(first))
    return (1.0 + share) * first + (1.0 + 1.0 / share) * second
