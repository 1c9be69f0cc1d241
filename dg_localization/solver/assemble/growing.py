# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Solution of a rigid piece in space: grown point by point first, then contracted as a whole.

Four points with all mutual distances measured are placed first. Each further point with enough
distances to placed points lies in few regions of their frame, and each region gives a partial box.
With each point all measured pairs so far are combined, so that errors do not accumulate; a partial
box that contradicts them is dropped. Every placement of the piece lies in some partial box.

These boxes are wide if points are held weakly. Halves of such a box would belong to the same
hypothesis, so it is split at gaps only. Boxes of many points are not split at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations, islice

import numpy as np

from dg_localization.interval.pave import Examined, Paving, pave
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
from dg_localization.solver.place.placements import REFERENCE_STEPS, place
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.search.search import accept_pending, search_in_one_box, search_share
from dg_localization.solver.subproblem import (
    MOST_DENSE,
    MOST_TOGETHER,
    Bounds,
    as_box,
    parts_within,
)

MOST_SEEDS = 2000
"""Most seeds that are examined."""


def _tetrahedra(neighbors: list[set[int]]) -> Iterator[tuple[int, ...]]:
    """Yield sets of four points with all mutual distances measured."""
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
    # An exact edge counts as known to a thousandth; edges may be zero or huge.
    with np.errstate(all='ignore'):
        gram /= longest[:, None, None]
        return np.asarray(np.linalg.det(gram) * longest / (widest + 1e-3 * longest))


def _reached(neighbors: list[set[int]], seed: tuple[int, ...], dimension: int) -> set[int]:
    """Return the points that growth can reach from a seed."""
    reached, waiting = set(seed), set(range(len(neighbors))) - set(seed)
    while new := {x for x in waiting if len(neighbors[x] & reached) >= dimension}:
        reached |= new
        waiting -= new
    return reached


def best_seed(
    problem: Problem, measured: BoolArray, stopped: Callable[[], bool]
) -> tuple[int, ...] | None:
    """Return the best known four points among those from which growth reaches most points."""
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
            # The best seed reaches everything that this one reaches.
            continue
        reached = _reached(neighbors, seed, problem.dimension)
        if len(reached) > len(best_reached):
            best, best_reached = seed, reached
    return best


MOST_PARTIAL_BOXES = 32
"""Growth ends when there are more partial boxes, or when every further point has more regions; the
search continues from there."""

LOCAL_POINTS = 12
"""Axes project this many points, the best known ones from their ends."""

WELL_EXPLAINED = 2.0
"""Axes are applied if pairs are wider than this many times the widths that errors explain."""

COMBINED_GROWTH = 1.15
"""Beyond `MOST_TOGETHER` points, pairs are combined only after their number grew by this factor,
and the regions of a point are computed anew only after its distances grew by as much."""


@dataclass(frozen=True)
class _Trial:
    """The possible regions of a further point, in the frame of points of a partial box."""

    n_links: int
    frame: IntArray
    regions: FloatArray

    def rank(self) -> tuple[int, float]:
        """Return the sort key of a point: its number of regions, then their size."""
        sides_m = self.regions[:, UPPER] - self.regions[:, LOWER]
        return len(self.regions), float(sides_m.max(initial=0.0))


