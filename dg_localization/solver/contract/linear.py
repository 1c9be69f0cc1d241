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

from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, Status, sub_box
from dg_localization.solver.contract.least_squares import leave_out, set_inverse, set_multipliers
from dg_localization.solver.contract.linearization import (
    Linearization,
    bound_linear_function,
    choose_axis,
    complete_frame,
    narrow_to_linear,
    new_linearization,
    point_errors_m,
    set_displacements,
    set_reference,
)
from dg_localization.solver.contract.newton import narrow_displacements
from dg_localization.solver.contract.widths import largest_gain
from dg_localization.solver.place.placements import place

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


class Groups(NamedTuple):
    """
    The points that chains of measured pairs connect, group by group, for the kernels.

    Group g has the points ``members[offsets[g]:offsets[g + 1]]`` and the measured pairs
    ``edges[edge_offsets[g]:edge_offsets[g + 1]]``, which count within its members.
    """

    offsets: IntArray
    members: IntArray
    edge_offsets: IntArray
    edges: IntArray
    errors: FloatArray  # width of each measured interval in m^2


@kernel
def groups_of(lower: FloatArray, upper: FloatArray) -> Groups:
    """Return the points of a problem in groups that chains of measured pairs connect."""
    n_points = len(upper)
    group_of = np.full(n_points, -1)
    queue = np.empty(n_points, dtype=np.int64)
    members = np.empty(n_points, dtype=np.int64)
    offsets = np.zeros(n_points + 1, dtype=np.int64)
    edge_offsets = np.zeros(n_points + 1, dtype=np.int64)
    edges = np.empty((n_points * n_points, 2), dtype=np.int64)
    errors = np.empty(n_points * n_points)
    n_groups = n_members = n_edges = 0
    for seed in range(n_points):
        if group_of[seed] >= 0:
            continue
        group_of[seed] = n_groups
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            point = queue[head]
            head += 1
            for other in range(n_points):
                if group_of[other] < 0 and upper[point, other] < np.inf:
                    group_of[other] = n_groups
                    queue[tail] = other
                    tail += 1
        first = n_members
        for point in range(n_points):
            if group_of[point] == n_groups:
                members[n_members] = point
                n_members += 1
        for x in range(first, n_members):
            for y in range(x + 1, n_members):
                i, j = members[x], members[y]
                if upper[i, j] < np.inf:
                    edges[n_edges, 0], edges[n_edges, 1] = x - first, y - first
                    errors[n_edges] = upper[i, j] - lower[i, j]
                    n_edges += 1
        n_groups += 1
        offsets[n_groups] = n_members
        edge_offsets[n_groups] = n_edges
    return Groups(
        offsets[: n_groups + 1].copy(),
        members,
        edge_offsets[: n_groups + 1].copy(),
        edges[:n_edges].copy(),
        errors[:n_edges].copy(),
    )


MAX_COMBINATIONS = 4
LEAST_COMBINATION_GAIN = 0.5
"""Linear combinations are repeated, at most so often, while they halve some interval."""

REFERENCE_STEPS = 3
"""Steps of least squares towards the reference placement, which need not agree with anything."""


@kernel
def _combine_group(
    box: FloatArray, dimension: int, edges: IntArray, errors: FloatArray, explained: FloatArray
) -> Status:
    """Narrow one group by linear combinations, as long as that gains much."""
    status = Status.NOT_RIGID
    # Any placement serves as a reference, that of the box as it was as well as a new one.
    positions = place(box, dimension, REFERENCE_STEPS)
    for _ in range(MAX_COMBINATIONS):
        widths = box[UPPER] - box[LOWER]
        status = contract_linear(box, positions, edges, errors, explained)
        if status != Status.CONTRACTED or largest_gain(box, widths) < LEAST_COMBINATION_GAIN:
            break
    return status


@kernel
def combine(
    offsets: IntArray,
    members: IntArray,
    edge_offsets: IntArray,
    edges: IntArray,
    errors: FloatArray,
    box: FloatArray,
    dimension: int,
    explained: FloatArray,
) -> bool:
    """
    Narrow every group of connected points by linear combinations of its measured pairs, in place.

    Called as ``combine(*groups, box, dimension, explained)``; see `apply_axes` for the reason. The
    widths that measurement errors explain are written in m^2, zero for the pairs of a group that
    the measurements do not make rigid. False when the box is proved to hold no placement.
    """
    explained[:] = 0.0
    for group in range(len(offsets) - 1):
        points = members[offsets[group] : offsets[group + 1]]
        size = len(points)
        if size < 2:
            continue
        local = sub_box(box, points)
        local_explained = np.empty((size, size))
        status = _combine_group(
            local,
            dimension,
            edges[edge_offsets[group] : edge_offsets[group + 1]],
            errors[edge_offsets[group] : edge_offsets[group + 1]],
            local_explained,
        )
        if status == Status.EMPTY:
            return False
        if status == Status.NOT_RIGID:
            continue
        for x in range(size):
            for y in range(size):
                if x != y:
                    explained[points[x], points[y]] = local_explained[x, y]
                    for plane in range(4):
                        box[plane, points[x], points[y]] = local[plane, x, y]
    return True
