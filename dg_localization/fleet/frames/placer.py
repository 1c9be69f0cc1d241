# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
From the hypotheses of the solver to placements of the fleet in the fixed frame.

The solver bounds distances. The steps from there: choose a mirror image, enclose the coordinates
in a frame of the fleet's own points and register that with the fixed frame, estimate the headings,
assemble the rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.best_point import BestPoint, BestPointFinder
from dg_localization.fleet.best_point.past import past_of
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import FrameKind, Placement
from dg_localization.fleet.frames.assembly import PlacedPoints, assemble
from dg_localization.fleet.frames.body_poses import BodyPoses, heading_within
from dg_localization.fleet.frames.enclosure import Encloser
from dg_localization.fleet.frames.finders import finder_of
from dg_localization.fleet.frames.headings import (
    NO_TURN,
    Heading,
    NoHeadingError,
    estimate_heading,
)
from dg_localization.fleet.frames.idle_anchors import Busy, busy_of, completed
from dg_localization.fleet.frames.mirror_images import (
    ChiralityChoice,
    possible_choices,
    rigid_with,
)
from dg_localization.fleet.frames.plan import FramePlan
from dg_localization.fleet.frames.regions import regions_of
from dg_localization.fleet.frames.registration import Registration
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey, RayReading
from dg_localization.interval.arrays import Interval
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis

FloatArray = NDArray[np.float64]


