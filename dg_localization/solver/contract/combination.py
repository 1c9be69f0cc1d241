# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear combinations of measured pairs, group by group."""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import FloatArray, IntArray, sub_box
from dg_localization.solver.contract.linear import contract_linear
from dg_localization.solver.contract.status import Status
from dg_localization.solver.contract.widths import largest_gain, remember_widths
from dg_localization.solver.place.placements import place

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
    n_points = box.shape[1]
    widths = np.empty((n_points, n_points))
    status = Status.NOT_RIGID
    # Any placement serves as a reference, that of the box as it was as well as a new one.
    positions = place(box, dimension, REFERENCE_STEPS)
    for _ in range(MAX_COMBINATIONS):
        remember_widths(box, widths)
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
