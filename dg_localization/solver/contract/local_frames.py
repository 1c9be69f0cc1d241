# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Contraction of pairs by linear programs, in a frame at two points.

In the frame of two points neither rotates against the other: the square of their relative
displacement is nearly known, and the squares of the pairs around them are small. With the
multipliers of the linear program (`simplex`), the bounds are close to the linearized hull. A frame
costs as much as a pass over the whole box, so it is used for tightening only, and serves all pairs
that share a point with it.
"""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK, kernel, look_after
from dg_localization.interval.pave import LEAST_GAIN
from dg_localization.interval.simplex import (
    LinearPrograms,
    activate_well_known,
    find_multipliers,
    new_programs,
)
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.linearization import (
    Linearization,
    bound_linear_function,
    linearize,
    narrow_to_linear,
    point_errors_m,
    set_residuals,
)
from dg_localization.solver.contract.newton import narrow_bounds, narrow_displacements

TOLERANCE = 0.03
"""Fraction of their widths by which measured pairs may violate bounds in a linear program."""

MAX_COMBINATIONS = 4
"""Most times that linear programs of all measured pairs are repeated."""


def contract_in_frame(
    box: FloatArray,
    positions: FloatArray,
    edges: IntArray,
    errors: FloatArray,
    pairs: IntArray,
    explained: FloatArray,
) -> bool:
    """
    Narrow some pairs of a box in place, in the frame of the first pair; return False if empty.

    Any placement is sound; the upper bounds of the box are finite. The widths that errors explain
    to first order, in m^2, are written for pairs with a linear program.
    """
    n_points, dimension = positions.shape
    frame = np.full(dimension + 1, -1)
    frame[:2] = pairs[0]
    linear, n_unknowns = linearize(box, positions, edges, point_errors_m(box, frame[:2]), frame)
    if n_unknowns < 0:
        return bool(n_unknowns != -1)
    relative = np.empty((len(edges), 2, dimension))
    if not narrow_displacements(box, linear, relative):
        return False
    programs = _programs_of(linear, n_unknowns)
    if not activate_well_known(programs):
        return True
    for _ in range(MAX_COMBINATIONS):
        # Programs of many points take a second.
        look_after(WORK_PER_LOOK)
        gain = _narrow_by_programs(linear, programs, relative, errors)
        if gain < 0.0:
            return False
        set_residuals(box, linear, relative)
        if gain < LEAST_GAIN:
            break
    return bool(_narrow_pairs(box, linear, programs, errors, pairs, explained))


@kernel
def _programs_of(linear: Linearization, n_unknowns: int) -> LinearPrograms:
    """Return the linear programs of the measured pairs, which share the array of residuals."""
    n_edges, dimension = linear.gradients.shape
    slopes = np.zeros((n_unknowns, n_edges))
    for m in range(n_edges):
        for axis in range(dimension):
            for end in range(2):
                unknown = linear.unknowns[linear.edges[m, end], axis]
                if unknown >= 0:
                    slopes[unknown, m] = (1.0 - 2.0 * end) * linear.gradients[m, axis]
    return new_programs(slopes, linear.residuals)


@kernel
def _narrow_by_programs(
    linear: Linearization, programs: LinearPrograms, relative: FloatArray, errors: FloatArray
) -> float:
    """Narrow the relative displacements of the measured pairs; return the gain, -1 if empty."""
    n_points, dimension = linear.reference.shape
    target = np.zeros((n_points, dimension))
    largest_gain = 0.0
    for m in range(len(linear.edges)):
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        for axis in range(dimension):
            target[i, axis], target[j, axis] = 1.0, -1.0
            low, high, _ = _bound_by_program(linear, programs, target, errors)
            target[i, axis], target[j, axis] = 0.0, 0.0
            gain = narrow_bounds(relative[m], axis, low, high)
            if gain < 0.0:
                return -1.0
            largest_gain = max(largest_gain, gain)
    return largest_gain


@kernel
def _narrow_pairs(
    box: FloatArray,
    linear: Linearization,
    programs: LinearPrograms,
    errors: FloatArray,
    pairs: IntArray,
    explained: FloatArray,
) -> bool:
    """Narrow some pairs of a box, and write what errors explain of each; False when empty."""
    n_points, dimension = linear.reference.shape
    target = np.zeros((n_points, dimension))
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        for axis in range(dimension):
            target[i, axis] = 2.0 * (linear.reference[i, axis] - linear.reference[j, axis])
            target[j, axis] = -target[i, axis]
        low, high, explained[p] = _bound_by_program(linear, programs, target, errors)
        if not narrow_to_linear(box, linear, i, j, low, high):
            return False
        for axis in range(dimension):
            target[i, axis] = 0.0
            target[j, axis] = 0.0
    return True


@kernel
def _bound_by_program(
    linear: Linearization, programs: LinearPrograms, target: FloatArray, errors: FloatArray
) -> tuple[float, float, float]:
    """Return bounds of a linear function of the displacements, and the width errors explain."""
    n_unknowns = len(programs.active)
    function = programs.table[n_unknowns]
    multipliers = np.empty(len(linear.edges))
    bounds = np.empty(2)
    explained = 0.0
    for end in range(2):
        sign = 1.0 if end == UPPER else -1.0
        function[:] = 0.0
        for i in range(len(target)):
            for axis in range(target.shape[1]):
                unknown = linear.unknowns[i, axis]
                if unknown >= 0 and target[i, axis] != 0.0:
                    function += sign * target[i, axis] * programs.table[unknown]
        find_multipliers(programs, TOLERANCE)
        multipliers[:] = 0.0
        for c in range(n_unknowns):
            multipliers[programs.active[c]] = sign * function[c]
        for m in range(len(multipliers)):
            explained += 0.5 * abs(multipliers[m]) * errors[m]
        bounds[end] = bound_linear_function(linear, multipliers, target)[end]
    return bounds[LOWER], bounds[UPPER], explained
