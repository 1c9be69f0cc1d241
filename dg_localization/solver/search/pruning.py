# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The prune step of the search: the contraction of boxes and of slices of one problem."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dg_localization.interval.kernels import until
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, sub_box
from dg_localization.solver.contract.combination import combine
from dg_localization.solver.contract.fixed_point import Contractor, Goal, Pruned
from dg_localization.solver.contract.groups import groups_of, with_measured_pair
from dg_localization.solver.contract.local_frames import contract_in_frame
from dg_localization.solver.contract.reduction import SMALL_FLEET
from dg_localization.solver.contract.status import Status
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.options import SolverOptions
from dg_localization.solver.problem import Problem
from dg_localization.solver.search.splitting import EXPLAINED_FACTOR

MAX_SWEEPS = 50
SLICE_SWEEPS = 3
"""Most sweeps over all axes, for a box and for a slice, which gains most from the first ones."""

Pair = tuple[int, int]


def _never() -> bool:
    """Return False: nothing stops the contraction."""
    return False


class Pruner:
    """Prunes the boxes of one problem, one at a time."""

    def __init__(self, problem: Problem, options: SolverOptions) -> None:
        self.problem = problem
        self._groups = groups_of(problem.lower, problem.upper)
        self._contractor = Contractor(problem)
        n_axes = max(1, len(self._contractor.axes))
        small = problem.n_points <= SMALL_FLEET
        axes_per_test = n_axes if small else problem.n_points // 2
        self._goal = Goal(options.resolution, EXPLAINED_FACTOR, MAX_SWEEPS, axes_per_test)
        self._slice_goal = Goal(options.resolution, 0.0, SLICE_SWEEPS, n_axes)

    def whole(self) -> FloatArray | None:
        """Return the box of the problem itself, None where the triangles prove it to be empty."""
        n_points = self.problem.n_points
        box = np.zeros((4, n_points, n_points))
        box[LOWER] = self.problem.lower
        box[UPPER] = self.problem.upper
        left = smooth_triangles(box, np.empty_like(box), np.arange(n_points))
        return box if left else None

    def prune(self, box: FloatArray, stopped: Callable[[], bool] = _never) -> Pruned:
        """Contract a box."""
        return self._contractor.contract(box, self._groups, self._goal, stopped)

    def prune_slice(self, box: FloatArray, pair: Pair, stopped: Callable[[], bool]) -> Pruned:
        """
        Contract a slice of a finished box.

        The pair that it was cut along is bounded by the slice alone, and counts as measured.
        """
        groups = with_measured_pair(self._groups, pair)
        combined, explained = box.copy(), np.zeros(box.shape[1:])
        with until(stopped):
            if not combine(*groups, combined, self.problem.dimension, explained):
                return Pruned(Status.EMPTY, combined, explained)
            return self._contractor.contract(combined, groups, self._slice_goal, stopped)
        return Pruned(Status.UNFINISHED, box, explained)

    def narrow_in_frame(
        self, box: FloatArray, positions: FloatArray, pairs: IntArray, explained: FloatArray
    ) -> bool:
        """
        Narrow unknown pairs of a finished box in place, in the frame of the first of them.

        See `contract_in_frame`; False when the box is proved to hold no placement.
        """
        offsets, members, edge_offsets, edges, errors = self._groups
        group = next(
            g for g in range(len(offsets)) if pairs[0, 0] in members[slice(*offsets[g : g + 2])]
        )
        points = members[offsets[group] : offsets[group + 1]]
        inside = slice(edge_offsets[group], edge_offsets[group + 1])
        local, of_points = sub_box(box, points), np.searchsorted(points, pairs)
        frame = positions[points], edges[inside], errors[inside], of_points, explained
        if not contract_in_frame(local, *frame):
            return False
        (i, j), (x, y) = pairs.T, of_points.T
        box[:, i, j] = box[:, j, i] = local[:, x, y]
        return True
