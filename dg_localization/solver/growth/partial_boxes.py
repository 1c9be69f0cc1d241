# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Placements of a rigid piece in space, found point by point.

Four points that all measure each other are placed first. Each further point that enough placed
ones measure lies in few regions of their frame, and each region makes a partial box of its own.
With each point all measured pairs so far are combined, so that errors do not pile up; a partial
box that contradicts them is dropped. Every placement of the piece lies in some partial box.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from dg_localization.solver.assemble.subproblem import Bounds
from dg_localization.solver.box import GAP_LOWER, LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.axes import axes_of, rank_axes
from dg_localization.solver.contract.combination import combine
from dg_localization.solver.contract.coordinates import enclose_in_frame
from dg_localization.solver.contract.groups import groups_of
from dg_localization.solver.contract.paving import distances_to_region, regions_of_point
from dg_localization.solver.contract.reduction import MOST_THROUGH, apply_axes, make_workspace
from dg_localization.solver.contract.reference import choose_axis, complete_frame, point_errors_m
from dg_localization.solver.contract.sides import sides_of
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.contract.widths import is_explained
from dg_localization.solver.growth.seeds import best_seed
from dg_localization.solver.place.placements import place
from dg_localization.solver.problem import Problem

MOST_PARTIAL_BOXES = 32
"""Growth ends when there are more of them: the search goes on from what they are."""

MOST_REGIONS = 4
"""A point that can be in more regions than this is not placed yet."""

LEAST_REGION = 0.01
"""Regions are made of boxes no smaller than this fraction of the longest distance."""

LOCAL_POINTS = 12
"""Axes project so many points, those best known from their ends."""

WELL_EXPLAINED = 2.0
"""Axes are of use where pairs are wider than so many times what the errors explain."""

MOST_COMBINED, COMBINED_GROWTH = 60, 1.15
"""Beyond so many points their pairs are combined only when there are so many times more, and where
a point can be is looked at again only when it measures so many times more of them."""

REFERENCE_STEPS = 3
"""Steps of least squares towards a placement, by which frames are chosen."""


@dataclass(frozen=True)
class _Trial:
    """Where a further point can be, in the frame of some points of a partial box."""

    n_links: int
    frame: IntArray
    regions: FloatArray

    def rank(self) -> tuple[int, float]:
        """Return what makes a point wait: several regions, or large ones."""
        sides_m = self.regions[:, UPPER] - self.regions[:, LOWER]
        return len(self.regions), float(sides_m.max(initial=0.0))


@dataclass
class PartialBox:
    """The points that are placed so far, in one of the ways that they can be."""

    points: tuple[int, ...]
    box: FloatArray
    n_combined: int
    trials: dict[int, _Trial] = field(default_factory=dict)


