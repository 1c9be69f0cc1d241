# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds by linear programs: of any linear function, and of all pairs in the Procrustes frame.

The multipliers are those of a linear program (`simplex`), so that what is left is close to the
linearized hull; the bounds made with them are rigorous whatever they are (`linearization`).
"""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, up
from dg_localization.interval.scalars import add, div, square
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, narrow
from dg_localization.solver.contract.linearization import Linearization, bound_linear_function
from dg_localization.solver.contract.newton import narrow_bounds
from dg_localization.solver.contract.procrustes import (
    ProcrustesFrame,
    complete_bounds,
    set_free_across,
)
from dg_localization.solver.contract.reference import reference_distance_m2
from dg_localization.solver.contract.simplex import set_multipliers


@kernel
def bound_by_program(
    linear: Linearization,
    table: FloatArray,
    active: IntArray,
    target: FloatArray,
    errors: FloatArray,
) -> tuple[float, float, float]:
    """
    Bound a linear function of the displacements, from either side with its own multipliers.

    Returns its bounds, and the mean of the widths that the multipliers of the sides explain.
    """
    n_points, dimension = target.shape
    n_edges, n_unknowns = len(linear.edges), len(active)
    multipliers = np.empty(n_edges)
    bounds = np.empty(2)
    explained = 0.0
    for end, sign in ((0, -1.0), (1, 1.0)):
        table[n_edges + n_unknowns] = 0.0
        for i in range(n_points):
            for axis in range(dimension):
                if linear.unknowns[i, axis] >= 0 and target[i, axis] != 0.0:
                    row = n_edges + linear.unknowns[i, axis]
                    for c in range(n_unknowns):
                        table[n_edges + n_unknowns, c] += sign * target[i, axis] * table[row, c]
        set_multipliers(table, active, linear.residuals, multipliers)
        for m in range(n_edges):
            explained += 0.5 * abs(multipliers[m]) * errors[m]
            multipliers[m] *= sign
        bounds[end] = bound_linear_function(linear, multipliers, target)[end]
    return bounds[0], bounds[1], explained


@kernel
def narrow_across(
    box: FloatArray,
    linear: Linearization,
    turned: ProcrustesFrame,
    table: FloatArray,
    active: IntArray,
    pairs: IntArray,
) -> bool:
    """
    Narrow what some pairs are displaced across themselves, and with it the residuals.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2.
    linear : Linearization
        The measured pairs in the Procrustes frame.
    turned : ProcrustesFrame
        The frame, with bounds of the displacements.
    table, active
        See `set_table`.
    pairs : ndarray of int, shape (k, 2)
        The pairs, i < j.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

    """
    target = np.empty_like(linear.reference)
    nothing = np.zeros(len(linear.edges))
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        _, slack = set_free_across(linear, turned, i, j, target)
        low, high, _ = bound_by_program(linear, table, active, target, nothing)
        if narrow_bounds(turned.across[i], j, down(low - slack), up(high + slack)) < 0.0:
            return False
    return complete_bounds(box, linear, turned)


@kernel
def narrow_pairs(
    box: FloatArray,
    linear: Linearization,
    turned: ProcrustesFrame,
    table: FloatArray,
    active: IntArray,
    pairs: IntArray,
    errors: FloatArray,
    explained: FloatArray,
) -> bool:
    """
    Narrow some pairs of a box in place, in the Procrustes frame.

    Parameters
    ----------
    box, linear, turned, table, active, pairs
        See `narrow_across`.
    errors : ndarray, shape (m,)
        Width of the measured intervals of the problem in m^2.
    explained : ndarray, shape (k,)
        Where the width of the linear program for each pair is written, in m^2: what the errors
        explain to first order. Left as it is where there is no linear program.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

    """
    target = np.zeros_like(linear.reference)
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        s_m2 = reference_distance_m2(linear.reference, i, j)
        if s_m2 == 0.0:
            continue
        for axis in range(target.shape[1]):
            target[i, axis] = linear.reference[i, axis] - linear.reference[j, axis]
            target[j, axis] = -target[i, axis]
        low, high, half = bound_by_program(linear, table, active, target, errors)
        target[i] = 0.0
        target[j] = 0.0
        explained[p] = 2.0 * half
        if narrow_bounds(turned.along[i], j, low, high) < 0.0:
            return False
        along = add(s_m2, s_m2, turned.along[i, LOWER, j], turned.along[i, UPPER, j])
        across = square(turned.across[i, LOWER, j], turned.across[i, UPPER, j])
        low, high = div(*add(*square(*along), *across), s_m2, s_m2)
        if not narrow(box, i, j, max(low, 0.0), high):
            return False
    return True
