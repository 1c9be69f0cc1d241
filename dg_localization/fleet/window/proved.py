# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What was proved of the robots is carried on by odometry, and holds for the next estimate, too.

Where robots are in line a mirror image looks like the truth. Odometry tells where the robots of an
earlier estimate are now, and so whether a placement of now can go on from one of then.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.estimate import FixedFrame, FrameKind, Placement
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.carry import odometry_path
from dg_localization.interval.angles import angle_down, angle_up
from dg_localization.interval.arrays import Interval
from dg_localization.pairs.cover import arc_around
from dg_localization.pairs.turns import HALF_TURN_UP, TURN, turned

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Proved:
    """
    The placements of an estimate, one of which is true while all bounds hold.

    Parameters
    ----------
    placements : tuple of Placement
    frame : FixedFrame
        Of their coordinates.
    stamp_s : float
    since_s : float
        The first estimate of a row, of which each used the one before.

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
        Of the headings, counterclockwise from the first to the second.

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
        self.age_s = snapshot.stamp_s - proved.stamp_s
        moves = [_move(snapshot, robot, proved.stamp_s) for robot in range(len(self._robots))]
        self._carried = [_carried(placement, moves) for placement in proved.placements]

    def around(self, placement: Placement, frame: FixedFrame) -> PoseBounds | None:
        """
        Return what a placement of now has in common with all that it can go on from.

        Parameters
        ----------
        placement : Placement
        frame : FixedFrame
            Of its coordinates.

        Returns
        -------
        PoseBounds or None
            None where it cannot go on from any.

        """
        own = PoseBounds(placement.enclosure_m, heading_arcs(placement))
        if not self._seen_in(frame):
            return own
        shared = []
        for position, yaw in self._carried:
            position, yaw = self._in_frame(frame, position, yaw)
            bounds = _intersection(own, position, yaw)
            if bounds is not None:
                shared.append(bounds)
        return _hull(shared) if shared else None

    def _seen_in(self, frame: FixedFrame) -> bool:
        """Return whether the earlier estimate bounds poses in a frame of now."""
        if FrameKind.ANCHORS in (frame.kind, self._frame.kind):
            return frame.kind is self._frame.kind
        return all(point in self._robots for point in frame.points)

    def _in_frame(
        self, frame: FixedFrame, position: Interval, yaw: Interval
    ) -> tuple[Interval, Interval]:
        """Return poses in a frame of now."""
        if frame.kind is FrameKind.ANCHORS:
            return position, yaw
        origin = self._robots.index(frame.points[0])
        # What is not known minus what is not known is no number, and not known either.
        with np.errstate(invalid='ignore'):
            position = position - position[origin]
        position.lower[origin] = position.upper[origin] = 0.0
        angle = yaw[origin]
        if frame.kind is not FrameKind.HEADING and len(frame.points) > 1:
            angle = _direction(position[self._robots.index(frame.points[1])])
        turn = Interval(np.atleast_1d(-angle.upper), np.atleast_1d(-angle.lower))
        known = np.isfinite(position.lower) & np.isfinite(position.upper)
        finite = Interval(
            np.where(known, position.lower, 0.0), np.where(known, position.upper, 0.0)
        )
        seen = turned(turn, finite)
        unknown = ~known.all(axis=1, keepdims=True)
        seen = Interval(
            np.where(unknown, -np.inf, seen.lower), np.where(unknown, np.inf, seen.upper)
        )
        return seen, yaw + turn


def heading_arcs(placement: Placement) -> FloatArray:
    """Return bounds of all headings of a placement, shape (n, 2)."""
    arcs = np.tile([-HALF_TURN_UP, HALF_TURN_UP], (len(placement.heading_known), 1))
    for robot in np.flatnonzero(placement.heading_known):
        z, w = placement.orientations_xyzw[robot, 2:]
        yaw = 2.0 * math.atan2(float(z), float(w))
        half = angle_up(float(placement.heading_half_width_rad[robot]))
        arcs[robot] = yaw - half, yaw + half
    return arcs


def intersect_arcs(first: FloatArray, second: FloatArray) -> FloatArray | None:
    """
    Return what two arcs have in common, None for nothing.

    The narrower one where that may be two arcs.
    """
    widths = first[1] - first[0], second[1] - second[0]
    if widths[0] + widths[1] >= TURN:
        return first if widths[0] <= widths[1] else second
    turns = np.round((first.sum() - second.sum()) / (2.0 * TURN)) * TURN
    low = max(float(first[0]), angle_down(float(second[0] + turns)))
    high = min(float(first[1]), angle_up(float(second[1] + turns)))
    return np.array([low, high]) if low <= high else None


def _move(snapshot: Snapshot, robot: int, stamp_s: float) -> tuple[Interval, Interval] | None:
    """Return the pose of a robot now, seen from where it was; None where that is not known."""
    if not snapshot.motion.odometry.get(snapshot.config.robots[robot]):
        return None
    path = odometry_path(snapshot.config, snapshot.motion, robot)
    then = path.past_poses(np.array([stamp_s]), snapshot.stamp_s)
    ends = (then.position_m.lower, then.position_m.upper, then.yaw_rad.lower, then.yaw_rad.upper)
    if not all(np.all(np.isfinite(end)) for end in ends):
        return None
    return turned(-then.yaw_rad, -then.position_m), -then.yaw_rad


def _carried(
    placement: Placement, moves: list[tuple[Interval, Interval] | None]
) -> tuple[Interval, Interval]:
    """Return positions (n, 3) and headings (n,) of now in the frame of a placement of then."""
    count = len(moves)
    lower, upper = np.full((count, 3), -np.inf), np.full((count, 3), np.inf)
    yaws = np.tile([-HALF_TURN_UP, HALF_TURN_UP], (count, 1))
    lower[:, 2] = upper[:, 2] = 0.0
    for robot, (move, arc) in enumerate(zip(moves, heading_arcs(placement), strict=True)):
        if move is None:
            continue
        step, turn = move
        heading = Interval(arc[:1], arc[1:])
        way = turned(heading, step)[0]
        place = Interval(placement.enclosure_m[robot, 0], placement.enclosure_m[robot, 1])
        moved = place + way[:2]
        lower[robot, :2], upper[robot, :2] = moved.lower, moved.upper
        if placement.heading_known[robot]:
            after = heading + turn
            yaws[robot] = after.lower[0], after.upper[0]
    return Interval(lower, upper), Interval(yaws[:, 0], yaws[:, 1])


def _direction(place: Interval) -> Interval:
    """Return the angles at which a box (x, y, z) is seen from the origin."""
    low, high = place.lower[:2], place.upper[:2]
    around = bool(np.all((low <= 0.0) & (high >= 0.0)))
    if around or not (np.all(np.isfinite(low)) and np.all(np.isfinite(high))):
        return Interval(np.array(-HALF_TURN_UP), np.array(HALF_TURN_UP))
    middle = 0.5 * low + 0.5 * high
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    across = middle[0] * corners[:, 1] - middle[1] * corners[:, 0]
    off = np.abs(np.arctan2(across, corners @ middle))
    half = angle_up(angle_up(float(off.max())))
    angle = math.atan2(middle[1], middle[0])
    return Interval(np.array(angle - half), np.array(angle + half))


def _intersection(own: PoseBounds, position: Interval, yaw: Interval) -> PoseBounds | None:
    """Return what bounds of now have in common with poses that were carried."""
    lower = np.fmax(own.enclosure_m[:, 0], position.lower[:, :2])
    upper = np.fmin(own.enclosure_m[:, 1], position.upper[:, :2])
    if np.any(lower > upper):
        return None
    arcs = []
    for mine, low, high in zip(own.arcs_rad, yaw.lower, yaw.upper, strict=True):
        arc = intersect_arcs(mine, np.array([low, high]))
        if arc is None:
            return None
        arcs.append(arc)
    return PoseBounds(np.stack([lower, upper], axis=1), np.array(arcs))


def _hull(shared: list[PoseBounds]) -> PoseBounds:
    """Return bounds around all of some."""
    enclosures = np.stack([bounds.enclosure_m for bounds in shared])
    hull = np.stack([enclosures[:, :, 0].min(axis=0), enclosures[:, :, 1].max(axis=0)], axis=1)
    ends = np.stack([bounds.arcs_rad for bounds in shared])
    arcs = [arc_around(ends[:, robot, 0], ends[:, robot, 1]) for robot in range(len(hull))]
    return PoseBounds(hull, np.array(arcs))
