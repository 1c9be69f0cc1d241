# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Headings: the orientation of a robot from its rays and the enclosures of their targets.

Each ray bounds the rotation of the body, by its own error and by the range of directions that the
enclosures of both ends allow.

For a robot with sensors in the plane, the set of poses that agree with every distance and every
ray bounds the heading. It also narrows the enclosure, which treats each sensor as a separate
point.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import product
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.mounts import AHEAD, Sight, readings_of
from dg_localization.fleet.rotations import (
    angles_rad,
    best_rotation,
    nearest_in_arc,
    quaternion_of,
    quaternion_of_yaw,
    unit_vectors,
)
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import RayReading
from dg_localization.fleet.window.proved import intersect_arcs
from dg_localization.interval.angles import angle_down, angle_up, arcsine_up
from dg_localization.interval.arrays import Interval, up
from dg_localization.poses import NO_RAY_RAD, Cover, PairOptions, cover_poses
from dg_localization.solver.result import Hypothesis

FloatArray = NDArray[np.float64]


class NoHeadingError(ValueError):
    """The rays of a robot contradict each other for all positions of targets in the enclosures."""


class Heading(NamedTuple):
    """
    The orientation of a robot in the fixed frame.

    Parameters
    ----------
    orientation_xyzw : numpy.ndarray, shape (4,)
        Unit quaternion from body to fixed frame.
    half_width_rad : float
        Greatest angle to the true orientation.

    """

    orientation_xyzw: FloatArray
    half_width_rad: float


NO_TURN = Heading(np.array([0.0, 0.0, 0.0, 1.0]), 0.0)
"""The heading of a robot whose body frame is the fixed frame."""


class _Sights(NamedTuple):
    """
    The rays of a robot and the directions of their targets.

    Parameters
    ----------
    rays : numpy.ndarray, shape (m, q)
        Unit vectors in the body frame.
    directions, placed : numpy.ndarray, shape (m, q)
        Unit vectors in the fixed frame: to the middle of the enclosures, and in the placement.
    half_widths_rad : numpy.ndarray, shape (m,)
        Errors of ray and direction together, the smallest first.

    """

    rays: FloatArray
    directions: FloatArray
    placed: FloatArray
    half_widths_rad: FloatArray


def estimate_heading(
    rows: Mapping[str, int],
    rays: Sequence[RayReading],
    positions: FloatArray,
    enclosure: Interval,
) -> Heading | None:
    """Return the heading of a robot by its rays; None if they do not bound it."""
    if not rays:
        return None
    sights = _sights(rows, rays, positions, enclosure)
    _check_angles(sights)
    if positions.shape[1] == 2:
        return _planar_heading(sights)
    return _spatial_heading(sights)


def heading_within(
    heading: Heading | None, arc_rad: tuple[float, float], rotation: FloatArray
) -> Heading | None:
    """
    Return the narrower of a heading and an arc, as near to the best fit as the arc allows.

    The arc goes counterclockwise from its first angle to its second.
    """
    within = heading_in_arc(arc_rad, math.atan2(rotation[1, 0], rotation[0, 0]))
    half_arc_rad = 0.5 * (arc_rad[1] - arc_rad[0])
    is_narrower = heading is None or heading.half_width_rad > half_arc_rad
    return within if is_narrower and half_arc_rad < math.pi else heading


def heading_in_arc(arc_rad: Sequence[float], fitted_rad: float | None = None) -> Heading:
    """Return the heading of an arc nearest to a fitted one, or in the middle without one."""
    middle_rad = 0.5 * (arc_rad[0] + arc_rad[1])
    half_rad = angle_up(max(arc_rad[1] - middle_rad, middle_rad - arc_rad[0]))
    nearest_rad = middle_rad if fitted_rad is None else fitted_rad
    yaw_rad, half_width_rad = nearest_in_arc(nearest_rad, middle_rad, half_rad)
    return Heading(quaternion_of_yaw(yaw_rad), half_width_rad)