class Growth:
    """Places the points of a problem in space one after the other."""

    def __init__(self, problem: Problem, resolution_m: float, stopped: Callable[[], bool]) -> None:
        self._problem = problem
        self._resolution_m = resolution_m
        self._stopped = stopped
        self._measured = np.isfinite(problem.upper) & ~np.eye(problem.n_points, dtype=np.bool_)

    def run(self) -> list[PartialBox] | None:
        """Return partial boxes between which every placement lies."""
        seed = best_seed(self._problem, self._measured, self._stopped)
        if seed is None:
            return None
        box = self._contracted(seed, self._box_of(seed))
        growing = [] if box is None else [PartialBox(seed, box, len(seed))]
        grown: list[PartialBox] = []
        while growing and len(growing) + len(grown) <= MOST_PARTIAL_BOXES and not self._stopped():
            partial = growing.pop()
            new = self._extended(partial)
            if new is None:
                grown.append(partial)
            else:
                growing.extend(new)
        return grown + growing

    def bounds(self, partial: PartialBox) -> Bounds:
        """Return bounds of all pairs of the problem for the placements in a partial box."""
        lower, upper = self._problem.lower.copy(), self._problem.upper.copy()
        index = np.ix_(partial.points, partial.points)
        lower[index], upper[index] = partial.box[LOWER], partial.box[UPPER]
        return lower, upper

    def _box_of(self, points: tuple[int, ...]) -> FloatArray:
        """Return what the problem says of some points."""
        index = np.ix_(points, points)
        box = np.zeros((4, len(points), len(points)))
        box[LOWER], box[UPPER] = self._problem.lower[index], self._problem.upper[index]
        return box

    def _extended(self, partial: PartialBox) -> list[PartialBox] | None:
        """Return what becomes of a partial box with one more point, None where there is none."""
        n_links = self._measured[:, partial.points].sum(axis=1)
        n_links[list(partial.points)] = 0
        within_reach = np.flatnonzero(n_links >= self._problem.dimension).tolist()
        if not within_reach:
            return None
        positions = place(partial.box, self._problem.dimension, REFERENCE_STEPS)
        for point in within_reach:
            trial = partial.trials.get(point)
            if trial is None or _is_outdated(trial, n_links[point], len(partial.points)):
                trial = self._trial(partial, positions, point)
            if len(trial.regions) == 0:
                return []
            partial.trials[point] = trial
        best = min(within_reach, key=lambda point: (*partial.trials[point].rank(), point))
        if partial.trials[best].n_links < n_links[best]:
            partial.trials[best] = self._trial(partial, positions, best)
        if len(partial.trials[best].regions) > MOST_REGIONS:
            return None
        return list(self._with_point(partial, best))

    def _trial(self, partial: PartialBox, positions: FloatArray, point: int) -> _Trial:
        """Return where a further point can be."""
        members = np.array(partial.points)
        neighbors = np.flatnonzero(self._measured[point, members])
        frame = _frame(partial.box, positions, neighbors)
        enclosure = enclose_in_frame(partial.box, frame)[neighbors]
        lower = self._problem.lower[point, members[neighbors]]
        upper = self._problem.upper[point, members[neighbors]]
        regions = regions_of_point(enclosure, lower, upper, LEAST_REGION)
        return _Trial(len(neighbors), frame, regions)

    def _with_point(self, partial: PartialBox, point: int) -> Iterator[PartialBox]:
        """Return partial boxes with one more point, one for each region that it can be in."""
        trial = partial.trials[point]
        points, size = (*partial.points, point), len(partial.points)
        enclosure = enclose_in_frame(partial.box, trial.frame)
        trials = {other: t for other, t in partial.trials.items() if other != point}
        n_combined = len(points)
        if n_combined > MOST_COMBINED and n_combined < COMBINED_GROWTH * partial.n_combined:
            n_combined = partial.n_combined
        for region in trial.regions:
            box = self._box_of(points)
            box[:, :size, :size] = partial.box
            if distances_to_region(region, enclosure, box, size):
                if n_combined == len(points):
                    left = self._contracted(points, box)
                else:
                    left = box if _smoothed(box) else None
                if left is not None:
                    yield PartialBox(points, left, n_combined, dict(trials))

    def _contracted(self, points: tuple[int, ...], box: FloatArray) -> FloatArray | None:
        """Contract the box of some points; None when it is proved to hold no placement."""
        index = np.ix_(points, points)
        lower, upper = self._problem.lower[index], self._problem.upper[index]
        part = Problem.unchecked((lower, upper), self._problem.dimension, (), ())
        groups, explained = groups_of(lower, upper), np.zeros(lower.shape)
        if not _smoothed(box):
            return None
        if not combine(*groups, box, part.dimension, explained):
            return None
        if is_explained(box, explained, WELL_EXPLAINED, self._resolution_m):
            return box
        axes = rank_axes(box, axes_of(part))[: len(groups.edges)]
        count = LOCAL_POINTS if len(points) > MOST_THROUGH else len(points)
        work = make_workspace(len(points), part.dimension)
        work.box[:] = box
        if not apply_axes(*work, *sides_of(part), part.dimension, axes, count):
            return None
        box = work.box.copy()
        # Each gap is one of a pair alone: the search looks for them again.
        box[GAP_LOWER:] = 0.0
        return box if combine(*groups, box, part.dimension, explained) else None


def _is_outdated(trial: _Trial, n_links: int, n_points: int) -> bool:
    """Return whether a point measures so many more placed ones that it is looked at again."""
    growth = 1.0 if n_points <= MOST_COMBINED else COMBINED_GROWTH
    return n_links > trial.n_links and n_links >= growth * trial.n_links


def _smoothed(box: FloatArray) -> bool:
    """Narrow a box by the triangle inequalities in place; return whether anything is left."""
    return bool(smooth_triangles(box, np.empty_like(box), np.arange(box.shape[1])))


def _frame(box: FloatArray, positions: FloatArray, neighbors: IntArray) -> IntArray:
    """Return a frame for a point: two of its neighbors, and points well known from them."""
    dimension = positions.shape[1]
    frame = np.full(dimension + 1, -1)
    errors_m = point_errors_m(box, neighbors)
    if choose_axis(positions[neighbors], errors_m[neighbors], frame):
        frame[:2] = neighbors[frame[:2]]
    else:
        frame[:2] = neighbors[:2]
    if not complete_frame(positions, errors_m, frame, np.zeros((dimension, dimension))):
        # Positions that are no numbers; any frame is sound.
        frame[:] = np.arange(dimension + 1)
    return frame
