# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear combinations of measured pairs, group by group, or for some pairs of a group."""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import FloatArray, IntArray, sub_box
from dg_localization.solver.contract.linear import contract_linear
from dg_localization.solver.contract.local_frames import contract_in_frame
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
    Narrow every group of connected points by linear combinations of its measured pairs.

    Called as ``combine(*groups, box, dimension, explained)``; see `apply_axes` for the reason.

    Parameters
    ----------
    offsets, members, edge_offsets, edges, errors
        The fields of `Groups`.
    box : ndarray, shape (4, n, n)
        The box in m^2, narrowed in place.
    dimension : int
        The dimension q of the space.
    explained : ndarray, shape (n, n)
        Where the widths that measurement errors explain are written, in m^2; zero for the pairs
        of a group that the measurements do not make rigid.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

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


@kernel
def combine_in_frame(
    offsets: IntArray,
    members: IntArray,
    edge_offsets: IntArray,
    edges: IntArray,
    errors: FloatArray,
    box: FloatArray,
    positions: FloatArray,
    pairs: IntArray,
    explained: FloatArray,
) -> bool:
    """
    Narrow unknown pairs by the measured pairs of their group, in the frame of the first of them.

    Called as ``combine_in_frame(*groups, box, positions, pairs, explained)``.

    Parameters
    ----------
    offsets, members, edge_offsets, edges, errors
        The fields of `Groups`.
    box : ndarray, shape (4, n, n)
        The box in m^2, narrowed in place.
    positions : ndarray, shape (n, q)
        A placement in or near the box, in m.
    pairs : ndarray of int, shape (k, 2)
        The pairs, of one group.
    explained : ndarray, shape (k,)
        See `contract_in_frame`.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

    """
    number = np.full(box.shape[1], -1)
    for group in range(len(offsets) - 1):
        points = members[offsets[group] : offsets[group + 1]]
        for x in range(len(points)):
            number[points[x]] = x
        if number[pairs[0, 0]] < 0:
            continue
        local = sub_box(box, points)
        local_pairs = np.empty_like(pairs)
        for p in range(len(pairs)):
            local_pairs[p, 0], local_pairs[p, 1] = number[pairs[p, 0]], number[pairs[p, 1]]
        start, end = edge_offsets[group], edge_offsets[group + 1]
        if not contract_in_frame(
            local, positions[points], edges[start:end], errors[start:end], local_pairs, explained
        ):
            return False
        for p in range(len(pairs)):
            i, j = pairs[p, 0], pairs[p, 1]
            for plane in range(4):
                box[plane, i, j] = local[plane, local_pairs[p, 0], local_pairs[p, 1]]
                box[plane, j, i] = box[plane, i, j]
        break
    return True
