# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
From the hypotheses of the solver to placements of the fleet in the fixed frame.

The solver bounds distances. The next steps are: choose a mirror image, enclose the coordinates in
a frame of the fleet's own points, register that frame with the fixed frame, estimate the headings
and assemble the rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.best_point import BestPoint, BestPointFinder
from dg_localization.fleet.bodies import AnchorGeometry
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import FrameKind, Placement, spread_out
from dg_localization.fleet.frames.enclosure import Encloser, MirrorImage, Placed
from dg_localization.fleet.frames.finders import finder_of
from dg_localization.fleet.frames.headings import (
    NO_TURN,
    BodyPoses,
    Heading,
    NoHeadingError,
    estimate_heading,
    heading_within,
)
from dg_localization.fleet.frames.plan import FramePlan
from dg_localization.fleet.frames.regions import regions_of
from dg_localization.fleet.frames.registration import Registration
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey, RayReading
from dg_localization.interval.arrays import Interval
from dg_localization.solver.problem import Chirality
from dg_localization.solver.result import Hypothesis

FloatArray = NDArray[np.float64]


class Placer:
    """
    Turns the hypotheses of one problem into placements in the fixed frame.

    `constraints` are the constraints of all points of the fleet without the `dropped` links.

    Attributes
    ----------
    points : tuple of int
        The points of the problem: the connected points without idle anchors.
    problem : Problem
    most_images : int
        The greatest number of placements of one hypothesis.

    """

    def __init__(
        self,
        snapshot: Snapshot,
        constraints: Constraints,
        plan: FramePlan,
        dropped: frozenset[LinkKey],
    ) -> None:
        self._snapshot = snapshot
        self._config = snapshot.config
        self._dropped = dropped
        chiralities: tuple[Chirality, ...] = ()
        if plan.frame.kind is FrameKind.ANCHORS:
            n_robots = len(self._config.robots)
            plan, chiralities = _without_idle(constraints, plan, n_robots, snapshot.anchors)
        self._plan, solved = plan, constraints.of(plan.points)
        place = {point: row for row, point in enumerate(plan.points)}
        of_anchors = (Chirality(tuple(place[p] for p in c.points), c.sign) for c in chiralities)
        known = tuple(dict.fromkeys((*solved.chiralities, *of_anchors)))
        self._solved = replace(solved, chiralities=known)
        self._registration = Registration(
            plan.frame.kind,
            self._solved,
            tuple(tuple(place[p] for p in core) for core in plan.cores if place.keys() >= {*core}),
            plan.by_row(snapshot.anchors.boxes),
        )
        self._encloser = Encloser(self._solved, self._registration)
        self._body_poses = BodyPoses(snapshot, self._solved, plan.held)
        self.points, self.problem = plan.points, self._solved.problem()
        self.most_images = self._encloser.most_images

    def placements(
        self, hypothesis: Hypothesis, *, alone: bool, apart: bool = True
    ) -> list[Placement]:
        """
        Return the placements of a hypothesis: one, or two that mirror each other.

        There are none if the rays rule out every heading of some robot. `alone` says that there is
        no other hypothesis, `apart` that parts which do not touch become separate placements.
        """
        placements: list[Placement] = []
        images = self._encloser.enclose(hypothesis)
        bounds_m2 = Interval(hypothesis.lower, hypothesis.upper)
        among = None if alone and len(images) == 1 else (bounds_m2.lower, bounds_m2.upper)
        for image, region in self._regions(hypothesis, images) if apart else images:
            narrowed = self._body_poses.narrow(hypothesis, region)
            if narrowed is None:
                continue
            enclosure = narrowed[0]
            start = self._start(hypothesis, image, enclosure)
            best = self._best_points.find(start, enclosure, among)
            try:
                headings = self._headings(best, enclosure, narrowed[1])
            except NoHeadingError:
                continue
            mirrored = bool(placements) and image is not images[0][0]
            flexible = hypothesis.flexible or self._is_flexible(hypothesis)
            placement = self._assembled(best, enclosure, headings, bounds_m2.sqrt())
            placements.append(replace(placement, flexible=flexible, mirrored=mirrored))
        return placements

    def _regions(self, hypothesis: Hypothesis, images: list[Placed]) -> Iterator[Placed]:
        """Yield the connected parts of mirror images."""
        anchors = self._registration.anchors
        rows = [row for row in range(len(self.points)) if row not in anchors]
        most = self._config.max_hypotheses
        for image, whole in images:
            parts = regions_of(whole, hypothesis.lower, hypothesis.upper, rows, most)
            yield from ((image, part) for part in parts)

    def _start(
        self, hypothesis: Hypothesis, image: MirrorImage | None, enclosure: Interval
    ) -> FloatArray:
        """Return the placement of the solver, moved into the fixed frame and its enclosure."""
        if hypothesis.positions is None:
            return np.full(enclosure.lower.shape, np.nan)
        positions = np.array(hypothesis.positions)
        if image is not None:
            corner = positions[[*image.core, image.apex]]
            if np.linalg.det(corner[1:] - corner[0]) * image.sign < 0.0:
                positions[:, -1] *= -1.0
        moved = self._registration.moved(positions)
        return np.clip(moved, enclosure.lower, enclosure.upper)

    def _is_flexible(self, hypothesis: Hypothesis) -> bool:
        """Return whether points may move although the solver takes their bounds for measured."""
        if self._solved.all_measured:
            return False
        robots = [self._config.robot_of(point) for point in self._solved.points]
        return self._solved.is_flexible(hypothesis.positions, robots)

    @cached_property
    def _best_points(self) -> BestPointFinder:
        """The finder of best points, by all readings; made on first use."""
        return finder_of(self._snapshot, self._solved, self._plan, self._dropped)

    def _headings(
        self, best: BestPoint, enclosure: Interval, arcs_rad: Mapping[int, tuple[float, float]]
    ) -> dict[int, Heading]:
        """Return the known headings by index into the points of the fleet."""
        rows = self._solved.rows
        rays_of: dict[str, list[RayReading]] = {}
        for observer, rays in self._solved.rays.items():
            rays_of.setdefault(self._config.robot_of(observer), []).extend(rays)
        headings = {}
        for robot, own_rays in rays_of.items():
            heading: Heading | None = NO_TURN
            if rows[robot] not in self._plan.held:
                heading = estimate_heading(rows, own_rays, best.positions_m, enclosure)
                arc_rad = arcs_rad.get(rows[robot])
                if arc_rad is not None:
                    heading = heading_within(heading, arc_rad, best.rotations[rows[robot]])
            if heading is not None:
                headings[self._plan.points[rows[robot]]] = heading
        return headings

    def _assembled(
        self,
        best: BestPoint,
        enclosure: Interval,
        headings: Mapping[int, Heading],
        distances_m: Interval,
    ) -> Placement:
        """Return a placement of the whole fleet; points outside the plan are unknown."""
        n_points, n_robots = len(self._config.points), len(self._config.robots)
        # The rows after the landmarks are sensors.
        landmarks = slice(n_robots, n_robots + len(self._config.landmarks))
        points = list(self.points)
        positions = spread_out(n_points, points, best.positions_m)
        boxes = np.empty((n_points, 2, self._config.dimension))
        boxes[:, 0], boxes[:, 1] = -np.inf, np.inf
        if self._plan.frame.kind is FrameKind.ANCHORS:
            for point, box in self._snapshot.anchors.boxes.items():
                boxes[point] = box.lower, box.upper
                positions[point] = 0.5 * (box.lower + box.upper)
        positions[points] = best.positions_m
        boxes[points, 0], boxes[points, 1] = enclosure.lower, enclosure.upper
        orientations = np.full((n_robots, 4), np.nan)
        half_widths = np.full(n_robots, np.pi)
        for point, heading in headings.items():
            if point < n_robots:
                orientations[point] = heading.orientation_xyzw
                half_widths[point] = heading.half_width_rad
        apart = np.zeros((2, n_points, n_points))
        apart[1] = np.inf
        among = np.ix_(points, points)
        apart[0][among], apart[1][among] = distances_m.lower, distances_m.upper
        np.fill_diagonal(apart[1], 0.0)
        return Placement(
            positions_m=positions[:n_robots],
            enclosure_m=boxes[:n_robots],
            orientations_xyzw=orientations,
            heading_known=~np.isnan(orientations[:, 0]),
            heading_half_width_rad=half_widths,
            proved=best.proved,
            flexible=False,
            mirrored=False,
            landmarks_m=positions[landmarks],
            landmark_enclosure_m=boxes[landmarks],
            lower_m=apart[0, :n_robots, :n_robots],
            upper_m=apart[1, :n_robots, :n_robots],
            dropped=tuple(sorted(self._dropped)),
            covariances=spread_out(n_points, points, best.covariances)[:n_robots],
            fitted_yaws_rad=spread_out(n_points, points, best.fitted_yaws_rad())[:n_robots],
        )


def _without_idle(
    known: Constraints, plan: FramePlan, n_robots: int, anchors: AnchorGeometry
) -> tuple[FramePlan, tuple[Chirality, ...]]:
    """
    Return a plan without idle anchors, and the chiralities of its anchors.

    An idle anchor is tied to other anchors only; each point costs solver time. If the remaining
    anchors do not fix the frame, the anchors that span most are added. Anchors that are robots
    are never idle.
    """
    landmarks = {p for p in plan.points if p >= n_robots and p in anchors.boxes}
    others = [point for point in plan.points if point not in landmarks]
    tied = np.isfinite(known.upper[:, others]) | (known.lower[:, others] > 0.0)
    ranged = {*others, *np.flatnonzero(tied.any(axis=1)).tolist()}
    busy = ranged | {
        known.rows[ray.key.target] for o in others for ray in known.rays.get(known.points[o], ())
    }
    # Ranged anchors give the best axes. Others may tell them from their mirror image.
    geometries = map(anchors.among, (ranged, busy))
    geometry = next((one for one in geometries if one.chiralities), anchors)
    busy |= geometry.spanning
    points = tuple(point for point in plan.points if point in busy)
    return plan._replace(points=points, cores=geometry.cores), geometry.chiralities
