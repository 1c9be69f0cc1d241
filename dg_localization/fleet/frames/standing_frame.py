# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The choice of a frame that stands still: when placements are turned into an odometry frame.

A frame that came and went with every estimate would be of no use. So an odometry frame is taken up
when the heading of the robot is known well. A frame is left when what it needs, which is odometry
and a heading, or bearings for a body frame, has been missing for `HOLD_S`. Until then answers go
on in it: what is not known widens their bounds, and points are turned as they lay before.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.directions import best_rotation
from dg_localization.fleet.estimate import Estimate, FixedFrame, FrameKind, Placement
from dg_localization.fleet.frames.odometry_frame import (
    BodyPose,
    FrameTurn,
    body_pose,
    frame_turn,
    in_odometry_frame,
)
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.interval.environment import default_environment

TAKEN_UP_RAD = math.pi / 8.0
LEFT_RAD = math.pi / 4.0
"""Half widths of the heading: up to the first a frame is taken up, beyond the other it is
missing."""

HOLD_S = 2.0
"""How long a frame is kept without what it needs, and how long an odometry frame has to be good,
once one was left, before one is taken up again."""

_RANKS = {FrameKind.ROBOTS: 0, FrameKind.HEADING: 1, FrameKind.ODOMETRY: 2}


class StandingFrame:
    """Turns estimates into the odometry frame of the reference robot while that is known."""

    def __init__(self) -> None:
        self._in_use: FixedFrame | None = None
        self._met_s = -math.inf
        self._candidate: FixedFrame | None = None
        self._candidate_since_s = 0.0
        self._wait_s = 0.0
        # Where the robots were in the frame, by the number of the hypothesis.
        self._before: dict[int, NDArray[np.float64]] = {}
        self._before_s = 0.0

    @default_environment()
    def turn(self, snapshot: Snapshot, estimate: Estimate) -> Estimate:
        """Return an estimate in the frame that it goes on in; groups keep frames of their own."""
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
        """Return an estimate that has what its frame needs."""
        self._in_use, self._met_s = estimate.frame, now_s
        return self._noted(now_s, estimate)

    def _noted(self, now_s: float, estimate: Estimate) -> Estimate:
        """Return an estimate, and keep where its robots are."""
        self._before = {one.number: one.positions_m for one in estimate.placements}
        self._before_s = now_s
        return estimate

    def _turned(
        self, snapshot: Snapshot, estimate: Estimate, frame: FixedFrame
    ) -> Estimate | None:
        """Return an estimate in the odometry frame; None where that is not known well enough."""
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
        """Return an estimate in a frame that lacks something; None once it has to be left."""
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
        """Return the turn that lays robots nearest to where they were; it bounds nothing."""
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