class Placer:
    """
    Turns the hypotheses of one problem into placements in the fixed frame.

    Parameters
    ----------
    snapshot : Snapshot
    constraints : Constraints
        Of all points of the fleet.
    plan : FramePlan
    dropped : frozenset of LinkKey
        What `constraints` leave out.

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
        self._solved = constraints.of(plan.points)
        row_of = {point: row for row, point in enumerate(plan.points)}
        cores = tuple(tuple(row_of[point] for point in core) for core in plan.cores)
        busy = Busy(tuple(range(len(plan.points))), cores)
        if plan.frame.kind is FrameKind.ANCHORS:
            n_robots = len(self._config.robots)
            busy = busy_of(self._solved, plan.points, n_robots, snapshot.anchors)
            known = dict.fromkeys((*self._solved.chiralities, *busy.chiralities))
            self._solved = replace(self._solved, chiralities=tuple(known))
        self._rows = busy.rows
        self._registration = Registration(
            plan.frame.kind,
            self._solved,
            cores=busy.cores,
            anchors=plan.by_row(snapshot.anchors.boxes),
        )
        self._rigid = rigid_with(self._registration.cores[0], self._solved) & {*self._rows}
        self._encloser = Encloser(self._solved, self._registration, self._rows)
        self._body_poses = BodyPoses(snapshot, self._solved, plan.held)

    def placements(
        self, hypothesis: Hypothesis, *, alone: bool, apart: bool = True
    ) -> list[Placement]:
        """
        Return the placements a hypothesis stands for: one, or two that mirror each other.

        There are none when the rays rule out every heading of some robot. `alone` says that there
        is no other hypothesis, `apart` that parts which do not touch are placements of their own.
        """
        placements: list[Placement] = []
        anchors = self._registration.anchors
        hypothesis = completed(hypothesis, self._rows, self._solved, anchors)
        images = self._mirror_images(hypothesis)
        among = None if alone and len(images) == 1 else (hypothesis.lower, hypothesis.upper)
        for choice, region in self._regions(hypothesis, images) if apart else images:
            narrowed = self._body_poses.narrow(hypothesis, region)
            if narrowed is None:
                continue
            enclosure, arcs_rad = narrowed
            start = self._fixed_positions(hypothesis, choice, enclosure)
            best = self._best_points.find(start, enclosure, among)
            mirrored = bool(placements) and choice is not images[0][0]
            placement = self._complete(hypothesis, best, enclosure, arcs_rad, mirrored)
            placements += [placement] if placement is not None else []
        return placements

    @cached_property
    def problem(self) -> Problem:
        """What the solver is asked, of `points`."""
        return self._solved.of(self._rows).problem()

    @property
    def points(self) -> tuple[int, ...]:
        """The points of the plan without idle anchors."""
        return tuple(self._plan.points[row] for row in self._rows)

    @property
    def most_images(self) -> int:
        """How many placements a hypothesis stands for at most."""
        short = len(self._registration.cores[0]) < self._solved.dimension
        return 1 if self._solved.chiralities or short or not self._rigid else 2

    def _choices(self, hypothesis: Hypothesis) -> list[ChiralityChoice | None]:
        """Return the mirror images that the known chiralities allow."""
        core = self._registration.cores[0]
        return possible_choices(hypothesis, self._solved, core, self._rigid)

    def _mirror_images(
        self, hypothesis: Hypothesis
    ) -> list[tuple[ChiralityChoice | None, Interval]]:
        """Return the different mirror images of a hypothesis with their enclosures."""
        found = self._encloser.enclose(hypothesis, self._choices(hypothesis))
        if len(found) < 2:
            return found
        (_, first), (_, second) = found
        if self._solved.chiralities:
            # Only one is true, but which one depends on where in the hypothesis the truth is.
            return [(None, first.hull(second))]
        return found[:1] if _equal(first, second) else found

    def _regions(
        self, hypothesis: Hypothesis, images: list[tuple[ChiralityChoice | None, Interval]]
    ) -> Iterator[tuple[ChiralityChoice | None, Interval]]:
        """Yield the connected parts of mirror images."""
        rows = [row for row in self._rows if row not in self._registration.anchors]
        most = self._config.max_hypotheses
        for choice, whole in images:
            parts = regions_of(whole, hypothesis.lower, hypothesis.upper, rows, most)
            yield from ((choice, part) for part in parts)

    def _fixed_positions(
        self, hypothesis: Hypothesis, choice: ChiralityChoice | None, enclosure: Interval
    ) -> FloatArray:
        """Return the placement of the solver, moved into the fixed frame and its enclosure."""
        if hypothesis.positions is None:
            return np.full(enclosure.lower.shape, np.nan)
        positions = np.array(hypothesis.positions)
        if choice is not None:
            corner = positions[[*choice.core, choice.apex]]
            if np.linalg.det(corner[1:] - corner[0]) * choice.sign < 0.0:
                positions[:, -1] *= -1.0
        return np.clip(self._registration.moved(positions), enclosure.lower, enclosure.upper)

    def _complete(
        self,
        hypothesis: Hypothesis,
        best: BestPoint,
        enclosure: Interval,
        arcs_rad: Mapping[int, tuple[float, float]],
        mirrored: bool,
    ) -> Placement | None:
        """Return the placement with headings; None when no heading is left."""
        try:
            headings = self._headings(best, enclosure, arcs_rad)
        except NoHeadingError:
            return None
        return assemble(
            self._config,
            PlacedPoints(
                self._plan.points,
                best.positions_m,
                enclosure,
                headings,
                best.covariances,
                best.fitted_yaws_rad(),
                Interval(hypothesis.lower, hypothesis.upper).sqrt(),
            ),
            proved=best.proved,
            flexible=hypothesis.flexible or self._is_flexible(hypothesis),
            mirrored=mirrored,
            dropped=self._dropped,
        )

    def _is_flexible(self, hypothesis: Hypothesis) -> bool:
        """Return whether sensors on robots, whose bounds the solver takes for measured, move."""
        if hypothesis.positions is None or not self._snapshot.mounts.distances:
            return False
        robots = [self._config.robot_of(point) for point in self._solved.points]
        return self._solved.is_flexible(hypothesis.positions, robots)

    @cached_property
    def _best_points(self) -> BestPointFinder:
        """What finds the best points, by all readings; a contradiction does not need it."""
        # What contradicts the rest now may have been wrong before.
        past = None if self._dropped else past_of(self._snapshot, self._solved)
        return finder_of(self._snapshot, self._solved, self._plan, past, self._dropped)

    def _headings(
        self,
        best: BestPoint,
        enclosure: Interval,
        arcs_rad: Mapping[int, tuple[float, float]],
    ) -> dict[int, Heading]:
        """Return the headings that are known, by index into the points of the fleet."""
        rows = self._solved.rows
        rays_of: dict[str, list[RayReading]] = {}
        for observer, rays in self._solved.rays.items():
            rays_of.setdefault(self._config.robot_of(observer), []).extend(rays)
        headings = {}
        for robot, own_rays in rays_of.items():
            heading: Heading | None = NO_TURN
            if rows[robot] not in self._plan.held:
                heading = estimate_heading(rows, own_rays, best.positions_m, enclosure)
                if rows[robot] in arcs_rad:
                    arc_rad, rotation = arcs_rad[rows[robot]], best.rotations[rows[robot]]
                    heading = heading_within(heading, arc_rad, rotation)
            if heading is not None:
                headings[self._plan.points[rows[robot]]] = heading
        return headings


def _equal(a: Interval, b: Interval) -> bool:
    """Return whether two enclosures are the same."""
    return bool(np.array_equal(a.lower, b.lower) and np.array_equal(a.upper, b.upper))
