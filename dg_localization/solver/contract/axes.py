# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The axes of a problem, and their order: the best known come first."""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.contract.widths import relative_error
from dg_localization.solver.problem import Problem


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


def axes_of(problem: Problem) -> IntArray:
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


@kernel
def rank_axes(box: FloatArray, axes: IntArray) -> IntArray:
    """Return the axes in the order of how well the distances to their two ends are known."""
    n_points = box.shape[1]
    errors = np.empty((n_points, n_points))
    for i in range(n_points):
        # In one dimension an axis has the same point at both ends.
        for j in range(i, n_points):
            errors[i, j] = errors[j, i] = relative_error(box, i, j)
    badness = np.empty(len(axes))
    for x in range(len(axes)):
        a, b = axes[x, 0], axes[x, 1]
        known = 0.0
        for i in range(n_points):
            if i != a and i != b:
                known += 1.0 / (0.01 + (errors[a, i] + errors[b, i]) + errors[a, b])
        badness[x] = -known
    # Stable, and so the same with and without numba.
    return axes[np.argsort(badness, kind='mergesort')]


@kernel
def rank_points(box: FloatArray, a: int, b: int, points: IntArray) -> None:
    """Order the points by how well their distances to the ends of an axis are known."""
    n_points = box.shape[1]
    errors = np.empty(n_points)
    for i in range(n_points):
        errors[i] = relative_error(box, a, i) + relative_error(box, b, i)
    errors[a] = errors[b] = -1.0
    points[:] = np.argsort(errors, kind='mergesort')
