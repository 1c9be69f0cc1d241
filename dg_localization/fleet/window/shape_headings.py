# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Shape first, then headings: what a window tells of a placement of the moment.

The placement bounds the places of the robots in some frame. Old observations, carried to now, then
leave few headings, or none: such a placement is impossible, as a mirror image mostly is. Tables of
headings take the pairs one by one; what they leave is narrowed by all pairs of a few robots.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.estimate import FrameKind, Placement
from dg_localization.fleet.frames.headings import Heading
from dg_localization.fleet.window.carry import WORLD, Pair
from dg_localization.fleet.window.pose_sets import PoseSets, poses_within
from dg_localization.fleet.window.proved import PoseBounds, heading_arcs, intersect_arcs
from dg_localization.interval.angles import angle_up
from dg_localization.interval.arrays import Interval, squared_norm
from dg_localization.pairs import (
    HeadingOptions,
    JointPoses,
    PairReadings,
    heading_cells,
    narrow_headings,
    narrow_jointly,
)

FloatArray = NDArray[np.float64]

COARSE_CELLS = 32
FINE_CELLS = 128
"""Cells of the full turn: few to rule out what is impossible, more to bound what is left."""

JOINT_BOXES = 96
LONE_BOXES = 256
"""
Boxes of the poses of a few robots together, where these narrow each other; more where there are no
others.
"""

KNOWN_HALF_WIDTH_RAD = 0.5 * math.pi
"""A heading in less than a half turn counts as known."""


@dataclass(frozen=True)
class Narrowed:
    """
    What is left of a placement.

    Parameters
    ----------
    placement : Placement or None
        None where no headings are left.
    ruled_out_by : tuple of int, or None
        The bodies whose observations showed it.

    """

    placement: Placement | None
    ruled_out_by: Pair | None = None


def narrow_placement(
    placement: Placement,
    frame: FrameKind,
    reference: int,
    readings: Mapping[Pair, PairReadings],
    pose_sets: PoseSets,
    options: HeadingOptions,
    max_boxes: int,
    stopped: Callable[[], bool],
) -> Narrowed:
    """
    Return what a window leaves of a placement.

    Parameters
    ----------
    placement : Placement
        Of the moment, in the plane.
    frame : FrameKind
        Of its coordinates.
    reference : int
        The robot whose body frame that is, where it is one.
    readings : mapping of (int, int) to PairReadings
        What pairs of robots observed of each other.
    pose_sets : PoseSets
        Of robots among anchors, where these make the frame.
    options : HeadingOptions
    max_boxes : int
        For the joint poses of a few robots; none where zero, or where outliers are tolerated.
    stopped : callable
        Once it is true, what is found so far is returned.

    Returns
    -------
    Narrowed

    """
    enclosure = placement.enclosure_m.copy()
    known = _known_headings(placement, frame, reference, options.cells)
    if frame is FrameKind.ANCHORS:
        for robot, cover in pose_sets.covers.items():
            part = poses_within(cover, *enclosure[robot])
            if part.empty:
                return Narrowed(None, (WORLD, robot))
            known[robot] &= heading_cells(part.boxes[:, 0, 3], part.boxes[:, 1, 3], options.cells)
            if not known[robot].any():
                return Narrowed(None, (WORLD, robot))
            position_m = part.position_m[:2]
            enclosure[robot] = position_m.lower, position_m.upper
    lower, upper = np.zeros((2, len(enclosure), 3))
    lower[:, :2], upper[:, :2] = enclosure[:, 0], enclosure[:, 1]
    settled = pose_sets.covers if frame is FrameKind.ANCHORS else {}
    # Two robots that are known among the anchors tell each other little, and it takes long.
    useful = {pair: part for pair, part in readings.items() if not settled.keys() >= {*pair}}
    found = narrow_headings(lower, upper, useful, options, known=known, stopped=stopped)
    if not found.possible:
        return Narrowed(None, found.ruled_out_by)
    poses = _within_known(JointPoses.of(found), placement)
    if max_boxes and not options.max_outliers:
        poses = narrow_jointly(poses, useful, max_boxes, stopped=stopped)
        if not poses.possible:
            return Narrowed(None, poses.ruled_out_by)
    enclosure[:, 0], enclosure[:, 1] = poses.lower_m[:, :2], poses.upper_m[:, :2]
    return Narrowed(within_bounds(placement, PoseBounds(enclosure, poses.arcs_rad)))


def _known_headings(
    placement: Placement, frame: FrameKind, reference: int, cells: int
) -> NDArray[np.bool_]:
    """Return the cells that may hold each heading by the rays of the moment."""
    known = np.ones((len(placement.heading_known), cells), bool)
    arcs = heading_arcs(placement)
    for robot in np.flatnonzero(placement.heading_known):
        known[robot] = heading_cells(arcs[robot, 0], arcs[robot, 1], cells)
    if frame is FrameKind.HEADING:
        known[reference] = heading_cells(0.0, 0.0, cells)
    return known


def _within_known(poses: JointPoses, placement: Placement) -> JointPoses:
    """Return poses with their headings within those that are known, finer than cells are."""
    known = heading_arcs(placement)
    arcs, met = intersect_arcs(poses.arcs_rad, known)
    # Arcs that have only a rounded end in common are left as they are.
    return replace(poses, arcs_rad=np.where(met[:, None], arcs, known))


def within_bounds(placement: Placement, bounds: PoseBounds) -> Placement:
    """Return a placement with narrower bounds."""
    return with_headings(with_enclosure(placement, bounds.enclosure_m), bounds.arcs_rad)


def with_enclosure(placement: Placement, enclosure_m: FloatArray) -> Placement:
    """Return a placement in a narrower enclosure."""
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


def with_headings(placement: Placement, arcs_rad: FloatArray) -> Placement:
    """Return a placement with the headings that are found, where the rays tell less."""
    found = {}
    for robot, (low, high) in enumerate(arcs_rad.tolist()):
        middle, half = arc_middle(low, high)
        if half < KNOWN_HALF_WIDTH_RAD:
            xyzw = np.array([0.0, 0.0, math.sin(0.5 * middle), math.cos(0.5 * middle)])
            found[robot] = Heading(xyzw, half)
    return with_orientations(placement, found, [5])


def arc_middle(low_rad: float, high_rad: float) -> tuple[float, float]:
    """Return the middle of an arc, and the greatest angle from it to any of the arc."""
    middle = 0.5 * (low_rad + high_rad)
    return middle, angle_up(max(high_rad - middle, middle - low_rad))


def with_orientations(
    placement: Placement, found: Mapping[int, Heading], axes: Sequence[int]
) -> Placement:
    """
    Return a placement with orientations that a window tells, where the rays tell less.

    Parameters
    ----------
    placement : Placement
    found : mapping of int to Heading
        By robot.
    axes : sequence of int
        The rows of a covariance about which the bound of a heading holds.

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
                # Least squares knows nothing of this heading: the bound takes its place.
                covariances[robot, 3:] = covariances[robot, :, 3:] = 0.0
                covariances[robot, axes, axes] = half * half
    return replace(
        placement,
        orientations_xyzw=orientations,
        heading_known=~np.isnan(orientations[:, 0]),
        heading_half_width_rad=half_widths,
        covariances=covariances,
    )
