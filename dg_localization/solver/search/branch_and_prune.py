"""
Branch and prune: contract a box, split it where it is ambiguous, until all is told (Section 4).

The paper splits the widest range in the middle. Here a box is split at its largest gap first,
where both halves are likely to hold a solution and none is wasted, and in the middle only when
there is no gap and the box is wider than the measurement errors explain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
import heapq
from itertools import count
import math
import os
import time
from typing import Protocol

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK, kernel, until
from dg_localization.solver.box import (
    GAP_LOWER,
    GAP_UPPER,
    LOWER,
    UPPER,
    FloatArray,
    IntArray,
    cut_at,
)
from dg_localization.solver.contract.fixed_point import (
    CONTRACTED,
    EMPTY,
    EXPLAINED_FACTOR,
    LEAST_GAP,
    MOST_THROUGH,
    SMALL_FLEET,
    UNFINISHED,
    Groups,
    combine,
    contract,
    excess,
    make_workspace,
)
from dg_localization.solver.contract.sides import handedness_is_possible, sides_of
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.place.hypotheses import place_problem
from dg_localization.solver.place.placements import agrees
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import SolverOptions, Statistics
from dg_localization.solver.search.tightening import tighten

MAX_SWEEPS = 50
SLICE_SWEEPS = 3
"""Sweeps over all axes: of a box at most, and of a slice, which gains from the first ones most."""

WELL_EXPLAINED = 0.01
"""A range this close to the first-order effect of the errors, relatively, is not tightened."""

POINTS_PER_WORKER = 12
"""From this many points on a box takes milliseconds, and several are examined at a time."""


Pair = tuple[int, int]


class Cancel(Protocol):
    """Whatever tells that nobody wants the answer any more, such as a `threading.Event`."""

    def is_set(self) -> bool:
        """Return whether to stop."""
        ...


@dataclass
class Cover:
    """The boxes that a search kept and those it did not come to, with its effort."""

    kept: list[FloatArray] = field(default_factory=list)
    pending: list[FloatArray] = field(default_factory=list)
    statistics: Statistics = Statistics(0, 0, 0, 0, 0, 0.0)


@kernel
def groups_of(lower: FloatArray, upper: FloatArray) -> Groups:
    """
    Return the points of a problem in groups that chains of measured pairs connect.

    Parameters
    ----------
    lower, upper : ndarray, shape (n, n)
        Bounds of the squared distances in m^2; infinite ones were not measured.

    Returns
    -------
    Groups
        The groups, each in ascending order of its points.

    """
    n_points = len(upper)
    group_of = np.full(n_points, -1)
    queue = np.empty(n_points, dtype=np.int64)
    members = np.empty(n_points, dtype=np.int64)
    offsets = np.zeros(n_points + 1, dtype=np.int64)
    edge_offsets = np.zeros(n_points + 1, dtype=np.int64)
    edges = np.empty((n_points * n_points, 2), dtype=np.int64)
    errors = np.empty(n_points * n_points)
    n_groups = n_members = n_edges = 0
    for seed in range(n_points):
        if group_of[seed] >= 0:
            continue
        group_of[seed] = n_groups
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            point = queue[head]
            head += 1
            for other in range(n_points):
                if group_of[other] < 0 and upper[point, other] < np.inf:
                    group_of[other] = n_groups
                    queue[tail] = other
                    tail += 1
        first = n_members
        for point in range(n_points):
            if group_of[point] == n_groups:
                members[n_members] = point
                n_members += 1
        for x in range(first, n_members):
            for y in range(x + 1, n_members):
                i, j = members[x], members[y]
                if upper[i, j] < np.inf:
                    edges[n_edges, 0], edges[n_edges, 1] = x - first, y - first
                    errors[n_edges] = upper[i, j] - lower[i, j]
                    n_edges += 1
        n_groups += 1
        offsets[n_groups] = n_members
        edge_offsets[n_groups] = n_edges
    return Groups(
        offsets[: n_groups + 1].copy(),
        members,
        edge_offsets[: n_groups + 1].copy(),
        edges[:n_edges].copy(),
        errors[:n_edges].copy(),
    )


def _with_edge(groups: Groups, pair: Pair) -> Groups:
    """Return groups in which one more pair counts as measured, unless no chain connects it."""
    positions = [int(np.flatnonzero(groups.members == point)[0]) for point in pair]
    group = int(np.searchsorted(groups.offsets, positions[0], side='right')) - 1
    local = [position - int(groups.offsets[group]) for position in positions]
    end = int(groups.edge_offsets[group + 1])
    known = groups.edges[groups.edge_offsets[group] : end]
    if positions[1] >= groups.offsets[group + 1] or (known == local).all(axis=1).any():
        return groups
    return groups._replace(
        edge_offsets=groups.edge_offsets + (np.arange(len(groups.offsets)) > group),
        edges=np.insert(groups.edges, end, local, axis=0),
        errors=np.insert(groups.errors, end, 0.0),
    )


@kernel
def _all_pairs(n_points: int) -> IntArray:
    """Return all pairs of points."""
    pairs = np.empty((n_points * (n_points - 1) // 2, 2), dtype=np.int64)
    x = 0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            pairs[x, 0], pairs[x, 1] = i, j
            x += 1
    return pairs


def _axes_of(problem: Problem) -> IntArray:
    """
    Return the axes a problem may be projected along.

    In one dimension there is nothing to project: the axes stand for the faces with known sides,
    and one for the line itself.
    """
    if problem.dimension > 1:
        return _all_pairs(problem.n_points)
    faces = {side.face[0] for side in problem.sides}
    faces.update(point for chirality in problem.chiralities for point in chirality.points)
    return np.array([(face, face) for face in sorted(faces | {0})], dtype=np.int64)


@kernel(borrows=True)
def choose_split(
    box: FloatArray, explained: FloatArray, resolution_m: float
) -> tuple[int, int, float, float]:
    """
    Choose where to split a contracted box: at its largest gap, else where it is too wide.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2.
    explained : ndarray, shape (n, n)
        The widths that measurement errors explain in m^2, zero where they explain none.
    resolution_m : float
        What all distances should be known to, in m.

    Returns
    -------
    tuple
        The pair, the end of the lower part and the start of the upper part in m^2; the pair is
        (-1, -1) when the box is finished.

    """
    n_points = box.shape[1]
    gap_i, gap_j, widest_gap_m = -1, -1, LEAST_GAP * resolution_m
    i, j, widest_m2, widest_m = -1, -1, 0.0, 0.0
    for k in range(n_points):
        for other in range(k + 1, n_points):
            low, high = box[LOWER, k, other], box[UPPER, k, other]
            if high < np.inf:
                widest_m = max(widest_m, math.sqrt(high) - math.sqrt(low))
            gap_m = math.sqrt(box[GAP_UPPER, k, other]) - math.sqrt(box[GAP_LOWER, k, other])
            if gap_m > widest_gap_m:
                gap_i, gap_j, widest_gap_m = k, other, gap_m
            times = excess(box, explained, EXPLAINED_FACTOR, resolution_m, k, other)
            if times > 1.0 and high - low > widest_m2:
                i, j, widest_m2 = k, other, high - low
    if widest_m <= resolution_m:
        return -1, -1, 0.0, 0.0
    if gap_i >= 0:
        return gap_i, gap_j, box[GAP_LOWER, gap_i, gap_j], box[GAP_UPPER, gap_i, gap_j]
    if i < 0:
        return -1, -1, 0.0, 0.0
    # Halves of the squared distance separated better than halves of the distance.
    middle = 0.5 * box[LOWER, i, j] + 0.5 * box[UPPER, i, j]
    return i, j, middle, middle


class Pruner:
    """Contracts the boxes of one problem and decides what becomes of them."""

    def __init__(self, problem: Problem, options: SolverOptions) -> None:
        self._problem = problem
        self._resolution = options.resolution
        self._sides = sides_of(problem)
        self._groups = groups_of(problem.lower, problem.upper)
        self._axes = _axes_of(problem)
        self._work = make_workspace(problem.n_points, problem.dimension, len(self._axes))
        self._simplices = np.array(
            [chirality.points for chirality in problem.chiralities], dtype=np.int64
        ).reshape(-1, problem.dimension + 1)
        self._signs = np.array(
            [chirality.sign for chirality in problem.chiralities], dtype=np.int64
        )
        triples = problem.n_points**2 * min(problem.n_points, MOST_THROUGH)
        triples *= problem.n_points if problem.dimension == 3 else 1
        small = problem.n_points <= SMALL_FLEET
        self._batch = len(self._axes) if small else problem.n_points // 2
        self._most_axes = max(1, WORK_PER_LOOK // triples)

    def whole(self) -> FloatArray | None:
        """Return the box of the problem itself, None where the triangles prove it to be empty."""
        n_points = self._problem.n_points
        box = np.zeros((4, n_points, n_points))
        box[LOWER] = self._problem.lower
        box[UPPER] = self._problem.upper
        points, distance = self._work.points[0], self._work.distance
        return box if smooth_triangles(box, distance, points, n_points) else None

    def prune(self, box: FloatArray, stopped: Callable[[], bool] = lambda: False) -> int:
        """Contract a box in place: `EMPTY`, `CONTRACTED`, or `UNFINISHED` when stopped."""
        groups, batch = self._groups, self._batch
        status = UNFINISHED
        with until(stopped):
            status = self._contract(box, stopped, groups, EXPLAINED_FACTOR, MAX_SWEEPS, batch)
        return status

    def prune_slice(self, box: FloatArray, pair: Pair, stopped: Callable[[], bool]) -> int:
        """
        Contract a slice of a finished box, in place.

        The pair that it was cut along is bounded by the slice alone, and counts as measured.
        """
        groups = _with_edge(self._groups, pair)
        status = UNFINISHED
        with until(stopped):
            if not combine(box, self._problem.dimension, groups, self._work.explained):
                return EMPTY
            status = self._contract(box, stopped, groups, 0.0, SLICE_SWEEPS, len(self._axes))
        return status

    def _contract(
        self,
        box: FloatArray,
        stopped: Callable[[], bool],
        groups: Groups,
        factor: float,
        max_sweeps: int,
        batch: int,
    ) -> int:
        """Contract a box as `contract` does, and look at the clock now and then."""
        self._work.progress[:] = 0
        status = UNFINISHED
        while True:
            status = contract(
                box,
                self._work,
                self._sides,
                self._axes,
                groups,
                factor,
                self._resolution,
                max_sweeps,
                batch,
                self._most_axes,
            )
            if status != UNFINISHED or stopped():
                break
        if (
            status == CONTRACTED
            and len(self._signs) > 1
            and not handedness_is_possible(box, self._simplices, self._signs)
        ):
            return EMPTY
        return status

    def finds_placement(self, box: FloatArray, pair: Pair) -> bool:
        """Return whether a placement that agrees is found, with a distance of the pair as here."""
        positions = place_problem(self._problem, box)
        squared = float(((positions[pair[0]] - positions[pair[1]]) ** 2).sum())
        low, high = box[: UPPER + 1, *pair]
        return bool(low <= squared <= high) and agrees(self._problem, positions)

    def unexplained(self, box: FloatArray) -> list[Pair]:
        """
        Return the unknown pairs that errors do not explain in the box just contracted.

        To first order the explained width is that of the exact hull; a range that is narrower
        shows as well as a wider one that the first order is not all. The widest comes first.
        """
        width = box[UPPER] - box[LOWER]
        explained = self._work.explained
        open_pairs = np.isinf(self._problem.upper) & (explained > 0.0)
        open_pairs &= np.abs(width - explained) > WELL_EXPLAINED * explained
        pairs = np.argwhere(np.triu(open_pairs)).tolist()
        return sorted(((i, j) for i, j in pairs), key=lambda pair: -width[pair] / explained[pair])

    def split(self, box: FloatArray) -> list[FloatArray]:
        """Return the two parts to split the box just contracted into, none when it is finished."""
        i, j, low_end, high_start = choose_split(box, self._work.explained, self._resolution)
        return cut_at(box, (i, j), low_end, high_start) if i >= 0 else []


def _n_workers(problem: Problem) -> int:
    """Return on how many processors to examine boxes: small ones are not worth the change."""
    if problem.n_points < POINTS_PER_WORKER:
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else 1


@dataclass
class _Search:
    """A search under way."""

    problem: Problem
    options: SolverOptions
    cancel: Cancel | None
    progress: Callable[[Statistics], None] | None
    start: float = field(default_factory=time.perf_counter)
    kept: list[FloatArray] = field(default_factory=list)
    pending: list[tuple[float, int, FloatArray]] = field(default_factory=list)
    order: Iterator[int] = field(default_factory=count)
    processed: int = 0
    empty: int = 0
    split: int = 0

    def stopped(self) -> bool:
        """Return whether to come to an end."""
        if self.cancel and self.cancel.is_set():
            return True
        return time.perf_counter() - self.start > self.options.max_seconds

    def statistics(self) -> Statistics:
        """Return the effort so far."""
        seconds = time.perf_counter() - self.start
        return Statistics(
            self.processed, self.empty, self.split, len(self.kept), len(self.pending), seconds
        )

    def push(self, box: FloatArray) -> None:
        """Put a box off: the widest is taken first, so that an early stop leaves an even cover."""
        heapq.heappush(self.pending, (-_size(box), next(self.order), box))

    def next_boxes(self, most: int) -> list[FloatArray]:
        """Take the next boxes to examine."""
        most = min(most, len(self.pending), self.options.max_boxes - self.processed)
        return [heapq.heappop(self.pending)[2] for _ in range(most)]

    def examine(self, pruner: Pruner, box: FloatArray) -> tuple[int, list[FloatArray]]:
        """Contract a box in place; return what came of it and its parts, none when finished."""
        status = pruner.prune(box, self.stopped)
        return status, pruner.split(box) if status == CONTRACTED else []

    def note(self, box: FloatArray, status: int, parts: list[FloatArray]) -> None:
        """Keep, split or drop a box that was examined."""
        if status == UNFINISHED:
            self.push(box)
            return
        self.processed += 1
        if status == EMPTY:
            self.empty += 1
        elif parts:
            self.split += 1
            for part in parts:
                self.push(part)
        else:
            self.kept.append(box)
        if self.progress:
            self.progress(self.statistics())

    def run(self) -> None:
        """Examine boxes until none is left or a limit is reached."""
        n_workers = _n_workers(self.problem)
        pruners = [Pruner(self.problem, self.options) for _ in range(n_workers)]
        whole = pruners[0].whole()
        if whole is None:
            self.processed = self.empty = 1
            return
        self.push(whole)
        with ExitStack() as stack:
            examine: Callable[..., Iterable[tuple[int, list[FloatArray]]]] = map
            if n_workers > 1:
                examine = stack.enter_context(ThreadPoolExecutor(n_workers)).map
            while self.pending and self.processed < self.options.max_boxes and not self.stopped():
                boxes = self.next_boxes(n_workers)
                results = list(examine(self.examine, pruners, boxes))
                for box, (status, parts) in zip(boxes, results, strict=True):
                    self.note(box, status, parts)
        if not self.pending and self.options.tighten_slices:
            self.tighten(pruners[0])

    def tighten(self, pruner: Pruner) -> None:
        """Tighten what was kept; a box may turn out to be empty after all."""
        slices = self.options.tighten_slices
        left = [box for box in self.kept if tighten(pruner, box, slices, self.stopped)]
        self.empty += len(self.kept) - len(left)
        self.kept = left


def search(
    problem: Problem,
    options: SolverOptions,
    cancel: Cancel | None = None,
    progress: Callable[[Statistics], None] | None = None,
) -> Cover:
    """
    Cover all placements of a problem by boxes.

    Parameters
    ----------
    problem : Problem
        The problem.
    options : SolverOptions
        Resolution and limits.
    cancel : object with ``is_set()``, optional
        Stops the search when set, as a limit would.
    progress : callable, optional
        Called with the statistics so far, once a box.

    Returns
    -------
    Cover
        Kept and pending boxes, which together hold every placement.

    """
    state = _Search(problem, options, cancel, progress)
    state.run()
    return Cover(state.kept, [box for _, _, box in sorted(state.pending)], state.statistics())


@kernel(borrows=True)
def _size(box: FloatArray) -> float:
    """Return the sum of the finite widths of a box in m."""
    n_points = box.shape[1]
    total = 0.0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            if box[UPPER, i, j] < np.inf:
                total += math.sqrt(box[UPPER, i, j]) - math.sqrt(box[LOWER, i, j])
    return total