def _sights(
    rows: Mapping[str, int],
    rays: Sequence[RayReading],
    positions: FloatArray,
    enclosure: Interval,
) -> _Sights:
    """Return the rays whose targets lie in a cone of less than a right angle half width."""
    dimension = positions.shape[1]
    observers = [rows[ray.key.observer] for ray in rays]
    targets = [rows[ray.key.target] for ray in rays]
    differences = enclosure[targets] - enclosure[observers]
    low, high = differences.lower, differences.upper
    bounded = np.all(np.isfinite(high - low), axis=1, keepdims=True)
    low, high = np.where(bounded, low, -1.0), np.where(bounded, high, 1.0)
    directions = unit_vectors((low + high) / 2.0)
    choices = np.array(list(product((False, True), repeat=dimension)))
    corners = np.where(choices[None], high[:, None], low[:, None])
    # A cone of less than a right angle is convex: it holds the box when it holds the corners.
    # A corner or a middle in the origin itself counts as a right angle.
    spreads = angle_up(angles_rad(unit_vectors(corners), directions[:, None]).max(axis=1))
    placed = positions[targets] - positions[observers]
    known = np.all(np.isfinite(placed), axis=1, keepdims=True)
    placed = np.where(known, placed, directions)
    widths = angle_up(spreads + np.array([ray.half_width_rad for ray in rays]))
    seen = np.array([ray.direction[:dimension] for ray in rays]).reshape(-1, dimension)
    order = [i for i in np.argsort(widths, kind='stable') if spreads[i] < math.pi / 2]
    return _Sights(seen[order], directions[order], unit_vectors(placed)[order], widths[order])


def _check_angles(sights: _Sights) -> None:
    """Raise `NoHeadingError` if the angle between two rays contradicts their targets."""
    seen = angles_rad(sights.rays[:, None], sights.rays[None])
    real = angles_rad(sights.directions[:, None], sights.directions[None])
    widths = sights.half_widths_rad[:, None] + sights.half_widths_rad[None]
    if (np.abs(seen - real) > widths).any():
        raise NoHeadingError('two rays differ from the angle between their targets')


def _planar_heading(sights: _Sights) -> Heading | None:
    """Return the intersection of the arcs that the sights allow; the narrowest comes first."""
    yaws = _yaws(sights.directions, sights.rays)
    widths = sights.half_widths_rad
    if not len(widths) or widths[0] >= math.pi:
        return None
    arc, *others = np.stack([angle_down(yaws - widths), angle_up(yaws + widths)], axis=-1)
    for other in others:
        arc, met = intersect_arcs(arc, other)
        if not met:
            raise NoHeadingError('the rays leave no common heading')
    placed = _yaws(sights.placed, sights.rays)
    weights = 1.0 / (widths + 1e-6)
    fitted = math.atan2(float(weights @ np.sin(placed)), float(weights @ np.cos(placed)))
    return heading_in_arc(arc, fitted)


def _yaws(directions: FloatArray, rays: FloatArray) -> FloatArray:
    """Return the headings that turn rays to directions."""
    return np.asarray(
        np.arctan2(directions[:, 1], directions[:, 0]) - np.arctan2(rays[:, 1], rays[:, 0])
    )


