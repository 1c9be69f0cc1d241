# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Contraction by linear combinations of all measured distances at once.

Projections use a few points at a time; if errors run through a chain of points, their bounds are
wider than the measurements allow. Here all measured pairs together bound a pair (`linearization`),
with multipliers of weighted least squares and bounds of the displacements from interval Newton
steps (`newton`). The paper has no such step; it only projects.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.linearization import (
    Linearization,
    bound_linear_function,
    choose_axis,
    linearize,
    narrow_to_linear,
    point_errors_m,
)
from dg_localization.solver.contract.newton import (
    leave_out,
    narrow_displacements,
    set_inverse,
    set_multipliers,
)
from dg_localization.solver.contract.reduction import MOST_THROUGH
from dg_localization.solver.decompose.rigid_components import is_rigid
from dg_localization.solver.problem import Problem

EXPLAINED_FACTOR = 3.0
"""Greatest ratio of the width of a finished box to the first-order effect of the errors."""


@kernel
def contract_linear(
    box: FloatArray,
    positions: FloatArray,
    edges: IntArray,
    errors: FloatArray,
    held_m2: float,
    explained: FloatArray,
) -> bool:
    """
    Narrow all pairs of a box by linear combinations of the measured ones, in place.

    Nothing is narrowed if the measurements do not make the points rigid. Returns False if the box
    is proved to hold no placement. The widths that errors explain are written to `explained`. With
    few points, the error of a pair is at most `EXPLAINED_FACTOR` times its width in the box.
    """
    n_points, dimension = positions.shape
    frame = np.full(dimension + 1, -1)
    errors_m = point_errors_m(box, np.arange(n_points))
    if not choose_axis(positions, errors_m, frame):
        return True
    linear, n_unknowns = linearize(box, positions, edges, errors_m, frame)
    if n_unknowns < 0:
        return bool(n_unknowns != -1)
    inverse = np.empty((n_unknowns, len(edges)))
    widths = np.empty(len(edges))
    for m in range(len(edges)):
        widths[m] = box[UPPER, edges[m, 0], edges[m, 1]] - box[LOWER, edges[m, 0], edges[m, 1]]
    if not set_inverse(widths, linear, inverse):
        return True
    relative = np.empty((len(edges), 2, dimension))
    if not narrow_displacements(box, linear, relative):
        return False
    # With this for more points, searches of large networks take ten times as long.
    left = np.minimum(errors, EXPLAINED_FACTOR * widths) if n_points <= MOST_THROUGH else errors
    # Near a singular reference the first-order effect is unlimited, but not the second-order one.
    most = 2.0 * np.sqrt(box[UPPER].max() * held_m2)
    return bool(_narrow_all_pairs(box, linear, inverse, left, most, explained))


@kernel
def _narrow_all_pairs(
    box: FloatArray,
    linear: Linearization,
    inverse: FloatArray,
    errors: FloatArray,
    most_explained: float,
    explained: FloatArray,
) -> bool:
    """Narrow every pair by the combination that estimates it; return False if one is empty."""
    n_points, dimension = linear.reference.shape
    n_edges = len(linear.edges)
    target = np.zeros((n_points, dimension))
    multipliers = np.empty(n_edges)
    residual_widths = linear.residuals[:, UPPER] - linear.residuals[:, LOWER]
    edge_of = np.full((n_points, n_points), -1)
    for m in range(n_edges):
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        edge_of[i, j] = edge_of[j, i] = m
    for i in range(n_points):
        for j in range(i + 1, n_points):
            target[:] = 0.0
            for axis in range(dimension):
                target[i, axis] = 2.0 * (linear.reference[i, axis] - linear.reference[j, axis])
                target[j, axis] = -target[i, axis]
            set_multipliers(linear, inverse, i, j, target, multipliers)
            width = 0.0
            for m in range(n_edges):
                width += abs(multipliers[m]) * errors[m]
            explained[i, j] = explained[j, i] = min(width, most_explained)
            if edge_of[i, j] >= 0 and not leave_out(multipliers, edge_of[i, j]):
                continue
            width = 0.0
            for m in range(n_edges):
                width += abs(multipliers[m]) * residual_widths[m]
            # Except for rounding and the square of the pair, a wider combination gains nothing.
            if width < box[UPPER, i, j] - box[LOWER, i, j]:
                low, high = bound_linear_function(linear, multipliers, target)
                if not narrow_to_linear(box, linear, i, j, low, high):
                    return False
    return True


class ConnectedPoints(NamedTuple):
    """Points that chains of measured pairs connect."""

    points: IntArray
    edges: IntArray  # (m, 2): the measured pairs among them, by their places in `points`
    errors: FloatArray  # (m,): the widths of their intervals in m^2
    held_m2: float  # the sum of these widths, or of narrow ones if they hold the points rigid


def connected_points_of(problem: Problem, smoothed: FloatArray) -> list[ConnectedPoints]:
    """
    Return the points of a problem in groups that chains of measured pairs connect.

    In a box that meets the triangle inequalities, all pairs of a group are bounded.
    """
    first = np.isfinite(smoothed[UPPER]).argmax(axis=1)
    pairs = problem.pairs.measured
    ends, groups = first[pairs], []
    for number in set(ends[:, 0].tolist()):
        # Pairs are left out if a chain overflows.
        points, among = np.flatnonzero(first == number), pairs[(ends == number).all(axis=1)]
        errors = problem.upper[among[:, 0], among[:, 1]] - problem.lower[among[:, 0], among[:, 1]]
        edges = np.searchsorted(points, among)
        narrow = errors < 0.01 * errors.max(initial=0.0)
        is_held = narrow.any() and is_rigid(len(points), edges[narrow], problem.dimension)
        held_m2 = float(errors[narrow].sum() if is_held else errors.sum())
        groups.append(ConnectedPoints(points, edges, errors, held_m2))
    return groups
