"""
Contraction of single pairs by linear combinations, each in a frame of its own.

In the frame of the two points that are sought, neither turns against the other: the square of
their relative displacement is nearly known, and those of the pairs that matter are small. With the
multipliers of the linear program (`simplex`), what is left is close to the linearized hull. Each
pair costs as much as a pass over the whole box does, so this is a means of tightening.
"""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, up
from dg_localization.solver.box import FloatArray, IntArray, narrow
from dg_localization.solver.contract.linear import narrow_displacements
from dg_localization.solver.contract.linearization import (
    bound_linear_function,
    complete_frame,
    point_errors_m,
    set_displacements,
    set_reference,
    square_of_difference,
    squared_length,
)
from dg_localization.solver.contract.simplex import set_multipliers, set_table

MOST_STEPS = 20
"""Interval Newton steps: in a box as wide as these are they gain little each at first."""


@kernel
def contract_pair(
    box: FloatArray, positions: FloatArray, edges: IntArray, k: int, other: int
) -> bool:
    """
    Narrow an unknown pair of a box by the measured pairs, in place, in a frame at its points.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2; all its upper bounds are finite.
    positions : ndarray, shape (n, q)
        A placement in or near the box, in m; any placement is sound.
    edges : ndarray of int, shape (m, 2)
        The measured pairs.
    k, other : int
        The pair.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

    """
    n_points, dimension = positions.shape
    n_edges = len(edges)
    frame = np.full(dimension + 1, -1)
    frame[0], frame[1] = k, other
    basis = np.zeros((dimension, dimension))
    reference = np.empty((n_points, dimension))
    errors_m = point_errors_m(box, frame[:2])
    if not complete_frame(positions, errors_m, frame, basis):
        return True
    if not set_reference(positions, frame, basis, reference):
        return True
    displacements = np.empty((n_points, 2, dimension))
    index = np.empty((n_points, dimension), dtype=np.int64)
    n_free = set_displacements(box, frame, reference, displacements, index)
    if n_free == -1:
        return False
    if n_free < 1 or n_edges < n_free:
        return True
    residuals = np.empty((n_edges, 2))
    if not narrow_displacements(
        box, reference, displacements, edges, index, residuals, MOST_STEPS
    ):
        return False
    table = np.empty((n_edges + n_free + 2, n_free))
    active = np.full(n_free, -1)
    if not set_table(reference, edges, index, residuals, table, active):
        return True
    target = np.zeros((n_points, dimension))
    for axis in range(dimension):
        target[k, axis] = 2.0 * (reference[k, axis] - reference[other, axis])
        target[other, axis] = -target[k, axis]
    low, high = _bound(table, active, residuals, target, reference, displacements, edges, index)
    square_low, square_high = square_of_difference(displacements[k], displacements[other])
    length = squared_length(reference, k, other)
    low = down(down(low + square_low) + length)
    high = up(up(high + square_high) + length)
    return narrow(box, k, other, low, high)


@kernel
def _bound(
    table: FloatArray,
    active: IntArray,
    residuals: FloatArray,
    target: FloatArray,
    reference: FloatArray,
    displacements: FloatArray,
    edges: IntArray,
    index: IntArray,
) -> tuple[float, float]:
    """Bound a linear function of the displacements, from either side with its own multipliers."""
    n_points, dimension = reference.shape
    n_edges, n_free = len(edges), len(active)
    multipliers = np.empty(n_edges)
    remainder = np.empty((2, n_points, dimension))
    bounds = np.empty(2)
    for end, sign in ((0, -1.0), (1, 1.0)):
        table[n_edges + n_free] = 0.0
        for i in range(n_points):
            for axis in range(dimension):
                if index[i, axis] >= 0 and target[i, axis] != 0.0:
                    row = n_edges + index[i, axis]
                    for c in range(n_free):
                        table[n_edges + n_free, c] += sign * target[i, axis] * table[row, c]
        set_multipliers(table, active, residuals, multipliers)
        for m in range(n_edges):
            multipliers[m] *= sign
        bounds[end] = bound_linear_function(
            multipliers, residuals, target, reference, displacements, edges, remainder
        )[end]
    return bounds[0], bounds[1]
