# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Contraction of a box to a fixed point (Section 4): the stages, and the order they come in.

One sweep smooths triangles, then projects, reduces and back-projects along all axes, the best
known first. Linear combinations of all measured pairs follow as soon as no gap is left.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import COMPILED, WORK_PER_LOOK, until
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, Status
from dg_localization.solver.contract.linear import Groups, combine
from dg_localization.solver.contract.reduction import MOST_THROUGH, apply_axes, make_workspace
from dg_localization.solver.contract.sides import chiralities_are_possible, sides_of
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.contract.widths import (
    axes_of,
    is_finished,
    largest_gain,
    rank_axes,
    widest_gap_m,
)
from dg_localization.solver.problem import Problem

SMOOTHED_SWEEPS = 2
"""The first sweeps begin with the triangle inequalities; later ones gain nothing from them."""


class Schedule(NamedTuple):
    """
    The sweeps over the axes of a fleet.

    Parameters
    ----------
    most_points : float
        The largest fleet that this is for.
    local : tuple of int
        How many points the first sweeps project, one number for each: those best known from the
        axis. They take a fraction of the time of a sweep over all points, and leave less to gain.
    axes_before_split : int
        How many axes per point are tried with all points before a box with a gap is split.

    """

    most_points: float
    local: tuple[int, ...]
    axes_before_split: int


SCHEDULES = (
    (Schedule(20, (), 12), Schedule(math.inf, (20,), 12)),
    (
        Schedule(MOST_THROUGH, (), 12),
        Schedule(20, (10,), 2),
        Schedule(30, (10, 16), 2),
        Schedule(math.inf, (20,), 12),
    ),
    (Schedule(12, (), 2), Schedule(math.inf, (12,), 2)),
)
"""The schedules in 1, 2 and 3 dimensions, for smaller fleets first (benchmarks/notes)."""

LEAST_GAIN = 0.05
"""A sweep that shortens no interval by more than this fraction is the last."""

MOST_IDLE_TESTS = 4
"""A sweep ends after this many tests in a row without such a gain: later axes are known less."""

LEAST_GAP = 0.1
"""A gap narrower than this fraction of the resolution does not split a box."""


leave_early = nullcontext if COMPILED else until
"""Compiled kernels return soon; one in Python has to be left when the time is up."""


class Pruned(NamedTuple):
    """What is left of a box after contraction."""

    status: Status
    box: FloatArray
    """Shape (4, n, n), in m^2; without meaning where the status is ``EMPTY``."""
    explained: FloatArray
    """Shape (n, n): the widths that measurement errors explain to first order, in m^2."""


class Goal(NamedTuple):
    """
    When a contraction ends.

    Parameters
    ----------
    resolution_m : float
        It ends when every distance is known to this many meters,
    explained_factor : float
        or no interval is more than this many times wider than the measurement errors explain,
    max_sweeps : int
        or after this many sweeps over all axes.
    axes_per_test : int
        After how many axes of a sweep to combine the measured pairs and look at the widths.

    """

    resolution_m: float
    explained_factor: float
    max_sweeps: int
    axes_per_test: int


