# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The prune step of the search: the contraction of boxes of one problem."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, sub_box
from dg_localization.solver.contract.fixed_point import Contractor, Goal, Pruned
from dg_localization.solver.contract.groups import groups_of
from dg_localization.solver.contract.local_frames import contract_in_frame
from dg_localization.solver.contract.reduction import SMALL_FLEET
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.options import SolverOptions
from dg_localization.solver.problem import Problem
from dg_localization.solver.search.splitting import EXPLAINED_FACTOR

MAX_SWEEPS = 50
"""Most sweeps over all axes."""


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
