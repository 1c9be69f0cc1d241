# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Contraction of a box to a fixed point (Section 4): the stages and their order.

One sweep smooths triangles, then projects, reduces and back-projects along all axes, best known
first. Linear combinations of all measured pairs follow when no gap is left.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import COMPILED, WORK_PER_LOOK, until
from dg_localization.interval.pave import LEAST_GAIN
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, Status, sub_box
from dg_localization.solver.contract.linear import (
    EXPLAINED_FACTOR,
    ConnectedPoints,
    connected_points_of,
    contract_linear,
)
from dg_localization.solver.contract.local_frames import contract_in_frame
from dg_localization.solver.contract.reduction import (
    MOST_THROUGH,
    SMALL_FLEET,
    Workspace,
    apply_axes,
    make_workspace,
)
from dg_localization.solver.contract.sides import Sides, chiralities_are_possible, sides_of
from dg_localization.solver.contract.triangles import smooth, smooth_triangles
from dg_localization.solver.contract.widths import (
    axes_of,
    has_gap,
    is_finished,
    largest_gain,
    rank_axes,
)
from dg_localization.solver.place.placements import REFERENCE_STEPS, place
from dg_localization.solver.problem import Problem

SMOOTHED_SWEEPS = 2
"""The first sweeps begin with the triangle inequalities; later ones gain nothing from them."""

MAX_SWEEPS, MAX_QUICK_SWEEPS = 50, 2
"""Most sweeps over all axes, in a full and in a quick contraction. Later sweeps narrow little of
the ranges that joints leave open."""

MOST_IDLE_TESTS = 4
"""A sweep ends after this many tests in a row without a gain, since later axes are less known, and
so does tightening after this many frames."""


leave_early = nullcontext if COMPILED else until
"""Compiled kernels return soon; a kernel in Python must be interrupted when the time is up."""


class Pruned(NamedTuple):
    """A box after contraction."""

    status: Status
    box: FloatArray
    """Shape (4, n, n), in m^2; meaningless if the status is ``EMPTY``."""
    explained: FloatArray
    """Shape (n, n): the widths that measurement errors explain to first order, in m^2."""


def _local_sweeps(n_points: int, dimension: int) -> tuple[int, ...]:
    """
    Return the numbers of points that the first sweeps project, the best known from the axis.

    These sweeps take a fraction of the time of a full sweep and leave less for it to gain
    (benchmarks/notes).
    """
    if dimension == 3:
        return (12,) if n_points > 12 else ()
    if dimension == 1 or n_points <= MOST_THROUGH:
        return ()
    if n_points <= 30:
        return (10, 16) if n_points > 20 else (10,)
    return (20,)


def _is_convex(problem: Problem) -> bool:
    """
    Return whether the distances of the placements in any box are a convex set.

    The distances of three points obey only the triangle inequalities, in the plane and in space.
    These give the hull of the set, and its parts would belong to one hypothesis. One chirality
    only chooses between mirror images; two may leave flat triangles only.
    """
    most_points = 2 if problem.dimension == 1 else 3
    return problem.n_points <= most_points and len(problem.chiralities) < 2