def _spatial_heading(sights: _Sights) -> Heading | None:
    """
    Return the rotation that fits the placement best, with a bound of its error.

    The true rotation differs from it by a rotation by psi, which moves each ray by at most eta.
    It moves a unit vector at the angle gamma from its axis by sin(half) = sin(psi/2) sin(gamma).
    For two rays at the angle alpha, one of the two sines is at least the smaller of sin(alpha/2)
    and cos(alpha/2), whatever the axis; so sin(psi/2) <= sin(eta/2) / that.
    """
    if len(sights.rays) < 2:
        return None
    weights = 1.0 / (sights.half_widths_rad + 1e-6)
    rotation = best_rotation(sights.rays, sights.placed, weights)
    residuals = angles_rad(sights.rays @ rotation.T, sights.directions)
    errors = np.minimum(angle_up(sights.half_widths_rad + residuals), math.pi)
    alphas = angles_rad(sights.rays[:, None], sights.rays[None])
    levers = angle_down(np.minimum(np.sin(alphas / 2.0), np.cos(alphas / 2.0)))
    chords = angle_up(np.sin(np.maximum(errors[:, None], errors[None]) / 2.0))
    # A ray with itself has no lever, and one with almost itself none worth its rounding.
    usable = levers > 1e-6
    least = float(np.where(usable, up(chords / np.where(usable, levers, 1.0)), np.inf).min())
    if least >= 1.0:
        return None
    return Heading(quaternion_of(rotation), angle_up(2.0 * arcsine_up(least)))


class BodyPoses:
    """The pose sets of robots with sensors, except a robot whose body frame is the fixed frame."""

    def __init__(self, snapshot: Snapshot, solved: Constraints, held: Collection[int]) -> None:
        self._config, self._solved = snapshot.config, solved
        members = snapshot.mounts.members
        self._bodies = {
            solved.rows[robot]: members[robot]
            for robot in members
            if solved.dimension == 2 and solved.rows.get(robot, -1) not in {-1, *held}
        }
        self._options = PairOptions(resolution_m=self._config.solver.resolution)
        # One search for each robot in each hypothesis that is listed.
        self._most_covers = self._config.max_hypotheses * len(self._bodies)
        self._n_covers = 0

    def narrow(
        self, hypothesis: Hypothesis, enclosure: Interval
    ) -> tuple[Interval, Mapping[int, tuple[float, float]]] | None:
        """
        Return an enclosure (n, q) narrowed by the poses, and the headings by row of the robot.

        A heading is an arc in rad, counterclockwise from the first angle to the second. Return
        None if some robot has no pose, so that the hypothesis holds no placement.
        """
        low_m, high_m = np.array(enclosure.lower), np.array(enclosure.upper)
        headings = {}
        for row, members in self._bodies.items():
            cover = self._cover(members, hypothesis, Interval(low_m, high_m))
            if cover is None or not cover.bounded:
                continue
            if cover.empty:
                return None
            place_m = cover.position_m
            low_m[row] = np.maximum(low_m[row], place_m.lower[:2])
            high_m[row] = np.minimum(high_m[row], place_m.upper[:2])
            if (low_m[row] > high_m[row]).any():
                return None
            headings[row] = cover.yaw_rad
        return Interval(low_m, high_m), headings

    def _cover(
        self, members: tuple[str, ...], hypothesis: Hypothesis, enclosure: Interval
    ) -> Cover | None:
        """Return all poses of a robot that agree; None without readings or after many calls."""
        rows = self._solved.rows
        bounded = np.isfinite(enclosure.lower).all(axis=1) & np.isfinite(enclosure.upper).all(1)
        others = {*np.flatnonzero(bounded).tolist()} - {rows[member] for member in members}
        distance_m = Interval(hypothesis.lower, hypothesis.upper).sqrt()
        sights: list[Sight] = []
        for member in members:
            for other in sorted(others):
                if math.isfinite(self._solved.upper[rows[member], other]):
                    between = distance_m[rows[member], other]
                    bounds_m = float(between.lower), float(between.upper)
                    sights.append((member, enclosure[other], bounds_m, AHEAD, NO_RAY_RAD))
        for member in members:
            for ray in self._solved.rays.get(member, ()):
                other, error_rad = rows[ray.key.target], ray.half_width_rad
                if other in others and error_rad < math.pi / 2:
                    anywhere = (0.0, math.inf)
                    sights.append((member, enclosure[other], anywhere, ray.direction, error_rad))
        if not sights or self._n_covers >= self._most_covers:
            return None
        self._n_covers += 1
        return cover_poses(readings_of(self._config, sights), self._options)
