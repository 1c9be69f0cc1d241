# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Headings of the placements of the moment, by a window.

A placement bounds the positions of the robots in some frame. Pose sets and old observations,
carried to now, then bound the headings. If no heading is left, the placement is impossible, as
most mirror images are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.estimate import FixedFrame, FrameKind, Placement
from dg_localization.fleet.frames.headings import Heading, heading_in_arc
from dg_localization.fleet.rotations import quaternion_of, rotation_of_quaternion
from dg_localization.fleet.window.carry import Tilt
from dg_localization.fleet.window.memory import WORLD, Pair
from dg_localization.fleet.window.pose_sets import PoseSets, poses_within
from dg_localization.fleet.window.proved import (
    PoseBounds,
    directions_of,
    heading_arcs,
    intersect_arcs,
)
from dg_localization.interval.angles import angle_up
from dg_localization.interval.arrays import Interval, squared_norm
from dg_localization.poses import Cover, JointPoses, PairOptions, PairReadings, narrow_jointly
from dg_localization.poses.cover import arc_around
from dg_localization.poses.turns import turned

FloatArray = NDArray[np.float64]

Narrow = Callable[[Placement], Placement | str]
"""Returns the narrowed placement, or the name of what rules it out."""

KNOWN_HALF_WIDTH_RAD = 0.5 * math.pi
"""Headings with a smaller half width, in an arc of less than a half turn, count as known."""


def narrow_in_plane(
    placement: Placement,
    frame: FixedFrame,
    robots: Sequence[str],
    readings: Mapping[Pair, PairReadings],
    pose_sets: PoseSets,
    options: PairOptions,
    stopped: Callable[[], bool],
) -> Placement | Pair:
    """
    Narrow a placement of the moment by a window, or return the bodies that rule it out.

    `readings` are the observations between pairs of robots. When `stopped` becomes true, the
    bounds found so far are used.
    """
    enclosure, arcs = placement.enclosure_m.copy(), heading_arcs(placement)
    if frame.kind is FrameKind.HEADING:
        arcs[robots.index(frame.points[0])] = 0.0
    by_anchors = frame.kind is FrameKind.ANCHORS
    known = {**pose_sets.of_moment, **pose_sets.covers} if by_anchors else {}
    for robot, cover in known.items():
        part = poses_within(cover, *enclosure[robot])
        if part.empty and robot not in pose_sets.covers:
            continue
        if part.empty:
            return WORLD, robot
        position_m = part.position_m[:2]
        enclosure[robot] = position_m.lower, position_m.upper
        arcs[robot], met = intersect_arcs(arcs[robot], np.array(part.yaw_rad))
        if not met:
            return WORLD, robot
    of_two = len(robots) == 2 and {*frame.points} <= {*robots}
    for pair, cover in pose_sets.sets.items() if of_two else ():
        bounds = _two_robots(frame, robots, cover)
        enclosure[:, 0] = np.maximum(enclosure[:, 0], bounds.enclosure_m[:, 0])
        enclosure[:, 1] = np.minimum(enclosure[:, 1], bounds.enclosure_m[:, 1])
        arcs, all_met = intersect_arcs(arcs, bounds.arcs_rad)
        if not np.all(all_met) or np.any(enclosure[:, 0] > enclosure[:, 1]):
            return pair
    lower, upper = np.zeros((2, len(enclosure), 3))
    lower[:, :2], upper[:, :2] = enclosure[:, 0], enclosure[:, 1]
    settled = pose_sets.covers if by_anchors else {}
    # Readings between two robots placed among the anchors gain little and cost much time.
    useful = {p: part for p, part in readings.items() if not settled.keys() >= {*p}}
    poses = narrow_jointly(JointPoses(lower, upper, arcs), useful, options, stopped=stopped)
    if poses.ruled_out_by is not None:
        return poses.ruled_out_by
    enclosure[:, 0], enclosure[:, 1] = poses.lower_m[:, :2], poses.upper_m[:, :2]
    return within_bounds(placement, PoseBounds(enclosure, poses.arcs_rad))


def narrow_in_space(
    placement: Placement, frame: FrameKind, pose_sets: PoseSets, tilts: Mapping[int, Tilt]
) -> Placement | Pair:
    """
    Narrow a placement in space by pose sets, or return the bodies that rule it out.

    Pose sets are in the frame of the anchors; `tilts` holds the tilt of each robot with a set.
    """
    if frame is not FrameKind.ANCHORS:
        return placement
    enclosure = placement.enclosure_m.copy()
    found = {}
    for robot, cover in pose_sets.covers.items():
        part = poses_within(cover, *enclosure[robot])
        if part.empty:
            return WORLD, robot
        enclosure[robot] = part.position_m.lower, part.position_m.upper
        level, tilt = heading_in_arc(part.yaw_rad), tilts[robot]
        turn = rotation_of_quaternion(level.orientation_xyzw)
        # The angle of a product of rotations is at most the sum of their angles.
        half_rad = angle_up(level.half_width_rad + tilt.error_rad)
        found[robot] = Heading(quaternion_of(turn @ tilt.rotation), half_rad)
    return _with_orientations(_with_enclosure(placement, enclosure), found, [3, 4, 5])


