# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The choice of a frame that stands still: when placements are turned into an odometry frame.

A frame that came and went with every estimate would be of no use. So it is taken up when the
heading of the robot is known well, and left when it is known badly or the odometry ends.
"""

from __future__ import annotations

from dataclasses import replace
import math

from dg_localization.fleet.estimate import Estimate, FixedFrame, FrameKind
from dg_localization.fleet.frames.odometry_frame import (
    body_pose,
    frame_turn,
    in_odometry_frame,
)
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.interval.environment import default_environment

TAKEN_UP_RAD = math.pi / 8.0
LEFT_RAD = math.pi / 4.0
"""Half widths of the heading: up to the first a frame is taken up, beyond the other it is left."""

WAIT_S = 2.0
"""How long a frame has to be good, once one was left, before one is taken up again."""

_BODY_FRAMES = (FrameKind.HEADING, FrameKind.ROBOTS)


class StandingFrame:
    """Turns estimates into the odometry frame of the reference robot while that is known."""

    def __init__(self) -> None:
        self._in_use: FixedFrame | None = None
        self._candidate: FixedFrame | None = None
        self._candidate_since_s = 0.0
        self._wait_s = 0.0

    @default_environment()
    def turn(self, snapshot: Snapshot, estimate: Estimate) -> Estimate:
        """Return an estimate in the odometry frame of its origin, or as it is."""
        if estimate.frame is None or not estimate.placements:
            return estimate
        turned = self._turned(snapshot, estimate)
        found = None if turned is None else turned.frame
        if found is not None and found == self._in_use:
            return turned or estimate
        if self._in_use is not None:
            self._in_use = None
            self._wait_s = WAIT_S
        if found != self._candidate:
            self._candidate, self._candidate_since_s = found, snapshot.stamp_s
        waited_s = snapshot.stamp_s - self._candidate_since_s
        if turned is None or waited_s < self._wait_s:
            return estimate
        self._in_use = found
        return turned

    def _turned(self, snapshot: Snapshot, estimate: Estimate) -> Estimate | None:
        """Return an estimate in the odometry frame; None where that is not known well enough."""
        if estimate.frame is None or estimate.frame.kind not in _BODY_FRAMES:
            return None
        origin = estimate.frame.points[0]
        pose = body_pose(snapshot, origin)
        if pose is None:
            return None
        limit_rad = LEFT_RAD if pose.frame == self._in_use else TAKEN_UP_RAD
        row = estimate.robots.index(origin)
        placements = []
        for placement in estimate.placements:
            turn = frame_turn(placement, row, pose)
            if turn is None or turn.half_width_rad > limit_rad:
                return None
            placements.append(in_odometry_frame(placement, row, pose, turn))
        return replace(estimate, placements=tuple(placements), frame=pose.frame)
