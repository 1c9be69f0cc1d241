# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Odometry as bounded motion: past poses of a robot relative to its pose now.

Step i of a track errs by a_i in m and by b_i in rad at most. Seen from now, an error of the turn
at step i swings all earlier positions: a past position moves by b_i |S_i| at most, at right angles
to S_i, the vector from it to the end of step i. So heading error grows into position error with
the distance to where it arose, not with the length of the path. Summation by parts makes that
exact: with r_i the steps and E_i the error of the turn from step i to now,

    sum R(E_i) r_i  =  sum r_i  +  sum (R(E_i) - R(E_i+1)) S_i.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dg_localization.fleet.odometry_error import OdometryErrorModel, most_up, step_errors
from dg_localization.fleet.odometry_kernels import spans_around, step_angles, walk_back
from dg_localization.fleet.rotations import rotations_about_z, steepness
from dg_localization.interval.angles import angle_up, chord_up
from dg_localization.interval.arrays import Interval, elapsed_up, up
from dg_localization.interval.rounding import rounding_error
from dg_localization.poses import PastPoses
from dg_localization.poses.turns import turned

ROUNDED = 16
"""Floating-point operations that move a sample to the end of the track before a restart."""


class MotionLimits(NamedTuple):
    """Greatest speed and turn rate of a robot: they bound its motion between and after samples."""

    speed_m_s: float = math.inf
    turn_rate_rad_s: float = math.inf


class TrackStep(NamedTuple):
    """
    The pose of a track relative to an earlier sample of it, or of its robot relative to the track.

    The single pose includes the errors of the turns. The errors of translation are in the ball:
    they move the pose by at most its radius, in any direction.
    """

    pose: PastPoses
    ball_m: float


class _Nearest(NamedTuple):
    """The samples nearest to some times, and bounds of the distance of the robot from them."""

    samples: np.ndarray
    offset_m: np.ndarray
    offset_rad: np.ndarray
    rotation_rad: np.ndarray
    steepness: np.ndarray