def _two_robots(frame: FixedFrame, robots: Sequence[str], cover: Cover) -> PoseBounds:
    """Return bounds of the poses of two robots in their frame, by a cover of the second."""
    boxes = cover.boxes
    place = Interval(boxes[:, 0, :3], boxes[:, 1, :3])
    yaw = Interval(boxes[:, 0, 3], boxes[:, 1, 3])
    origin = robots.index(frame.points[0])
    none = Interval.point(np.zeros(len(boxes)))
    if frame.kind is FrameKind.HEADING:
        turn = none if origin == 0 else -yaw
    else:
        turn = -directions_of(place)
        if origin == 1:
            turn = turn + Interval.point(np.array([math.pi]))
    other = turned(turn, place)
    if origin == 1:
        other = -other
    enclosure_m = np.zeros((2, 2, 2))
    enclosure_m[1 - origin, 0] = other.lower[:, :2].min(axis=0)
    enclosure_m[1 - origin, 1] = other.upper[:, :2].max(axis=0)
    second = yaw + turn
    arcs = [arc_around(turn.lower, turn.upper), arc_around(second.lower, second.upper)]
    return PoseBounds(enclosure_m, np.array(arcs))


def within_bounds(placement: Placement, bounds: PoseBounds) -> Placement:
    """Return a placement with narrower bounds, and headings where they improve on the rays."""
    found = dict(enumerate(map(heading_in_arc, bounds.arcs_rad.tolist())))
    return _with_orientations(_with_enclosure(placement, bounds.enclosure_m), found, [5])


def _with_enclosure(placement: Placement, enclosure_m: FloatArray) -> Placement:
    """Return a placement with a narrower enclosure."""
    positions = np.clip(placement.positions_m, enclosure_m[:, 0], enclosure_m[:, 1])
    moved = bool(np.any((positions != placement.positions_m) & np.isfinite(positions)))
    boxes = Interval(enclosure_m[:, 0], enclosure_m[:, 1])
    apart = squared_norm(boxes[:, None] - boxes[None]).sqrt()
    lower = np.maximum(placement.lower_m, apart.lower)
    upper = np.minimum(placement.upper_m, apart.upper)
    np.fill_diagonal(upper, 0.0)
    return replace(
        placement,
        positions_m=positions,
        enclosure_m=enclosure_m,
        lower_m=lower,
        upper_m=upper,
        proved=placement.proved and not moved,
    )


def _with_orientations(
    placement: Placement, found: Mapping[int, Heading], axes: Sequence[int]
) -> Placement:
    """
    Return a placement with the orientations of a window where they improve on the rays.

    `axes` are the rows of a covariance to which the bound of a heading applies.
    """
    orientations = placement.orientations_xyzw.copy()
    half_widths = placement.heading_half_width_rad.copy()
    covariances = None if placement.covariances is None else placement.covariances.copy()
    yaws = placement.fitted_yaws_rad
    fitted = np.isfinite(yaws) if yaws is not None else np.zeros(len(orientations), bool)
    for robot, heading in found.items():
        half = heading.half_width_rad
        if half < min(KNOWN_HALF_WIDTH_RAD, half_widths[robot]):
            orientations[robot], half_widths[robot] = heading.orientation_xyzw, half
            if covariances is not None and not fitted[robot]:
                # Least squares did not estimate this heading: use its bound as deviation.
                covariances[robot, 3:] = covariances[robot, :, 3:] = 0.0
                covariances[robot, axes, axes] = half * half
    return replace(
        placement,
        orientations_xyzw=orientations,
        heading_known=~np.isnan(orientations[:, 0]),
        heading_half_width_rad=half_widths,
        covariances=covariances,
    )


class Remaining(NamedTuple):
    """The remaining placements, and one sentence per impossible placement."""

    placements: tuple[Placement, ...] = ()
    ruled_out: tuple[str, ...] = ()


def sifted(placements: Sequence[Placement], narrow: Narrow) -> Remaining:
    """
    Apply `narrow` to placements; return the remaining ones and reasons against the others.

    Placements with the widest headings come first, each with all the remaining time: a share of
    it would suffice for none. If time runs out, the others are narrowed at the next estimate,
    which uses these results.
    """
    unknown_rad = [
        np.minimum(placement.heading_half_width_rad, math.pi).sum() for placement in placements
    ]
    order = np.argsort(-np.array(unknown_rad), kind='stable')
    found = {int(number): narrow(placements[number]) for number in order}
    left: list[Placement] = []
    ruled_out: list[str] = []
    lone = True
    for number, placement in enumerate(placements):
        narrowed = found[number]
        if isinstance(narrowed, Placement) and np.any(narrowed.lower_m > narrowed.upper_m):
            narrowed = 'distances of now'
        if isinstance(narrowed, Placement):
            left.append(replace(narrowed, mirrored=placement.mirrored and not lone))
        else:
            image = placement.mirrored or any(p.mirrored for p in placements[number + 1 :][:1])
            what = 'mirror image' if image else 'hypothesis'
            ruled_out.append(f'{what} ruled out by {narrowed}')
        lone = not isinstance(narrowed, Placement)
    return Remaining(tuple(left), tuple(ruled_out))


def parted(
    placements: Sequence[Placement], most: int
) -> tuple[Sequence[Placement], Sequence[Placement]]:
    """Split placements after the first `most`; a mirror image stays with its original."""
    if len(placements) > most and placements[most].mirrored:
        most -= 1
    return placements[:most], placements[most:]
