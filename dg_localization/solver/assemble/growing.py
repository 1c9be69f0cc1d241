# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
How a rigid piece in space is solved: grown point by point first, then contracted as a whole.

Four points that all measure each other are placed first. Each further point that enough placed
ones measure lies in few regions of their frame, and each region makes a partial box of its own.
With each point all measured pairs so far are combined, so that errors do not pile up; a partial
box that contradicts them is dropped. Every placement of the piece lies in some partial box.

Where points are held weakly these boxes are wide. Halves of such a box would hold parts of one and
the same hypothesis, and so it is split at gaps alone. Boxes of many points stay as they grew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations, islice

import numpy as np

from dg_localization.solver.assemble.subproblem import (
    MOST_DENSE,
    MOST_TOGETHER,
    Bounds,
    as_box,
    parts_within,
)
from dg_localization.solver.box import GAP_LOWER, LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.coordinates import (
    distances_to_region,
    enclose_in_frame,
    regions_of_point,
)
from dg_localization.solver.contract.fixed_point import Contractor
from dg_localization.solver.contract.linearization import (
    choose_axis,
    complete_frame,
    point_errors_m,
)
from dg_localization.solver.contract.reduction import MOST_THROUGH
from dg_localization.solver.contract.triangles import smooth
from dg_localization.solver.contract.widths import is_finished
from dg_localization.solver.decompose.graph import BoolArray
from dg_localization.solver.place.placements import place
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.branch_and_prune import Paving
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.search.search import accept_pending, search_in_one_box, search_share

MOST_SEEDS = 2000
"""This many seeds are looked at."""


def _tetrahedra(neighbors: list[set[int]]) -> Iterator[tuple[int, ...]]:
    """Yield sets of four points that all measure each other."""
    for i, near in enumerate(neighbors):
        for j, k, other in combinations(sorted(x for x in near if x > i), 3):
            if k in neighbors[j] and other in neighbors[j] and other in neighbors[k]:
                yield i, j, k, other


def _qualities(lower: FloatArray, upper: FloatArray, corners: IntArray) -> FloatArray:
    """Return the squared volume of each tetrahedron, over its edges and their errors."""
    low, high = (bounds[corners[:, :, None], corners[:, None]] for bounds in (lower, upper))
    middle = 0.5 * (low + high)
    gram = 0.5 * (middle[:, 1:, :1] + middle[:, :1, 1:] - middle[:, 1:, 1:])
    longest, widest = high.max(axis=(1, 2)), (high - low).max(axis=(1, 2))
    # An exact one is as good as one known to a thousandth; edges may be zero or huge.
    with np.errstate(all='ignore'):
        gram /= longest[:, None, None]
        return np.asarray(np.linalg.det(gram) * longest / (widest + 1e-3 * longest))


def _reached(neighbors: list[set[int]], seed: tuple[int, ...], dimension: int) -> set[int]:
    """Return the points that are reached from a seed."""
    reached, waiting = set(seed), set(range(len(neighbors))) - set(seed)
    while new := {x for x in waiting if len(neighbors[x] & reached) >= dimension}:
        reached |= new
        waiting -= new
    return reached


def best_seed(
    problem: Problem, measured: BoolArray, stopped: Callable[[], bool]
) -> tuple[int, ...] | None:
    """Return the four points that most others are reached from, of these the best known ones."""
    neighbors = [set(np.flatnonzero(row).tolist()) for row in measured]
    corners = np.array(list(islice(_tetrahedra(neighbors), MOST_SEEDS)), dtype=np.int64)
    corners = corners.reshape(-1, 4)
    quality = _qualities(problem.lower, problem.upper, corners)
    best, best_reached = None, set[int]()
    for x in np.argsort(-quality, kind='stable').tolist():
        if best is not None and (stopped() or len(best_reached) == len(neighbors)):
            break
        seed = tuple(corners[x].tolist())
        if not quality[x] > 0.0 or best_reached.issuperset(seed):
            # What it reaches, the best one reaches as well.
            continue
        reached = _reached(neighbors, seed, problem.dimension)
        if len(reached) > len(best_reached):
            best, best_reached = seed, reached
    return best


MOST_PARTIAL_BOXES = 32
"""Growth ends when there are more of them: the search goes on from what they are."""

MOST_REGIONS = 4
"""A point that can be in more regions than this is not placed yet."""

LEAST_REGION = 0.01
"""Regions are made of boxes no smaller than this fraction of the longest distance."""