class OdometryPath:
    """
    The path of one robot through its odometry samples.

    Between two samples, apart from constant errors, the robot is assumed to be no farther from
    either than their true distance, or than its limits allow. Before the first sample, after the
    last one and where samples are missing, only its limits bound its motion. Without limits the
    robot is at a sample if the time is the same number.

    Parameters
    ----------
    stamps_s : array_like, shape (n,)
        Increasing.
    positions_m : array_like, shape (n, 3)
        In the odometry frame, whose z axis is upright.
    rotations : array_like, shape (n, 3, 3)
        From body to odometry frame.
    error : OdometryErrorModel
    limits : MotionLimits, optional
    dimension : {2, 3}, optional
        In the plane roll, pitch and their errors do not count; heights are part of the way.
    restarts : mapping of int to (float, float), optional
        In the plane, the samples at which positions and headings change to another frame, with
        bounds of the motion from the sample before, in m and in rad.

    Attributes
    ----------
    stamps_s : numpy.ndarray, shape (n,)
        The times of the samples.
    poses : numpy.ndarray, shape (n, 3)
        x, y and yaw of the samples, continued across restarts.
    is_known : numpy.ndarray of bool, shape (n - 1,)
        Whether samples bound the motion of each step, not the limits alone.

    """

    def __init__(
        self,
        stamps_s: ArrayLike,
        positions_m: ArrayLike,
        rotations: ArrayLike,
        error: OdometryErrorModel,
        limits: MotionLimits | None = None,
        dimension: int = 2,
        restarts: Mapping[int, tuple[float, float]] = MappingProxyType({}),
    ) -> None:
        self.stamps_s = np.array(stamps_s, dtype=float)
        self._positions_m = np.array(positions_m, dtype=float).reshape(-1, 3)
        self._rotations = np.array(rotations, dtype=float).reshape(-1, 3, 3)
        self._error, self._limits = error, limits or MotionLimits()
        steps_s = np.diff(self.stamps_s)
        self._level = dimension == 2
        self._yaws_rad = np.arctan2(self._rotations[:, 1, 0], self._rotations[:, 0, 0])
        self._restarts = restarts
        self._size_m = float(np.abs(self._positions_m).max())
        self._join_at_restarts()
        self._tilt_rad = 0.0 if self._level else error.least_tilt_rad
        if self._level:
            self._rotations = rotations_about_z(self._yaws_rad)
        # Errors in m and in rad, and whether samples are missing.
        self._steps = self._steps_between(steps_s > error.max_gap_s)
        self.is_known = self._steps[2] == 0.0
        self.poses = np.column_stack([self._positions_m[:, :2], self._yaws_rad])

    def past_poses(self, times_s: ArrayLike, now_s: float, *, on_track: bool = False) -> PastPoses:
        """
        Return the level frames of the robot at past times, relative to its level frame now.

        With `on_track` they are relative to the pose of the track now: the constant errors of now
        are equal for all times, so a result from all of them is widened by these errors only once
        (`off_track`).

        Parameters
        ----------
        times_s : array_like, shape (m,)
            Not after now.
        now_s : float
        on_track : bool, optional

        Returns
        -------
        PastPoses
            Unbounded if neither samples nor limits bound the motion.

        Raises
        ------
        ValueError
            If a time lies after now.

        """
        times = np.asarray(times_s, dtype=float)
        if np.any(times > now_s):
            raise ValueError(f'{times.max()} s lies after now, {now_s} s')
        then, now = self._nearest(times), self._nearest(np.array([now_s]))
        last = int(now.samples[0])
        position, yaw = self._walk_back(np.minimum(then.samples, last), last)
        then_m, then_rad = self._off_track(then)
        position = position + self._ball(then_m)
        if on_track:
            return PastPoses(position, yaw + Interval(-then_rad, then_rad))
        now_m, now_rad = self._off_track(now)
        yaw_now = Interval(-now_rad, now_rad)
        # Any two headings differ by the constant error at most: the one of now covers both.
        yaw = yaw + Interval(-then.offset_rad, then.offset_rad) - yaw_now
        return PastPoses(turned(-yaw_now, position + self._ball(now_m)), yaw)

    def sample_s(self, time_s: float) -> float:
        """Return the stamp of the sample nearest to a time."""
        return float(self.stamps_s[self._index_at(time_s)])

    def track_step(self, first_s: float, last_s: float) -> TrackStep:
        """
        Return the pose of the track at the sample nearest to `last_s`, relative to `first_s`.

        The last time is not earlier than the first. The step is a walk back along the reversed
        track. Seen from the start, an error of a turn swings the positions after the end of its
        step: reversed, it belongs to the step before.
        """
        first, last = self._index_at(first_s), self._index_at(last_s)
        count, now_rad = last - first, self._yaws_rad[first]
        positions = np.ascontiguousarray(self._positions_m[first : last + 1][::-1])
        errors_rad = np.ascontiguousarray(self._steps[1, first:last][::-1])
        errors = np.zeros(count), np.append(errors_rad[1:], 0.0)[:count]
        position, turns = self._walked(positions, now_rad, errors, np.zeros(1, np.int64), count)
        turn_rad = angle_up(up(turns + errors_rad[:1].sum()))
        yaw = Interval.around(self._yaws_rad[[last]] - now_rad, turn_rad)
        return TrackStep(
            PastPoses(position, yaw), float(up(math.fsum(self._steps[0, first:last])))
        )

    def off_track(self, now_s: float) -> TrackStep:
        """Return the pose of the robot relative to the pose of its track now."""
        now = self._nearest(np.array([now_s]))
        end_m, end_rad = self._off_track(now)
        yaw = Interval(-end_rad, end_rad)
        return TrackStep(PastPoses(PastPoses.at_rest(1).position_m, yaw), float(end_m[0]))

    def track_back(self, first_s: float, last_s: float) -> PastPoses:
        """Return the inverse of `track_step`: the first pose relative to the last."""
        first, last = self._index_at(first_s), self._index_at(last_s)
        return PastPoses(*self._walk_back(np.array([first]), last))

    def leveled_points(self, times_s: ArrayLike, points_m: Interval) -> Interval:
        """
        Return points of the body in its level frames at some times, shape (m, 3).

        Points are in the body frame; boxes of sensors include the bounds of their places.
        """
        tilts, errors_rad = self.tilts(times_s)
        columns = [Interval.point(tilts[:, :, k]) * points_m[:, k][:, None] for k in range(3)]
        squares = points_m.square()
        length = (squares[:, 0] + squares[:, 1] + squares[:, 2]).sqrt().upper
        chords = np.array([chord_up(error) for error in errors_rad])
        swing = up(chords * length)[:, None]
        return columns[0] + columns[1] + columns[2] + Interval(-swing, swing)

    def leveled_rays(
        self, times_s: ArrayLike, directions: ArrayLike, errors_rad: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return rays of the body in its level frames at some times, and their errors.

        `directions`, shape (m, 3), are in the body frame; errors are the greatest angles to the
        true directions.
        """
        tilts, tilt_errors_rad = self.tilts(times_s)
        leveled = np.einsum('mij,mj->mi', tilts, np.asarray(directions, dtype=float))
        return leveled, angle_up(up(np.asarray(errors_rad, dtype=float) + tilt_errors_rad))

    def _join_at_restarts(self) -> None:
        """Move the samples after each restart of the odometry to the sample before it."""
        for first in self._restarts:
            turn_rad = self._yaws_rad[first - 1] - self._yaws_rad[first]
            turned_m = self._positions_m[first:] - self._positions_m[first]
            turned_m = turned_m @ rotations_about_z(np.array([turn_rad]))[0].T
            self._positions_m[first:] = turned_m + self._positions_m[first - 1]
            yaws_rad = self._yaws_rad[first:] + turn_rad
            self._yaws_rad[first:] = np.arctan2(np.sin(yaws_rad), np.cos(yaws_rad))

    def _steps_between(self, missing: np.ndarray) -> np.ndarray:
        """Return the greatest errors of every step, and whether samples are missing."""
        ends = Interval.point(self._positions_m)
        squares = (ends[1:] - ends[:-1]).square()
        lengths = (squares[:, 0] + squares[:, 1] + squares[:, 2]).sqrt().upper
        angles = np.empty(len(lengths))
        step_angles(self._rotations, angles)
        angles = np.where(angles > 0.0, angle_up(angles), 0.0)
        # If samples are missing, the path may be longer.
        steps_s = elapsed_up(self.stamps_s[:-1], self.stamps_s[1:])
        missing_s = np.where(missing, up(steps_s + 2.0 * self._error.latency_s), 0.0)
        lengths = np.maximum(lengths, most_up(self._limits.speed_m_s, missing_s))
        angles = np.maximum(angles, most_up(self._limits.turn_rate_rad_s, missing_s))
        errors_m, errors_rad = step_errors(self._error, lengths, angles)
        # An error of a turn swings the path after it, here also within the step.
        swings_m = most_up(np.where(missing, np.minimum(errors_rad, 2.0), 0.0), lengths)
        errors_m = up(errors_m + swings_m)
        if count := len(self._restarts):
            # Each restart moved the samples after it by twice the size at most, with rounding.
            size_m = (2.0 * count + 1.0) * self._size_m
            errors_m = up(errors_m + rounding_error(size_m, ROUNDED * count))
            errors_rad = up(errors_rad + rounding_error(math.pi, ROUNDED * count))
        for first, (most_m, most_rad) in self._restarts.items():
            errors_m[first - 1], errors_rad[first - 1] = most_m, most_rad
            missing[first - 1] = True
        return np.stack([errors_m, errors_rad, missing])

    def _index_at(self, time_s: float) -> int:
        """Return the sample nearest to a time."""
        return int(self._indices_at(np.array([time_s]))[0])

    def _indices_at(self, times_s: np.ndarray) -> np.ndarray:
        """Return the samples nearest to some times, the earlier one of two that are as near."""
        stamps_s = self.stamps_s
        after = np.minimum(np.searchsorted(stamps_s, times_s), len(stamps_s) - 1)
        before = np.maximum(after - 1, 0)
        is_after = np.abs(stamps_s[after] - times_s) < np.abs(stamps_s[before] - times_s)
        return np.where(is_after, after, before)

    def _nearest(self, times_s: np.ndarray) -> _Nearest:
        """Return the samples nearest to some times."""
        stamps_s, limits, latency_s = self.stamps_s, self._limits, self._error.latency_s
        slack_s = 0.0
        if latency_s > 0.0 or (limits.speed_m_s < math.inf and limits.turn_rate_rad_s < math.inf):
            # Equal numbers need not be equal times (`elapsed_up`).
            largest_s = np.abs([*stamps_s[[0, -1]], *times_s]).max()
            slack_s = 4.0 * float(elapsed_up(largest_s, largest_s))
        around_s = up(latency_s + slack_s) if slack_s > 0.0 else latency_s
        low = np.searchsorted(stamps_s, times_s - around_s, side='right') - 1
        high = np.searchsorted(stamps_s, times_s + around_s, side='left')
        low, high = np.maximum(low, 0), np.minimum(high, len(stamps_s) - 1)
        # Differences of times are rounded: the nearest sample by these may be another one.
        index = np.clip(self._indices_at(times_s), low, high)
        samples = np.stack([index, low, high])
        spans = np.empty(samples.shape)
        spans_around(
            self._positions_m, self._yaws_rad, self._rotations, self._steps, samples, spans
        )
        reach_s = up(elapsed_up(times_s, stamps_s[index]) + latency_s)
        first_s, last_s = times_s - latency_s, times_s + latency_s
        beyond = (first_s < stamps_s[0]) | (last_s > stamps_s[-1])
        at_end = (first_s <= stamps_s[0] + slack_s) | (last_s >= stamps_s[-1] - slack_s)

        def within(spans: np.ndarray, rate: float | np.ndarray) -> np.ndarray:
            """Return how far a robot may be from a sample: no farther than its limit lets it."""
            limited = up(rate * reach_s)
            by_limit = beyond | (at_end & (limited < math.inf))
            return np.where(by_limit, limited, np.minimum(spans, limited))

        rotation_rad, steep = within(spans[2], limits.turn_rate_rad_s), np.ones(len(index))
        if not self._level:
            steep = steepness(self._rotations[index], up(rotation_rad + self._tilt_rad))
        yaw_rad = within(spans[1], up(limits.turn_rate_rad_s * steep))
        return _Nearest(index, within(spans[0], limits.speed_m_s), yaw_rad, rotation_rad, steep)

    def _off_track(self, near: _Nearest) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of the offset of the robot from its track at times, in m and rad."""
        # Headings cannot be centered like positions: turning them alone gives no track.
        off_rad = angle_up(up(near.offset_rad + self._error.constant_rad))
        return up(near.offset_m + self._error.centered_m), off_rad

    def _walk_back(self, then: np.ndarray, last: int) -> tuple[Interval, Interval]:
        """Return the poses of samples relative to sample `last`, with the errors of the path."""
        now_rad, errors = self._yaws_rad[last], (self._steps[0], self._steps[1])
        position, turns = self._walked(self._positions_m, now_rad, errors, then, last)
        return position, Interval.around(self._yaws_rad[then] - now_rad, angle_up(turns))

    def _walked(
        self,
        positions: np.ndarray,
        yaw: float,
        errors: tuple[np.ndarray, np.ndarray],
        then: np.ndarray,
        last: int,
    ) -> tuple[Interval, np.ndarray]:
        """Return samples of a track relative to sample `last`, and the errors of their yaws."""
        (center, half), turns = np.empty((2, len(then), 3)), np.empty(len(then))
        walk_back(positions, yaw, *errors, then, last, center, half, turns)
        # Positions too large for a subtraction bound nothing.
        known = np.isfinite(center) & np.isfinite(half)
        bounds = Interval.around(np.where(known, center, 0.0), np.where(known, half, np.inf))
        if self._level:
            bounds.lower[:, 2] = bounds.upper[:, 2] = 0.0
        return bounds, turns

    def tilts(self, times_s: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the rotations from body to level frame at some times, and their errors.

        Their shapes are (m, 3, 3) and (m,); errors are angles of at most a half turn.
        """
        near = self._nearest(np.asarray(times_s, dtype=float))
        yaws = self._yaws_rad[near.samples]
        moved_rad = up(near.steepness * near.rotation_rad)
        errors_rad = angle_up(up(moved_rad + self._tilt_rad))
        return rotations_about_z(-yaws) @ self._rotations[near.samples], np.minimum(
            errors_rad, math.pi
        )

    def _ball(self, radius_m: np.ndarray) -> Interval:
        """Return the boxes around balls, flat in the plane, shape (m, 3)."""
        half = np.tile(radius_m[:, None], 3)
        half[:, 2] = 0.0 if self._level else radius_m
        return Interval(-half, half)
