# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Contraction by linear combinations of all measured distances at once.

Projections see a few points at a time; where errors run through a chain of them, the bounds they
give are wider than the measurements allow. Here all measured pairs bound a pair together
(`linearization`), with the multipliers of weighted least squares (`least_squares`) and bounds of
the displacements from interval Newton steps (`newton`). The paper has no such step; it only
projects.
"""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.least_squares import leave_out, set_inverse, set_multipliers
from dg_localization.solver.contract.linearization import (
    Linearization,
    bound_linear_function,
    narrow_to_linear,
    new_linearization,
    set_displacements,
)
from dg_localization.solver.contract.newton import narrow_displacements
from dg_localization.solver.contract.reference import (
    choose_axis,
    complete_frame,
    point_errors_m,
    set_reference,
)
from dg_localization.solver.contract.status import Status

NEWTON_STEPS = 3
"""Most interval Newton steps."""


@kernel
def contract_linear(
    box: FloatArray,
    positions: FloatArray,
    edges: IntArray,
    errors: FloatArray,
    explained: FloatArray,
) -> Status:
    """Narrow all pairs of a box by linear combinations of the measured ones, in place."""
    n_points, dimension = positions.shape
    linear = new_linearization(edges, n_points, dimension)
    frame = np.full(dimension + 1, -1)
    basis = np.zeros((dimension, dimension))
    errors_m = point_errors_m(box, np.arange(n_points))
    if not choose_axis(positions, errors_m, frame):
        return Status.NOT_RIGID
    if not complete_frame(positions, errors_m, frame, basis):
        return Status.NOT_RIGID
    if not set_reference(positions, frame, basis, linear.reference):
        return Status.NOT_RIGID
    n_unknowns = set_displacements(box, frame, linear)
    if n_unknowns == -1:
        return Status.EMPTY
    if n_unknowns < 0 or len(edges) < n_unknowns:
        return Status.NOT_RIGID
    inverse = np.empty((n_unknowns, len(edges)))
    widths = np.empty(len(edges))
    for m in range(len(edges)):
        widths[m] = box[UPPER, edges[m, 0], edges[m, 1]] - box[LOWER, edges[m, 0], edges[m, 1]]
    if not set_inverse(widths, linear, inverse):
        return Status.NOT_RIGID
    relative = np.empty((len(edges), 2, dimension))
    if not narrow_displacements(box, linear, relative, NEWTON_STEPS):
        return Status.EMPTY
    left = _narrow_all_pairs(box, linear, inverse, errors, explained)
    return Status.CONTRACTED if left else Status.EMPTY


@kernel
def _narrow_all_pairs(
    box: FloatArray,
    linear: Linearization,
    inverse: FloatArray,
    errors: FloatArray,
    explained: FloatArray,
) -> bool:
    """Narrow every pair by the combination that estimates it; False when nothing is left."""
    n_points, dimension = linear.reference.shape
    n_edges = len(linear.edges)
    target = np.zeros((n_points, dimension))
    multipliers = np.empty(n_edges)
    edge_of = np.full((n_points, n_points), -1)
    for m in range(n_edges):
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        edge_of[i, j] = edge_of[j, i] = m
    for i in range(n_points):
        for j in range(i + 1, n_points):
            set_multipliers(linear, inverse, i, j, target, multipliers)
            width = 0.0
            for m in range(n_edges):
                width += abs(multipliers[m]) * errors[m]
            explained[i, j] = explained[j, i] = width
            estimable = edge_of[i, j] < 0 or leave_out(multipliers, edge_of[i, j])
            if estimable and _may_gain(box, linear, i, j, multipliers):
                low, high = bound_linear_function(linear, multipliers, target)
                if not narrow_to_linear(box, linear, i, j, low, high):
                    return False
            for axis in range(dimension):
                target[i, axis] = 0.0
                target[j, axis] = 0.0
    return True


@kernel(inlined=True)
def _may_gain(
    box: FloatArray, linear: Linearization, i: int, j: int, multipliers: FloatArray
) -> bool:
    """Return whether a combination is narrower than a pair, rounding and its square apart."""
    width = 0.0
    for m in range(len(multipliers)):
        width += abs(multipliers[m]) * (linear.residuals[m, UPPER] - linear.residuals[m, LOWER])
    return width < box[UPPER, i, j] - box[LOWER, i, j]