LOCAL_POINTS = 12
"""Axes project this many points, those best known from their ends."""

WELL_EXPLAINED = 2.0
"""Axes are of use where pairs are wider than this many times what the errors explain."""

COMBINED_GROWTH = 1.15
"""Beyond `MOST_TOGETHER` points their pairs are combined only when they grew by this factor, and
where a point can be is looked at again only when it measures as much more of them."""

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
        box = self._contracted(seed, as_box(self._problem.bounds_among(seed)))
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
        if n_combined > MOST_TOGETHER and n_combined < COMBINED_GROWTH * partial.n_combined:
            n_combined = partial.n_combined
        for region in trial.regions:
            box = as_box(self._problem.bounds_among(points))
            box[:, :size, :size] = partial.box
            if distances_to_region(region, enclosure, box, size):
                if n_combined == len(points):
                    left = self._contracted(points, box)
                else:
                    left = box if smooth(box) else None
                if left is not None:
                    yield PartialBox(points, left, n_combined, dict(trials))

    def _contracted(self, points: tuple[int, ...], box: FloatArray) -> FloatArray | None:
        """Contract the box of some points; None when it is proved to hold no placement."""
        bounds = self._problem.bounds_among(points)
        part = Problem.unchecked(bounds, self._problem.dimension, (), ())
        contractor, explained = Contractor(part, self._resolution_m), np.zeros(box.shape[1:])
        if not smooth(box) or not contractor.combine(box, explained):
            return None
        if is_finished(box, explained, WELL_EXPLAINED, self._resolution_m):
            return box
        count = LOCAL_POINTS if len(points) > MOST_THROUGH else len(points)
        left = contractor.projected(box, count)
        if left is None:
            return None
        # Each gap is one of a pair alone: the search looks for them again.
        left[GAP_LOWER:] = 0.0
        return left if contractor.combine(left, explained) else None


def _is_outdated(trial: _Trial, n_links: int, n_points: int) -> bool:
    """Return whether a point measures enough more placed ones to be looked at again."""
    growth = 1.0 if n_points <= MOST_TOGETHER else COMBINED_GROWTH
    return n_links > trial.n_links and n_links >= growth * trial.n_links


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


LEAST_GROWN = 12
"""A piece of fewer points is searched as a whole; beyond `MOST_DENSE` each step takes too long."""

ONE_BOX_SHARE = 0.1
"""One box is tried first, in this part of the time: it is enough where points are held well."""

GROWTH_SHARE = 0.6
"""Growth may take this part of the time of a piece,"""

GROWTH_SHARE_ALONE = 0.85
"""and this part where what follows is a placement."""

BOXES_PER_START, LEAST_BOXES = 2, 6
"""The boxes that are looked at for each that grew, once all points are placed, and the least."""


def is_grown(n_points: int, dimension: int) -> bool:
    """Return whether a piece is solved point by point."""
    return dimension == 3 and LEAST_GROWN <= n_points <= MOST_DENSE


def solve_grown(
    problem: Problem, budget: Budget, share: float, within: Sequence[Bounds] | None
) -> Paving | None:
    """Solve a piece in space point by point; return None where there is nothing to begin with."""
    if not is_grown(problem.n_points, problem.dimension) or budget.boxes_left() < LEAST_BOXES:
        return None
    is_large = problem.n_points > MOST_TOGETHER
    if within is None and not is_large:
        in_one_box = search_in_one_box(problem, budget, ONE_BOX_SHARE * share)
        if not in_one_box.pending:
            return in_one_box
    growth_share = share * (GROWTH_SHARE_ALONE if is_large else GROWTH_SHARE)
    growth = Growth(problem, budget.options.resolution, budget.has_passed(growth_share))
    grown = growth.run()
    if grown is None:
        return None
    budget.spend(Statistics(processed=1, split=1))
    boxes = [growth.bounds(partial) for partial in grown]
    boxes = parts_within(boxes, within)
    if any(len(partial.points) < problem.n_points for partial in grown):
        return search_share(problem, budget, share, boxes)
    if is_large and budget.keep(len(boxes)):
        return Paving(kept=[as_box(part) for part in boxes])
    most_boxes = max(BOXES_PER_START * len(boxes), LEAST_BOXES)
    cover = search_share(problem, budget, share, boxes, most_boxes, at_gaps=True)
    if cover.processed >= len(boxes):
        # Growth came to its end and examined everything; what follows makes its boxes narrower.
        accept_pending(cover, budget)
    return cover