class Contractor:
    """
    Contracts boxes of one problem, one at a time.

    Three laws: the result lies inside the input; no placement of the input is lost; what is
    removed once stays removed.
    """

    def __init__(self, problem: Problem) -> None:
        n_points, dimension = problem.n_points, problem.dimension
        self.axes = axes_of(problem)
        self._n_points = n_points
        self._dimension = dimension
        work = make_workspace(n_points, dimension)
        self._scratch = (*work, *sides_of(problem), dimension)
        self._box, self._points, self._distance = work.box, work.points, work.distance
        fitting = (s for s in SCHEDULES[dimension - 1] if n_points <= s.most_points)
        self._schedule = next(fitting)
        self._widths_of_sweep = np.zeros((n_points, n_points))
        self._widths_of_test = np.zeros((n_points, n_points))
        self._in_order = np.arange(n_points)
        self._simplices = np.array(
            [chirality.points for chirality in problem.chiralities], dtype=np.int64
        ).reshape(-1, dimension + 1)
        self._signs = np.array([c.sign for c in problem.chiralities], dtype=np.int64)
        triples = n_points**2 * min(n_points, MOST_THROUGH)
        triples *= n_points if dimension == 3 else 1
        self._axes_per_look = max(1, WORK_PER_LOOK // triples)

    def contract(
        self, box: FloatArray, groups: Groups, goal: Goal, stopped: Callable[[], bool]
    ) -> Pruned:
        """Contract a box until nothing gains much."""
        self._box[:] = box
        if self._n_points > MOST_THROUGH:
            # They are still in the order of the last axis of another box.
            self._points[:] = self._in_order
        explained = np.zeros((self._n_points, self._n_points))
        status, left = Status.UNFINISHED, box
        with leave_early(stopped):
            status = self._sweep_to_fixed_point(groups, goal, explained, stopped)
            left = self._box.copy()
            if status is Status.CONTRACTED and not self._chiralities_are_possible(left):
                status = Status.EMPTY
        return Pruned(status, left, explained)

    def _sweep_to_fixed_point(
        self, groups: Groups, goal: Goal, explained: FloatArray, stopped: Callable[[], bool]
    ) -> Status:
        """Sweep over all axes until the goal is reached or a sweep gains little."""
        box, local = self._box, self._schedule.local
        for sweep in range(goal.max_sweeps):
            if sweep < SMOOTHED_SWEEPS and not smooth_triangles(box, self._distance, self._points):
                return Status.EMPTY
            axes = rank_axes(box, self.axes)
            if sweep < len(local):
                # The best axes are the measured pairs and what they soon reveal.
                best = axes[: len(groups.edges)]
                status = self._project(best, local[sweep], stopped)
            else:
                np.subtract(box[UPPER], box[LOWER], out=self._widths_of_sweep)
                status = self._project_and_combine(axes, groups, goal, explained, stopped)
                if status is None and largest_gain(box, self._widths_of_sweep) < LEAST_GAIN:
                    return Status.CONTRACTED
            if status is not None:
                return status
        return Status.CONTRACTED

    def _project_and_combine(
        self,
        axes: IntArray,
        groups: Groups,
        goal: Goal,
        explained: FloatArray,
        stopped: Callable[[], bool],
    ) -> Status | None:
        """Apply all axes, and test the box after every few; None when there is more to gain."""
        box = self._box
        enough = min(len(axes), self._schedule.axes_before_split * self._n_points)
        n_idle = 0
        for first in range(0, max(1, len(axes)), goal.axes_per_test):
            some = axes[first : first + goal.axes_per_test]
            np.subtract(box[UPPER], box[LOWER], out=self._widths_of_test)
            status = self._project(some, self._n_points, stopped)
            if status is not None:
                return status
            if widest_gap_m(box) > LEAST_GAP * goal.resolution_m:
                # Each part alone contracts better than both together: leave them to the split.
                if first + len(some) >= enough:
                    return Status.CONTRACTED
            elif not combine(*groups, box, self._dimension, explained):
                return Status.EMPTY
            elif is_finished(box, explained, goal.explained_factor, goal.resolution_m):
                return Status.CONTRACTED
            if stopped():
                return Status.UNFINISHED
            n_idle = n_idle + 1 if largest_gain(box, self._widths_of_test) < LEAST_GAIN else 0
            if n_idle == MOST_IDLE_TESTS:
                return Status.CONTRACTED
        return None

    def _project(self, axes: IntArray, count: int, stopped: Callable[[], bool]) -> Status | None:
        """Apply axes, and look at the clock after every few; None when all were applied."""
        for first in range(0, len(axes), self._axes_per_look):
            if first > 0 and stopped():
                return Status.UNFINISHED
            some = axes[first : first + self._axes_per_look]
            if not apply_axes(*self._scratch, some, count):
                return Status.EMPTY
        return None

    def _chiralities_are_possible(self, box: FloatArray) -> bool:
        """Return whether the chiralities do not contradict each other everywhere in a box."""
        return len(self._signs) < 2 or chiralities_are_possible(box, self._simplices, self._signs)
