# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The odometry frame of a robot: its pose there, placements in it, and rules for its use.

By definition the newest odometry states the true pose of the body in this frame. The motion that
is possible since then widens the answer.

A frame that changed with every estimate would be of no use. So an odometry frame is taken up when
the heading of the robot is known well. A frame is left when its inputs (odometry and a heading,
or bearings for a body frame) have been missing for `HOLD_S`. Until then answers stay in it:
unknown turns widen their bounds, and points are rotated to fit their earlier positions.
"""

from __future__ import annotations

from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.estimate import Estimate, FixedFrame, FrameKind, Placement
from dg_localization.fleet.rotations import (
    best_rotation,
    level_rotations,
    quaternion_of,
    rotation_of_quaternion,
)
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.interval.angles import angle_up, chord_up, rotation_2d
from dg_localization.interval.arrays import Interval, rotate
from dg_localization.interval.bounds import product_up, sum_up
from dg_localization.interval.environment import default_environment

FloatArray = NDArray[np.float64]

MOST_TILT_RAD = 0.2
"""An odometry frame with more tilt is not the frame of a robot in the plane."""


TAKEN_UP_RAD = math.pi / 8.0
LEFT_RAD = math.pi / 4.0
"""Half widths of the heading: up to the first a frame is taken up, beyond the other it is
missing."""

HOLD_S = 2.0
"""Time for which a frame is kept without its inputs, and for which an odometry frame must be good
before it is taken up after one was left."""

_RANKS = {FrameKind.ROBOTS: 0, FrameKind.HEADING: 1, FrameKind.ODOMETRY: 2}


class BodyPose(NamedTuple):
    """
    The pose of a robot in its odometry frame at the time of an estimate.

    Parameters
    ----------
    frame : FixedFrame
    position_m : numpy.ndarray, shape (q,)
    rotation : numpy.ndarray, shape (3, 3)
        From body to odometry frame; in the plane about the vertical axis alone.
    error_m, error_rad : float
        Bounds of the errors of position and rotation.

    """

    frame: FixedFrame
    position_m: FloatArray
    rotation: FloatArray
    error_m: float
    error_rad: float


class FrameTurn(NamedTuple):
    """
    The rotation from the frame of a placement to the odometry frame.

    Parameters
    ----------
    rotation : numpy.ndarray, shape (3, 3)
        The middle of the bounds.
    half_width_rad : float
        Greatest angle to the true rotation.
    best_rotation : numpy.ndarray, shape (3, 3)
        The rotation by the heading of the best point; within the bounds.
    best_deviation_rad : float
        Standard deviation of the best rotation; the half width if no heading was fitted.

    """

    rotation: FloatArray
    half_width_rad: float
    best_rotation: FloatArray
    best_deviation_rad: float


def body_pose(snapshot: Snapshot, robot: str, more_s: float = 0.0) -> BodyPose | None:
    """Return the pose of a robot in its odometry frame at the time of a snapshot."""
    config, now_s = snapshot.config, snapshot.stamp_s
    last = snapshot.motion.newest(robot, now_s)
    if last is None or not last.frame or now_s - last.stamp_s > config.max_age_s + more_s:
        return None
    position_m = last.position_in_frame_m
    moved_m = snapshot.motion.displacement_m(robot, last.stamp_s, now_s)
    turn, turned_rad = snapshot.motion.turn(robot, last.stamp_s, now_s)
    # The stated pose may have been the true one that much before or after its stamp.
    latency_s = config.odometry_error_of(robot).latency_s
    rotation = last.rotation
    if config.dimension == 2:
        if rotation[2, 2] < math.cos(MOST_TILT_RAD):
            return None
        rotation = level_rotations(rotation[None])[0]
    return BodyPose(
        FixedFrame(FrameKind.ODOMETRY, (robot,), last.frame, last.restarted_s),
        position_m[: config.dimension],
        rotation @ turn.T,
        sum_up(moved_m, product_up(config.speed_m_s(robot), latency_s)),
        angle_up(sum_up(turned_rad, product_up(config.max_turn_rate_rad_s, latency_s))),
    )


def frame_turn(placement: Placement, row: int, pose: BodyPose) -> FrameTurn | None:
    """Return the rotation from the frame of a placement to the odometry frame of a robot."""
    if not placement.heading_known[row]:
        return None
    own = rotation_of_quaternion(placement.orientations_xyzw[row])
    best = rotation_of_quaternion(placement.best_headings[0][row])
    half_width_rad = angle_up(float(placement.heading_half_width_rad[row]) + pose.error_rad)
    deviation_rad = _fitted_deviation_rad(placement, row)
    return FrameTurn(
        pose.rotation @ own.T,
        half_width_rad,
        pose.rotation @ best.T,
        half_width_rad if deviation_rad is None else math.hypot(deviation_rad, pose.error_rad),
    )


def in_odometry_frame(
    placement: Placement, row: int, pose: BodyPose, turn: FrameTurn
) -> Placement:
    """Return a placement in the odometry frame of a robot."""
    q = len(pose.position_m)
    best_axes = turn.best_rotation[:q, :q]
    enclosure_m = _moved(placement.enclosure_m, pose, turn)
    landmark_enclosure_m = _moved(placement.landmark_enclosure_m, pose, turn)
    half_widths_rad = angle_up(placement.heading_half_width_rad + turn.half_width_rad)
    half_widths_rad[row] = angle_up(pose.error_rad)
    known = placement.heading_known & (half_widths_rad < math.pi)
    known[row] = half_widths_rad[row] < math.pi
    orientations = np.full(placement.orientations_xyzw.shape, np.nan)
    for robot in np.flatnonzero(known):
        body = rotation_of_quaternion(placement.orientations_xyzw[robot])
        stated = pose.rotation if robot == row else turn.rotation @ body
        orientations[robot] = quaternion_of(stated)
    fitted_yaws_rad = placement.fitted_yaws_rad
    if fitted_yaws_rad is not None:
        fitted_yaws_rad = fitted_yaws_rad + math.atan2(best_axes[1, 0], best_axes[0, 0])
        # The frame fixes the heading of the robot: odometry states it.
        fitted_yaws_rad[row] = np.nan
    positions_m = placement.positions_m @ best_axes.T + pose.position_m
    landmarks_m = placement.landmarks_m @ best_axes.T + pose.position_m
    return replace(
        placement,
        positions_m=np.clip(positions_m, enclosure_m[:, 0], enclosure_m[:, 1]),
        enclosure_m=enclosure_m,
        orientations_xyzw=orientations,
        heading_known=known,
        heading_half_width_rad=np.where(known, half_widths_rad, math.pi),
        landmarks_m=np.clip(landmarks_m, landmark_enclosure_m[:, 0], landmark_enclosure_m[:, 1]),
        landmark_enclosure_m=landmark_enclosure_m,
        covariances=_moved_covariances(placement, row, pose, turn),
        fitted_yaws_rad=fitted_yaws_rad,
    )


def _fitted_deviation_rad(placement: Placement, row: int) -> float | None:
    """Return the standard deviation of a heading, at most its bound; None if it was not fitted."""
    yaws_rad, covariances = placement.fitted_yaws_rad, placement.covariances
    if yaws_rad is None or covariances is None:
        return None
    variance_rad2 = float(covariances[row, 5, 5])
    if not (np.isfinite(yaws_rad[row]) and variance_rad2 > 0.0):
        return None
    return min(math.sqrt(variance_rad2), float(placement.heading_half_width_rad[row]))


def _moved(boxes_m: FloatArray, pose: BodyPose, turn: FrameTurn) -> FloatArray:
    """Return boxes, shape (n, 2, q), in the odometry frame; boxes with an open side are open."""
    if len(boxes_m) == 0:
        return boxes_m
    bounded = np.asarray(np.isfinite(boxes_m).all(axis=(1, 2)))
    known = np.where(bounded[:, None, None], boxes_m, 0.0)
    origin = Interval.around(pose.position_m[None, :], pose.error_m)
    moved = rotate(_axes(turn, boxes_m.shape[2]), Interval(known[:, 0], known[:, 1]))
    moved = moved + origin
    result = np.stack([moved.lower, moved.upper], axis=1)
    result[~bounded, 0], result[~bounded, 1] = -np.inf, np.inf
    return np.asarray(result)


def _axes(turn: FrameTurn, dimension: int) -> Interval:
    """Return bounds of the rotation, shape (q, q)."""
    rotation, half_width_rad = turn.rotation, angle_up(turn.half_width_rad)
    if dimension == 2:
        return rotation_2d(math.atan2(rotation[1, 0], rotation[0, 0]), half_width_rad)
    return Interval.around(rotation, chord_up(min(math.pi, half_width_rad)))


def _moved_covariances(
    placement: Placement, row: int, pose: BodyPose, turn: FrameTurn
) -> FloatArray | None:
    """
    Return covariances in the odometry frame, shape (n, 6, 6).

    Least squares does not model the newest odometry, so its bounds count as deviations. An error
    of the rotation moves distant points at right angles to the line from the robot.
    """
    if placement.covariances is None:
        return None
    q = len(pose.position_m)
    turning = np.zeros((6, 6))
    turning[:3, :3] = turning[3:, 3:] = turn.best_rotation
    found = turning @ placement.covariances @ turning.T
    arms_m = np.zeros((len(found), 3))
    arms_m[:, :q] = placement.positions_m @ turn.best_rotation[:q, :q].T
    for axis in np.eye(3)[2:] if q == 2 else np.eye(3):
        swing = np.concatenate([np.cross(axis, arms_m), np.tile(axis, (len(found), 1))], axis=1)
        found += turn.best_deviation_rad**2 * swing[:, :, None] * swing[:, None, :]
    # The odometry states the orientation of the robot.
    found[row] = 0.0
    turns = slice(5, 6) if q == 2 else slice(3, 6)
    found[row, turns, turns] = pose.error_rad**2 * np.eye(len(found[row, turns]))
    places = np.arange(q)
    found[:, places, places] += pose.error_m**2
    return np.asarray(found)


class StandingFrame:
    """Transforms estimates to the odometry frame of the reference robot while that is known."""

    def __init__(self) -> None:
        self._in_use: FixedFrame | None = None
        self._met_s = -math.inf
        self._candidate: FixedFrame | None = None
        self._candidate_since_s = 0.0
        self._wait_s = 0.0
        # Positions of the robots in the frame, by the number of the hypothesis.
        self._before: dict[int, NDArray[np.float64]] = {}
        self._before_s = 0.0

    @default_environment()
    def turn(self, snapshot: Snapshot, estimate: Estimate) -> Estimate:
        """Return an estimate in the frame in use; groups keep their own frames."""
        frame, now_s = estimate.frame, snapshot.stamp_s
        if frame is None or not estimate.placements or frame.kind not in _RANKS:
            return estimate
        turned = self._turned(snapshot, estimate, frame)
        found = estimate if turned is None else turned
        if found.frame == self._in_use:
            return self._used(now_s, found)
        if self._in_use is not None:
            is_lower = found.frame and _RANKS[found.frame.kind] < _RANKS[self._in_use.kind]
            held = self._held(snapshot, estimate, self._in_use) if is_lower else None
            if held is not None:
                return self._noted(now_s, held)
            if self._in_use.kind is FrameKind.ODOMETRY:
                self._wait_s = HOLD_S
                self._in_use = None
        wanted = None if turned is None else turned.frame
        if wanted != self._candidate:
            self._candidate, self._candidate_since_s = wanted, now_s
        if turned is not None and now_s - self._candidate_since_s >= self._wait_s:
            return self._used(now_s, turned)
        return self._used(now_s, estimate)

    def _used(self, now_s: float, estimate: Estimate) -> Estimate:
        """Return an estimate whose frame has its inputs, and record its time."""
        self._in_use, self._met_s = estimate.frame, now_s
        return self._noted(now_s, estimate)

    def _noted(self, now_s: float, estimate: Estimate) -> Estimate:
        """Return an estimate, and record the positions of its robots."""
        self._before = {one.number: one.positions_m for one in estimate.placements}
        self._before_s = now_s
        return estimate

    def _turned(
        self, snapshot: Snapshot, estimate: Estimate, frame: FixedFrame
    ) -> Estimate | None:
        """Return an estimate in the odometry frame; None if it is not known well enough."""
        pose = body_pose(snapshot, frame.points[0])
        if pose is None:
            return None
        limit_rad = LEFT_RAD if pose.frame == self._in_use else TAKEN_UP_RAD
        row = estimate.robots.index(frame.points[0])
        placements = []
        for placement in estimate.placements:
            turn = frame_turn(placement, row, pose)
            if turn is None or turn.half_width_rad > limit_rad:
                return None
            placements.append(in_odometry_frame(placement, row, pose, turn))
        return replace(estimate, placements=tuple(placements), frame=pose.frame)

    def _held(self, snapshot: Snapshot, estimate: Estimate, frame: FixedFrame) -> Estimate | None:
        """Return an estimate in a frame with missing inputs; None if the frame must be left."""
        origin, missing_s = frame.points[0], snapshot.stamp_s - self._met_s
        if estimate.frame is None or estimate.frame.points[0] != origin:
            return None
        if not 0.0 <= missing_s < HOLD_S:
            return None
        dimension = snapshot.config.dimension
        pose: BodyPose | None = BodyPose(frame, np.zeros(dimension), np.eye(3), 0.0, 0.0)
        if frame.kind is FrameKind.ODOMETRY:
            pose = body_pose(snapshot, origin, HOLD_S)
        if pose is None or pose.frame != frame:
            return None
        row = estimate.robots.index(origin)
        return replace(
            estimate,
            placements=tuple(
                in_odometry_frame(
                    one,
                    row,
                    pose,
                    frame_turn(one, row, pose) or self._turn_as_before(snapshot, one, row, frame),
                )
                for one in estimate.placements
            ),
            frame=frame,
        )

    def _turn_as_before(
        self, snapshot: Snapshot, placement: Placement, row: int, frame: FixedFrame
    ) -> FrameTurn:
        """Return the rotation that moves robots nearest to their earlier positions, unbounded."""
        rotation, q = np.eye(3), snapshot.config.dimension
        before = self._before.get(placement.number, next(iter(self._before.values()), None))
        if before is not None:
            now_m, before_m = (
                placement.positions_m - placement.positions_m[row],
                before - before[row],
            )
            known = np.isfinite(now_m).all(axis=1) & np.isfinite(before_m).all(axis=1)
            if frame.kind is FrameKind.HEADING:
                since = snapshot.motion.turn(frame.points[0], self._before_s, snapshot.stamp_s)[0]
                before_m = before_m @ since[:q, :q].T
            rotation[:q, :q] = best_rotation(now_m[known], before_m[known])
        return FrameTurn(rotation, math.pi, rotation, math.pi)
