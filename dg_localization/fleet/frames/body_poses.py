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
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.mounts import places_on_body
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.interval.arrays import Interval
from dg_localization.poses import NO_RAY_RAD, Cover, PairOptions, PairReadings, cover_poses
from dg_localization.solver.result import Hypothesis

FloatArray = NDArray[np.float64]

MOST_COVERS = 16
"""How many sets of poses are searched at most for the hypotheses of one problem."""


class BodyPoses:
    """The sets of poses of the robots with sensors, but for those whose body frame is held."""

    def __init__(self, snapshot: Snapshot, solved: Constraints, held: Collection[int]) -> None:
        self._config, self._solved = snapshot.config, solved
        members = snapshot.mounts.members
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
        Return what the poses leave of an enclosure (n, q), and the headings by row of the robot.

        A heading is an arc in rad, counterclockwise from the first to the second. None when some
        robot has no pose, so that the hypothesis holds no placement.
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
        rows = self._solved.rows
        bounded = np.isfinite(enclosure.lower).all(axis=1) & np.isfinite(enclosure.upper).all(1)
        others = {*np.flatnonzero(bounded).tolist()} - {rows[member] for member in members}
        anywhere, ahead = (0.0, math.inf), (1.0, 0.0, 0.0)
        distance_m = Interval(hypothesis.lower, hypothesis.upper).sqrt()
        # A member, the row of another point, and a distance or a ray with its error.
        readings = []
        for member in members:
            for other in sorted(others):
                if math.isfinite(self._solved.upper[rows[member], other]):
                    between = distance_m[rows[member], other]
                    bounds_m = float(between.lower), float(between.upper)
                    readings.append((member, other, bounds_m, ahead, NO_RAY_RAD))
        for member in members:
            for ray in self._solved.rays.get(member, ()):
                other, direction = rows[ray.key.target], tuple(ray.direction.tolist())
                if other in others and ray.half_width_rad < math.pi / 2:
                    readings.append((member, other, anywhere, direction, ray.half_width_rad))
        if not readings or self._n_covers >= MOST_COVERS:
            return None
        self._n_covers += 1
        names, targets, distances_m, rays, errors_rad = map(list, zip(*readings, strict=True))
        places_m, flat = enclosure[targets], ((0, 0), (0, 1))
        lower_m, upper_m = np.array(distances_m).T
        return cover_poses(
            PairReadings.of(
                Interval(np.pad(places_m.lower, flat), np.pad(places_m.upper, flat)),
                places_on_body(self._config, names),
                Interval(lower_m, upper_m),
                np.array(rays),
                np.array(errors_rad),
                np.ones(len(readings), dtype=bool),
            ),
            self._options,
        )
