# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
From the hypotheses of the solver to placements of the fleet in the fixed frame.

The solver bounds distances. The steps from there: choose a mirror image, enclose the coordinates
in a frame of the fleet's own points and register that with the fixed frame, estimate the headings,
assemble the rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.best_point import BestPoint, BestPointFinder
from dg_localization.fleet.bodies import AnchorGeometry
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import FrameKind, Placement
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
from dg_localization.solver.problem import Chirality, Problem
from dg_localization.solver.result import Hypothesis

FloatArray = NDArray[np.float64]


class Placer:
    """
    Turns the hypotheses of one problem into placements in the fixed frame.

    `constraints` are those of all points of the fleet, without the `dropped` links.
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
        self._plan = plan
        self._dropped = dropped
        self._all = constraints.of(plan.points)
        self._rows = tuple(range(len(plan.points)))
        cores = plan.cores
        if plan.frame.kind is FrameKind.ANCHORS:
            n_robots = len(self._config.robots)
            self._rows, geometry = _busy(self._all, plan.points, n_robots, snapshot.anchors)
            cores = geometry.cores
            row_of = {point: row for row, point in enumerate(plan.points)}
            of_anchors = (
                Chirality(tuple(row_of[point] for point in one.points), one.sign)
                for one in geometry.chiralities
            )
            known = dict.fromkeys((*self._all.chiralities, *of_anchors))
            self._all = replace(self._all, chiralities=tuple(known))
        self._solved = self._all.of(self._rows)
        self.points = tuple(plan.points[row] for row in self._rows)
        place = {point: row for row, point in enumerate(self.points)}
        boxes = snapshot.anchors.boxes
        self._registration = Registration(
            plan.frame.kind,
            self._solved,
            tuple(tuple(place[p] for p in core) for core in cores if place.keys() >= {*core}),
            {place[point]: box for point, box in boxes.items() if point in place},
        )
        self._encloser = Encloser(self._solved, self._registration)
        held = [self._rows.index(row) for row in plan.held]
        self._body_poses = BodyPoses(snapshot, self._solved, held)

    @cached_property
    def problem(self) -> Problem:
        """What the solver is asked, of `points`."""
        return self._solved.problem()

    @property
    def most_images(self) -> int:
        """How many placements a hypothesis stands for at most."""
        return self._encloser.most_images

    def placements(
        self, hypothesis: Hypothesis, *, alone: bool, apart: bool = True
    ) -> list[Placement]:
        """
        Return the placements a hypothesis stands for: one, or two that mirror each other.

        There are none when the rays rule out every heading of some robot. `alone` says that there
        is no other hypothesis, `apart` that parts which do not touch are placements of their own.
        """
        placements: list[Placement] = []
        images = self._encloser.enclose(hypothesis)
        bounds_m2 = self._bounds_of_all(hypothesis)
        among = None if alone and len(images) == 1 else (bounds_m2.lower, bounds_m2.upper)
        for image, region in self._regions(hypothesis, images) if apart else images:
            narrowed = self._body_poses.narrow(hypothesis, region)
            if narrowed is None:
                continue
            enclosure = self._coordinates_of_all(narrowed[0])
            start = self._start_of_all(hypothesis, image, enclosure)
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
        rows = [row for row in range(len(self._rows)) if row not in anchors]
        most = self._config.max_hypotheses
        for image, whole in images:
            parts = regions_of(whole, hypothesis.lower, hypothesis.upper, rows, most)
            yield from ((image, part) for part in parts)

    def _bounds_of_all(self, hypothesis: Hypothesis) -> Interval:
        """Return bounds of the squared distances in m^2 of all points, idle anchors included."""
        lower, upper = self._all.lower.copy(), self._all.upper.copy()
        among = np.ix_(self._rows, self._rows)
        lower[among], upper[among] = hypothesis.lower, hypothesis.upper
        return Interval(lower, upper)

    def _coordinates_of_all(self, enclosure: Interval) -> Interval:
        """Return the coordinates (n, q) of all points, idle anchors included."""
        if len(self._rows) == len(self._plan.points):
            return enclosure
        boxes = self._snapshot.anchors.boxes
        known = {point: enclosure[row] for row, point in enumerate(self.points)}
        return Interval.stack([known.get(p) or boxes[p] for p in self._plan.points], axis=0)

    def _start_of_all(
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
        start = 0.5 * (enclosure.lower + enclosure.upper)
        start[list(self._rows)] = self._registration.moved(positions)
        return np.clip(start, enclosure.lower, enclosure.upper)

    def _is_flexible(self, hypothesis: Hypothesis) -> bool:
        """Return whether points may move whose bounds the solver takes for measured."""
        if self._solved.all_measured:
            return False
        robots = [self._config.robot_of(point) for point in self._solved.points]
        return self._solved.is_flexible(hypothesis.positions, robots)

    @cached_property
    def _best_points(self) -> BestPointFinder:
        """What finds the best points, by all readings; a contradiction does not need it."""
        return finder_of(self._snapshot, self._all, self._plan, self._dropped)

    def _headings(
        self, best: BestPoint, enclosure: Interval, arcs_rad: Mapping[int, tuple[float, float]]
    ) -> dict[int, Heading]:
        """Return the headings that are known, by index into the points of the fleet."""
        rows = self._all.rows
        rays_of: dict[str, list[RayReading]] = {}
        for observer, rays in self._all.rays.items():
            rays_of.setdefault(self._config.robot_of(observer), []).extend(rays)
        headings = {}
        for robot, own_rays in rays_of.items():
            heading: Heading | None = NO_TURN
            if rows[robot] not in self._plan.held:
                heading = estimate_heading(rows, own_rays, best.positions_m, enclosure)
                arc_rad = arcs_rad.get(self._solved.rows[robot])
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
        """Return a placement of the whole fleet, unknown where the points are not in the plan."""
        n_points, n_robots = len(self._config.points), len(self._config.robots)
        # The rows after those are sensors.
        landmarks = slice(n_robots, n_robots + len(self._config.landmarks))
        points = list(self._plan.points)
        positions = np.full((n_points, self._config.dimension), np.nan)
        positions[points] = best.positions_m
        boxes = np.empty((n_points, 2, self._config.dimension))
        boxes[:, 0], boxes[:, 1] = -np.inf, np.inf
        boxes[points, 0], boxes[points, 1] = enclosure.lower, enclosure.upper
        covariances = np.full((n_points, 6, 6), np.nan)
        covariances[points] = best.covariances
        fitted_yaws = np.full(n_points, np.nan)
        fitted_yaws[points] = best.fitted_yaws_rad()
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
            covariances=covariances[:n_robots],
            fitted_yaws_rad=fitted_yaws[:n_robots],
        )


def _busy(
    solved: Constraints, points: Sequence[int], n_robots: int, anchors: AnchorGeometry
) -> tuple[tuple[int, ...], AnchorGeometry]:
    """
    Return the rows that are no idle anchors, and the geometry of the anchors that fixes the frame.

    Nothing ties an idle anchor to any point but other anchors, and the solver takes longer with
    every point. Where the others do not fix the frame, the anchors that span most are added. An
    anchor among the robots is never idle.
    """
    landmarks = {
        row for row, point in enumerate(points) if point >= n_robots and point in anchors.boxes
    }
    others = [row for row in range(len(points)) if row not in landmarks]
    known = np.isfinite(solved.upper[:, others]) | (solved.lower[:, others] > 0.0)
    busy = {*others, *np.flatnonzero(known.any(axis=1)).tolist()}
    busy |= {solved.rows[ray.key.target] for rays in solved.rays.values() for ray in rays}
    geometry = anchors.among([points[row] for row in busy])
    if not geometry.chiralities:
        # The idle ones may tell the others from their mirror image.
        geometry = anchors
        busy |= {row for row, point in enumerate(points) if point in anchors.spanning}
    return tuple(sorted(busy)), geometry