@dataclass
class PartialBox:
    """The points placed so far, in one of their possible arrangements."""

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
        """Return partial boxes that together hold every placement; None without a seed."""
        seed = best_seed(self._problem, self._measured, self._stopped)
        if seed is None:
            return None
        box = self._contracted(seed, as_box(self._problem.bounds_among(seed)))
        seeds = [] if box is None else [PartialBox(seed, box, len(seed))]
        # The largest first: a contradiction shows before there are many partial boxes.
        grown = pave(seeds, self._extended, self._goes_on, lambda partial: -len(partial.points))
        return grown.kept + grown.pending

    def _goes_on(self, grown: Paving[PartialBox], n_waiting: int) -> bool:
        """Return whether there are few partial boxes, and there is time."""
        return len(grown.kept) + n_waiting <= MOST_PARTIAL_BOXES and not self._stopped()

    def bounds(self, partial: PartialBox) -> Bounds:
        """Return bounds of all pairs of the problem for the placements in a partial box."""
        lower, upper = self._problem.lower.copy(), self._problem.upper.copy()
        index = np.ix_(partial.points, partial.points)
        lower[index], upper[index] = partial.box[LOWER], partial.box[UPPER]
        return lower, upper

    def _extended(self, partial: PartialBox) -> Examined[PartialBox]:
        """Return the extensions of a partial box by one point; keep it if none can be placed."""
        n_links = self._measured[:, partial.points].sum(axis=1)
        n_links[list(partial.points)] = 0
        within_reach = np.flatnonzero(n_links >= self._problem.dimension).tolist()
        if not within_reach:
            return Examined(kept=[partial])
        positions = place(partial.box, self._problem.dimension, REFERENCE_STEPS)
        for point in within_reach:
            trial = partial.trials.get(point)
            if trial is None or _is_outdated(trial, n_links[point], len(partial.points)):
                trial = self._trial(partial, positions, point)
            if len(trial.regions) == 0:
                return Examined()
            partial.trials[point] = trial
        best = min(within_reach, key=lambda point: (*partial.trials[point].rank(), point))
        if partial.trials[best].n_links < n_links[best]:
            partial.trials[best] = self._trial(partial, positions, best)
        if len(partial.trials[best].regions) > MOST_PARTIAL_BOXES:
            return Examined(kept=[partial])
        return Examined(parts=list(self._with_point(partial, best)))

    def _trial(self, partial: PartialBox, positions: FloatArray, point: int) -> _Trial:
        """Return the possible regions of a further point."""
        members = np.array(partial.points)
        neighbors = np.flatnonzero(self._measured[point, members])
        frame = _frame(partial.box, positions, neighbors)
        enclosure = enclose_in_frame(partial.box, frame)[neighbors]
        lower = self._problem.lower[point, members[neighbors]]
        upper = self._problem.upper[point, members[neighbors]]
        regions = regions_of_point(enclosure, lower, upper, self._resolution_m)
        return _Trial(len(neighbors), frame, regions)

    def _with_point(self, partial: PartialBox, point: int) -> Iterator[PartialBox]:
        """Yield partial boxes with one more point, one for each of its regions."""
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
        """Contract the box of some points; None if it is proved to hold no placement."""
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
        # Drop the gaps: the search finds them again.
        left[GAP_LOWER:] = 0.0
        return left if contractor.combine(left, explained) else None


def _is_outdated(trial: _Trial, n_links: int, n_points: int) -> bool:
    """Return whether a point has enough new distances to placed points for a new trial."""
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
        # The positions are NaN; any frame is sound.
        frame[:] = np.arange(dimension + 1)
    return frame


LEAST_GROWN = 12
"""A piece of fewer points is searched as a whole; beyond `MOST_DENSE` each step takes too long."""

ONE_BOX_SHARE = 0.1
"""Share of the time for a first attempt with one box, which suffices if points are held well."""

GROWTH_SHARE = 0.6
"""Share of the time of a piece that growth may take,"""

GROWTH_SHARE_ALONE = 0.85
"""and its share if only a placement follows."""

BOXES_PER_START, LEAST_BOXES = 2, 6
"""Boxes to examine per grown box after all points are placed, and the least number of boxes."""


def is_grown(n_points: int, dimension: int) -> bool:
    """Return whether a piece of this size is solved point by point."""
    return dimension == 3 and LEAST_GROWN <= n_points <= MOST_DENSE


def solve_grown(
    problem: Problem, budget: Budget, share: float, within: Sequence[Bounds] | None
) -> Paving[FloatArray] | None:
    """Solve a piece in space point by point; return None if it is not grown or has no seed."""
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
        # Growth has examined everything; the search only narrows its boxes.
        accept_pending(cover, budget)
    return cover
