# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Poses of robots with sensors in the plane: what all their sensors measured together.

The enclosure of one sensor does not know where the others are. The set of poses of the robot under
which every distance and every ray holds does: it bounds the heading, and narrows the enclosure of
the robot.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.frames.headings import Heading
from dg_localization.fleet.mounts import places_on_body
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.interval.angles import angle_up
from dg_localization.interval.arrays import Interval
from dg_localization.pairs import NO_RAY_RAD, Cover, PairOptions, PairReadings, cover_poses
from dg_localization.solver.result import Hypothesis

FloatArray = NDArray[np.float64]

MOST_COVERS = 16
"""How many sets of poses are searched at most for the hypotheses of one problem."""


@dataclass(frozen=True)
class _Reading:
    """What a point of a robot measured of another: a distance, or a ray in the body frame."""

    member: str
    other: int
    distance_m: tuple[float, float] = (0.0, math.inf)
    ray: tuple[float, ...] = (1.0, 0.0, 0.0)
    error_rad: float = NO_RAY_RAD


class BodyPoses:
    """
    The sets of poses of the robots with sensors.

    Parameters
    ----------
    snapshot : Snapshot
    solved : Constraints
        Of the points that are placed together.
    held : collection of int
        Rows of robots whose body frame is the fixed frame.

    """

    def __init__(self, snapshot: Snapshot, solved: Constraints, held: Collection[int]) -> None:
        self._config, self._mounts, self._solved = snapshot.config, snapshot.mounts, solved
        members = self._mounts.members
        self._bodies = {
            solved.rows[robot]: members[robot]
            for robot in members
            if solved.dimension == 2 and solved.rows.get(robot, -1) not in {-1, *held}
        }
        self._options = PairOptions(resolution_m=self._config.solver.resolution)
        self._n_covers = 0

    def narrow(
        self, hypothesis: Hypothesis, enclosure: Interval
    ) -> tuple[Interval, Mapping[int, tuple[float, float]]] | None:
        """
        Return what the poses leave of an enclosure, and the headings they leave.

        Parameters
        ----------
        hypothesis : Hypothesis
        enclosure : Interval, shape (n, q)
            In m, in the fixed frame.

        Returns
        -------
        enclosure : Interval, shape (n, q)
        headings : mapping of int to tuple of float
            By row of the robot, in rad: counterclockwise from the first to the second.

        None when some robot has no pose, so that the hypothesis holds no placement.

        """
        low_m, high_m = np.array(enclosure.lower), np.array(enclosure.upper)
        headings = {}
        for row, members in self._bodies.items():
            cover = self._cover(members, hypothesis, Interval(low_m, high_m))
            if cover is None or not cover.bounded:
                continue
            if cover.empty:
                return None
            hull = cover.hull
            low_m[row] = np.maximum(low_m[row], hull.lower_m[:2])
            high_m[row] = np.minimum(high_m[row], hull.upper_m[:2])
            if (low_m[row] > high_m[row]).any():
                return None
            headings[row] = hull.yaw_rad
        return Interval(low_m, high_m), headings

    def _cover(
        self, members: tuple[str, ...], hypothesis: Hypothesis, enclosure: Interval
    ) -> Cover | None:
        """Return all poses of a robot that agree; None where nothing is known, or no more time."""
        readings = self._readings(members, hypothesis, enclosure)
        if not readings or self._n_covers >= MOST_COVERS:
            return None
        self._n_covers += 1
        others = [reading.other for reading in readings]
        distances_m = np.array([reading.distance_m for reading in readings])
        return cover_poses(
            PairReadings.of(
                _in_space(enclosure[others]),
                places_on_body(self._config, [reading.member for reading in readings]),
                Interval(distances_m[:, 0], distances_m[:, 1]),
                np.array([reading.ray for reading in readings]),
                np.array([reading.error_rad for reading in readings]),
                np.ones(len(readings), dtype=bool),
            ),
            self._options,
        )

    def _readings(
        self, members: tuple[str, ...], hypothesis: Hypothesis, enclosure: Interval
    ) -> list[_Reading]:
        """Return what ties the points of a robot to points that have an enclosure."""
        rows = self._solved.rows
        own = {rows[member] for member in members}
        bounded = np.isfinite(enclosure.lower).all(axis=1) & np.isfinite(enclosure.upper).all(
            axis=1
        )
        others = [row for row in np.flatnonzero(bounded).tolist() if row not in own]
        distance_m = Interval(hypothesis.lower, hypothesis.upper).sqrt()
        readings = [
            _Reading(
                member,
                other,
                (
                    float(distance_m.lower[rows[member], other]),
                    float(distance_m.upper[rows[member], other]),
                ),
            )
            for member in members
            for other in others
            if math.isfinite(self._solved.upper[rows[member], other])
        ]
        for member in members:
            for ray in self._solved.rays.get(member, ()):
                other = rows[ray.key.target]
                if other in others and ray.half_width_rad < math.pi / 2:
                    direction = tuple(ray.direction.tolist())
                    readings.append(
                        _Reading(member, other, ray=direction, error_rad=ray.half_width_rad)
                    )
        return readings


def _in_space(points: Interval) -> Interval:
    """Return points of the plane with three coordinates."""
    missing = ((0, 0), (0, 1))
    return Interval(np.pad(points.lower, missing), np.pad(points.upper, missing))


def heading_within(
    heading: Heading | None, arc_rad: tuple[float, float], rotation: FloatArray
) -> Heading | None:
    """
    Return the narrower of a heading and an arc.

    Parameters
    ----------
    heading : Heading or None
        What the rays leave.
    arc_rad : tuple of float
        Counterclockwise from the first to the second.
    rotation : numpy.ndarray, shape (3, 3)
        The best fit; the heading is as near to it as the arc allows.

    """
    half_arc_rad = 0.5 * (arc_rad[1] - arc_rad[0])
    if half_arc_rad >= math.pi or (heading and heading.half_width_rad <= half_arc_rad):
        return heading
    middle_rad = 0.5 * (arc_rad[0] + arc_rad[1])
    fitted_rad = math.atan2(rotation[1, 0], rotation[0, 0])
    offset_rad = math.remainder(fitted_rad - middle_rad, 2.0 * math.pi)
    offset_rad = min(max(offset_rad, -half_arc_rad), half_arc_rad)
    half_yaw = 0.5 * (middle_rad + offset_rad)
    orientation = np.array([0.0, 0.0, math.sin(half_yaw), math.cos(half_yaw)])
    half_width_rad = angle_up(angle_up(half_arc_rad + abs(offset_rad)))
    return Heading(orientation, min(math.pi, half_width_rad))