class Contractor:
    """
    Contracts boxes of one problem, one at a time.

    Three laws hold: the result lies inside the input; no placement of the input is lost; nothing
    that was removed returns. A contraction ends when every distance is known to the resolution or
    to the width that measurement errors explain, or when a sweep gains little.
    """

    def __init__(self, problem: Problem, resolution_m: float, is_quick: bool = False) -> None:
        n_points, dimension = problem.n_points, problem.dimension
        self.problem = problem
        self.is_convex = _is_convex(problem)
        self._whole = np.zeros((4, n_points, n_points))
        self._whole[LOWER], self._whole[UPPER] = problem.lower, problem.upper
        self._is_possible = smooth(self._whole)
        self._resolution_m = resolution_m
        self._most_sweeps = MAX_QUICK_SWEEPS if is_quick else MAX_SWEEPS
        # All axes of a sweep are applied before the measured pairs are combined.
        self._is_at_once = is_quick or n_points <= SMALL_FLEET
        self._local_sweeps = _local_sweeps(n_points, dimension)
        # The number of axes tried with all points before a box with a gap is split.
        has_many = dimension == 3 or MOST_THROUGH < n_points <= 30
        self._axes_before_split = (2 if has_many else 12) * n_points
        triples = n_points**2 * min(n_points, MOST_THROUGH)
        triples *= n_points if dimension == 3 else 1
        self._axes_per_look = max(1, WORK_PER_LOOK // triples)

    # A box of three points needs none of these.
    @cached_property
    def _axes(self) -> IntArray:
        return axes_of(self.problem)

    @cached_property
    def _groups(self) -> list[ConnectedPoints]:
        return connected_points_of(self.problem, self._whole)

    @cached_property
    def _n_measured(self) -> int:
        return sum(len(group.edges) for group in self._groups)

    @cached_property
    def _work(self) -> Workspace:
        return make_workspace(self.problem.n_points, self.problem.dimension)

    @cached_property
    def _sides(self) -> Sides:
        return sides_of(self.problem)

    def whole(self) -> FloatArray | None:
        """Return the box of the problem itself; None if the triangles prove it empty."""
        return self._whole.copy() if self._is_possible else None

    def contract(self, box: FloatArray, stopped: Callable[[], bool]) -> Pruned:
        """Contract a box until further sweeps gain little."""
        status, left, explained = Status.UNFINISHED, box, np.zeros_like(box[LOWER])
        with leave_early(stopped):
            if self.is_convex:
                left = box.copy()
                status = Status.CONTRACTED if smooth(left) else Status.EMPTY
            else:
                self._take(box)
                status = self._sweep_to_fixed_point(explained, stopped)
                left = self._work.box.copy()
            if status is Status.CONTRACTED:
                if not chiralities_are_possible(left, self.problem.chiralities):
                    status = Status.EMPTY
        return Pruned(status, left, explained)

    def projected(self, box: FloatArray, count: int) -> FloatArray | None:
        """Return a box contracted by projecting `count` points along the best known axes."""
        self._take(box)
        axes = rank_axes(box, self._axes)[: self._n_measured]
        is_empty = self._project(axes, count, lambda: False) is Status.EMPTY
        return None if is_empty else self._work.box.copy()

    def _take(self, box: FloatArray) -> None:
        """Write a box into the scratch arrays, its points in their own order."""
        self._work.box[:], self._work.points[:] = box, self._work.in_order

    def narrow_in_frame(
        self, box: FloatArray, positions: FloatArray, pairs: IntArray, explained: FloatArray
    ) -> bool:
        """
        Narrow unknown pairs of a finished box in place, in the frame of the first of them.

        See `contract_in_frame`; return False if the box is proved to hold no placement.
        """
        points, edges, errors, _ = next(g for g in self._groups if pairs[0, 0] in g.points)
        local, of_points = sub_box(box, points), np.searchsorted(points, pairs)
        if not contract_in_frame(local, positions[points], edges, errors, of_points, explained):
            return False
        (i, j), (x, y) = pairs.T, of_points.T
        box[:, i, j] = box[:, j, i] = local[:, x, y]
        return True

    def combine(self, box: FloatArray, explained: FloatArray) -> bool:
        """
        Narrow every group of connected points by linear combinations of its measured pairs.

        The widths that measurement errors explain are written to `explained` in m^2; they are zero
        in groups that are not rigid. Return False if the box holds no placement.
        """
        explained[:] = 0.0
        for points, edges, errors, held_m2 in self._groups:
            is_whole = len(points) == len(explained)
            local = box if is_whole else sub_box(box, points)
            of_group = explained if is_whole else np.zeros((len(points), len(points)))
            reference = place(local, self.problem.dimension, REFERENCE_STEPS)
            if not contract_linear(local, reference, edges, errors, held_m2, of_group):
                return False
            if not is_whole:
                explained[points[:, None], points] = of_group
                box[:, points[:, None], points] = local
        return True

    def _sweep_to_fixed_point(self, explained: FloatArray, stopped: Callable[[], bool]) -> Status:
        """Sweep over all axes until the box is finished or a sweep gains little."""
        box = self._work.box
        for sweep in range(self._most_sweeps):
            if sweep < SMOOTHED_SWEEPS and not smooth_triangles(
                box, self._work.distance, self._work.points
            ):
                return Status.EMPTY
            axes = rank_axes(box, self._axes)
            if sweep < len(self._local_sweeps):
                # The best axes are the measured pairs and the pairs that they soon bound.
                best = axes[: self._n_measured]
                status = self._project(best, self._local_sweeps[sweep], stopped)
            else:
                widths = box[UPPER] - box[LOWER]
                status = self._project_and_combine(axes, explained, stopped)
                if status is None and largest_gain(box, widths) < LEAST_GAIN:
                    return Status.CONTRACTED
            if status is not None:
                return status
        return Status.CONTRACTED

    def _project_and_combine(
        self, axes: IntArray, explained: FloatArray, stopped: Callable[[], bool]
    ) -> Status | None:
        """Apply all axes, and test the box after every few; None if there is more to gain."""
        box = self._work.box
        enough = min(len(axes), self._axes_before_split)
        per_test = max(1, len(axes) if self._is_at_once else self.problem.n_points // 2)
        n_idle = 0
        for first in range(0, max(1, len(axes)), per_test):
            some = axes[first : first + per_test]
            widths = box[UPPER] - box[LOWER]
            status = self._project(some, self.problem.n_points, stopped)
            if status is not None:
                return status
            if has_gap(box):
                # The two parts contract better after a split.
                if first + len(some) >= enough:
                    return Status.CONTRACTED
            elif not self.combine(box, explained):
                return Status.EMPTY
            elif is_finished(box, explained, EXPLAINED_FACTOR, self._resolution_m):
                return Status.CONTRACTED
            if stopped():
                return Status.UNFINISHED
            n_idle = n_idle + 1 if largest_gain(box, widths) < LEAST_GAIN else 0
            if n_idle == MOST_IDLE_TESTS:
                return Status.CONTRACTED
        return None

    def _project(self, axes: IntArray, count: int, stopped: Callable[[], bool]) -> Status | None:
        """Apply axes, checking the clock after every few; None if all were applied."""
        for first in range(0, len(axes), self._axes_per_look):
            if first > 0 and stopped():
                return Status.UNFINISHED
            some = axes[first : first + self._axes_per_look]
            if not apply_axes(*self._work, *self._sides, self.problem.dimension, some, count):
                return Status.EMPTY
        return None
