# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Proved placements of an earlier estimate, carried to now by odometry, narrow the next estimate.

If robots are in line, a mirror image looks like the truth. Odometry bounds where the robots of an
earlier estimate are now, and so whether a placement of now can continue an earlier one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.estimate import FixedFrame, FrameKind, Placement
from dg_localization.fleet.rotations import yaw_of
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.interval.angles import angle_down, angle_up
from dg_localization.interval.arrays import Interval
from dg_localization.poses.cover import arc_around
from dg_localization.poses.turns import HALF_TURN_UP, TURN, turned

FloatArray = NDArray[np.float64]


WINDOW_SHARE = 0.5
"""
Fraction of the memory in which observations between robots count. Proved placements are used for
the rest of the memory: nothing older than the memory has any effect.
"""


@dataclass(frozen=True)
class Proved:
    """
    The placements of an estimate; one of them is true while all bounds hold.

    Parameters
    ----------
    placements : tuple of Placement
    frame : FixedFrame
        The frame of their coordinates.
    stamp_s : float
    since_s : float
        The time of the first estimate of a chain in which each estimate used the one before.

    """

    placements: tuple[Placement, ...]
    frame: FixedFrame
    stamp_s: float
    since_s: float


@dataclass(frozen=True)
class PoseBounds:
    """
    Bounds of the poses of all robots.

    Parameters
    ----------
    enclosure_m : numpy.ndarray, shape (n, 2, 2)
        Lower and upper corners.
    arcs_rad : numpy.ndarray, shape (n, 2)
        Arcs of the headings, counterclockwise from the first angle to the second.

    """

    enclosure_m: FloatArray
    arcs_rad: FloatArray


class CarriedPlacements:
    """
    The placements of an earlier estimate, carried to the time of a snapshot.

    Parameters
    ----------
    proved : Proved
    snapshot : Snapshot
        In the plane, not earlier.

    """

    def __init__(self, proved: Proved, snapshot: Snapshot) -> None:
        self._robots = snapshot.config.robots
        self._frame = proved.frame
        self.since_s = proved.since_s
        self.age_s = snapshot.stamp_s - proved.stamp_s
        moves = [_move(snapshot, robot, proved.stamp_s) for robot in range(len(self._robots))]
        self._position, self._yaw = _carried(proved.placements, moves)
        self._seen: dict[FixedFrame, tuple[Interval, Interval]] = {}

    def around(self, placement: Placement, frame: FixedFrame) -> PoseBounds | None:
        """Return the bounds of a placement within the carried ones; None if it continues none."""
        own = PoseBounds(placement.enclosure_m, heading_arcs(placement))
        if not self._seen_in(frame):
            return own
        if frame not in self._seen:
            self._seen[frame] = self._in_frame(frame)
        return _hull_in_common(own, *self._seen[frame])

    def _seen_in(self, frame: FixedFrame) -> bool:
        """Return whether the carried poses can be expressed in a frame of now."""
        if FrameKind.ANCHORS in (frame.kind, self._frame.kind):
            return frame.kind is self._frame.kind
        return all(point in self._robots for point in frame.points)

    def _in_frame(self, frame: FixedFrame) -> tuple[Interval, Interval]:
        """Return the carried poses, shapes (k, n, 3) and (k, n), in a frame of now."""
        position, yaw = self._position, self._yaw
        if frame.kind is FrameKind.ANCHORS:
            return position, yaw
        origin = self._robots.index(frame.points[0])
        # Infinity minus infinity is NaN, which counts as unknown below.
        with np.errstate(invalid='ignore'):
            position = position - position[:, origin, None]
        position.lower[:, origin] = position.upper[:, origin] = 0.0
        angle = yaw[:, origin]
        if frame.kind is not FrameKind.HEADING and len(frame.points) > 1:
            angle = directions_of(position[:, self._robots.index(frame.points[1])])
        turn = -angle[:, None]
        known = np.isfinite(position.lower) & np.isfinite(position.upper)
        finite = Interval(
            np.where(known, position.lower, 0.0), np.where(known, position.upper, 0.0)
        )
        seen = turned(turn, finite)
        unknown = ~known.all(axis=-1, keepdims=True)
        seen = Interval(
            np.where(unknown, -np.inf, seen.lower), np.where(unknown, np.inf, seen.upper)
        )
        return seen, yaw + turn


def chain_seconds(config: FleetConfig) -> float:
    """Return the time for which the proved placements of an estimate are used."""
    return (1.0 - WINDOW_SHARE) * config.memory_s


def heading_arcs(placement: Placement) -> FloatArray:
    """Return bounds of all headings of a placement, shape (n, 2)."""
    arcs = np.tile([-HALF_TURN_UP, HALF_TURN_UP], (len(placement.heading_known), 1))
    for robot in np.flatnonzero(placement.heading_known):
        yaw = yaw_of(placement.orientations_xyzw[robot])
        half = angle_up(float(placement.heading_half_width_rad[robot]))
        arcs[robot] = yaw - half, yaw + half
    return arcs


