# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The widths of the pairs of a box, and their limits."""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import GAP_LOWER, GAP_UPPER, LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.pair_bounds import pairs_among
from dg_localization.solver.problem import Problem


@kernel(borrows=True)
def largest_gain(box: FloatArray, widths: FloatArray) -> float:
    """Return the largest relative reduction of the widths of pairs against earlier `widths`."""
    n_points = box.shape[1]
    gain = 0.0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            width = widths[i, j]
            if np.isinf(width):
                if box[UPPER, i, j] < np.inf:
                    return 1.0
            elif width > 0.0:
                gain = max(gain, 1.0 - (box[UPPER, i, j] - box[LOWER, i, j]) / width)
    return gain


@kernel(borrows=True)
def relative_error(box: FloatArray, i: int, j: int) -> float:
    """Return the unknown fraction of the squared distance of a pair, from 0 to 1."""
    if np.isinf(box[UPPER, i, j]):
        return 1.0
    return 1.0 - box[LOWER, i, j] / max(box[UPPER, i, j], 1e-300)


@kernel
def excess(
    box: FloatArray, explained: FloatArray, factor: float, resolution_m: float
) -> FloatArray:
    """Return widths of pairs as multiples of their limits; 0 for unbounded pairs."""
    n_points = box.shape[1]
    times = np.zeros((n_points, n_points))
    for i in range(n_points):
        for j in range(i + 1, n_points):
            low, high = box[LOWER, i, j], box[UPPER, i, j]
            if high == np.inf:
                continue
            if explained[i, j] > 0.0:
                allowed_m = 2.0 * resolution_m * np.sqrt(0.5 * low + 0.5 * high)
                width = (high - low) / (factor * explained[i, j] + allowed_m)
            else:
                width = (np.sqrt(high) - np.sqrt(low)) / resolution_m
            times[i, j] = times[j, i] = width
    return times


def is_finished(
    box: FloatArray, explained: FloatArray, factor: float, resolution_m: float
) -> bool:
    """Return whether a box is narrower than the resolution or no wider than the errors explain."""
    return bool(excess(box, explained, factor, resolution_m).max() <= 1.0)


def has_gap(box: FloatArray) -> bool:
    """Return whether a gap is known in the range of a pair."""
    return bool((box[GAP_LOWER] < box[GAP_UPPER]).any())


def axes_of(problem: Problem) -> IntArray:
    """
    Return the axes a problem may be projected along.

    In one dimension there is nothing to project: the axes stand for the faces with known sides,
    and one for the line itself.
    """
    if problem.dimension > 1:
        return np.stack(pairs_among(problem.n_points), axis=1)
    faces = {side.face[0] for side in problem.sides}
    faces.update(point for chirality in problem.chiralities for point in chirality.points)
    return np.array([(face, face) for face in sorted(faces | {0})], dtype=np.int64)


@kernel
def rank_axes(box: FloatArray, axes: IntArray) -> IntArray:
    """Return the axes sorted by the precision of the distances to their ends."""
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
    # A stable sort, so that the order is the same with and without numba.
    return axes[np.argsort(badness, kind='mergesort')]


@kernel
def rank_points(box: FloatArray, a: int, b: int, points: IntArray) -> None:
    """Sort the points by the precision of their distances to the ends of an axis."""
    n_points = box.shape[1]
    errors = np.empty(n_points)
    for i in range(n_points):
        errors[i] = relative_error(box, a, i) + relative_error(box, b, i)
    errors[a] = errors[b] = -1.0
    points[:] = np.argsort(errors, kind='mergesort')