def intersect_arcs(first: FloatArray, second: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return intersections of arcs (..., 2), the narrower arc if these split, and if they meet."""
    first, second = np.broadcast_arrays(first, second)
    widths = first[..., 1] - first[..., 0], second[..., 1] - second[..., 0]
    turns = np.round((first.sum(axis=-1) - second.sum(axis=-1)) / (2.0 * TURN)) * TURN
    low = np.maximum(first[..., 0], angle_down(second[..., 0] + turns))
    high = np.minimum(first[..., 1], angle_up(second[..., 1] + turns))
    narrower = np.where((widths[0] <= widths[1])[..., None], first, second)
    round_about = widths[0] + widths[1] >= TURN
    arcs = np.where(round_about[..., None], narrower, np.stack([low, high], axis=-1))
    return arcs, round_about | (low <= high)


def _move(snapshot: Snapshot, robot: int, stamp_s: float) -> tuple[Interval, Interval] | None:
    """Return the pose of a robot now relative to its pose at `stamp_s`; None if unknown."""
    if not snapshot.motion.odometry.get(snapshot.config.robots[robot]):
        return None
    then = snapshot.carried.path(robot).past_poses(np.array([stamp_s]), snapshot.stamp_s)
    ends = (then.position_m.lower, then.position_m.upper, then.yaw_rad.lower, then.yaw_rad.upper)
    if not all(np.all(np.isfinite(end)) for end in ends):
        return None
    return turned(-then.yaw_rad, -then.position_m), -then.yaw_rad


def _carried(
    placements: Sequence[Placement], moves: Sequence[tuple[Interval, Interval] | None]
) -> tuple[Interval, Interval]:
    """Return positions (k, n, 3) and headings (k, n) of now in the frame of the placements."""
    arcs = np.stack([heading_arcs(placement) for placement in placements])
    enclosures = np.stack([placement.enclosure_m for placement in placements])
    heading_known = np.stack([placement.heading_known for placement in placements])
    lower, upper = np.full((*arcs.shape[:2], 3), -np.inf), np.full((*arcs.shape[:2], 3), np.inf)
    yaws = np.tile([-HALF_TURN_UP, HALF_TURN_UP], (*arcs.shape[:2], 1))
    lower[:, :, 2] = upper[:, :, 2] = 0.0
    for robot, move in enumerate(moves):
        if move is None:
            continue
        step, turn = move
        heading = Interval(arcs[:, robot, 0], arcs[:, robot, 1])
        way = turned(heading, step)
        place = Interval(enclosures[:, robot, 0], enclosures[:, robot, 1])
        moved = place + way[:, :2]
        lower[:, robot, :2], upper[:, robot, :2] = moved.lower, moved.upper
        after, known = heading + turn, heading_known[:, robot]
        yaws[known, robot, 0], yaws[known, robot, 1] = after.lower[known], after.upper[known]
    return Interval(lower, upper), Interval(yaws[:, :, 0], yaws[:, :, 1])


def directions_of(places: Interval) -> Interval:
    """Return the directions of boxes (k, 3) from the origin in the plane, shape (k,)."""
    low, high = places.lower[:, :2], places.upper[:, :2]
    around = np.all((low <= 0.0) & (high >= 0.0), axis=1)
    any_way = around | ~np.all(np.isfinite(low) & np.isfinite(high), axis=1)
    low, high = np.where(any_way[:, None], 1.0, low), np.where(any_way[:, None], 1.0, high)
    middle = 0.5 * low + 0.5 * high
    off = np.zeros(len(low))
    for x in (low[:, 0], high[:, 0]):
        for y in (low[:, 1], high[:, 1]):
            across = middle[:, 0] * y - middle[:, 1] * x
            along = middle[:, 0] * x + middle[:, 1] * y
            off = np.maximum(off, np.abs(np.arctan2(across, along)))
    half = angle_up(angle_up(off))
    angle = np.arctan2(middle[:, 1], middle[:, 0])
    return Interval(
        np.where(any_way, -HALF_TURN_UP, angle - half),
        np.where(any_way, HALF_TURN_UP, angle + half),
    )


def _hull_in_common(own: PoseBounds, position: Interval, yaw: Interval) -> PoseBounds | None:
    """Return the hull of the intersections of bounds with carried poses; None if all are empty."""
    lower = np.fmax(own.enclosure_m[:, 0], position.lower[:, :, :2])
    upper = np.fmin(own.enclosure_m[:, 1], position.upper[:, :, :2])
    arcs, met = intersect_arcs(own.arcs_rad, np.stack([yaw.lower, yaw.upper], axis=-1))
    shared = np.all(lower <= upper, axis=(1, 2)) & np.all(met, axis=1)
    if not np.any(shared):
        return None
    hull = np.stack([lower[shared].min(axis=0), upper[shared].max(axis=0)], axis=1)
    arcs = arcs[shared]
    around = [arc_around(arcs[:, robot, 0], arcs[:, robot, 1]) for robot in range(len(hull))]
    return PoseBounds(hull, np.array(around))
