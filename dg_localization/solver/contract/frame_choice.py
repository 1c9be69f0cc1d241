# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The choice of a frame at two points in which the displacements of all points are small.

Coordinates made from the distances to the points of a frame alone are bad near its axis; the
distances between all points contract them.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, up
from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.contract.coordinate_boxes import contract_coordinate_boxes
from dg_localization.solver.contract.linearization import Linearization, set_displacements
from dg_localization.solver.contract.newton import narrow_bounds
from dg_localization.solver.contract.reference import (
    complete_frame,
    point_errors_m,
    set_reference,
)

FRAMES_TRIED = 3
"""Frames whose coordinates are contracted, the best ones before that."""

COORDINATE_SWEEPS = 10


@kernel
def _open_frame(
    box: FloatArray, positions: FloatArray, a: int, b: int, linear: Linearization
) -> int:
    """Bound the displacements in the frame of two points; return as `set_displacements` does."""
    frame = np.full(3, -1)
    frame[0], frame[1] = a, b
    basis = np.zeros((2, 2))
    if not complete_frame(positions, point_errors_m(box, frame[:2]), frame, basis):
        return -2
    if not set_reference(positions, frame, basis, linear.reference):
        return -2
    return set_displacements(box, frame, linear)


@kernel
def _mean_displacement_m(linear: Linearization) -> float:
    """Return about how far a point may be displaced."""
    displacements = linear.displacements
    return np.maximum(-displacements[:, LOWER], displacements[:, UPPER]).mean()


@kernel
def _contract_coordinates(box: FloatArray, linear: Linearization) -> bool:
    """Narrow the displacements by the distances of all pairs; False when nothing is left."""
    reference, displacements = linear.reference, linear.displacements
    n_points, dimension = reference.shape
    low, high = np.empty((n_points, dimension)), np.empty((n_points, dimension))
    for i in range(n_points):
        for axis in range(dimension):
            low[i, axis] = down(reference[i, axis] + displacements[i, LOWER, axis])
            high[i, axis] = up(reference[i, axis] + displacements[i, UPPER, axis])
    if not contract_coordinate_boxes(low, high, box[LOWER], box[UPPER], COORDINATE_SWEEPS):
        return False
    for i in range(n_points):
        for axis in range(dimension):
            below = down(low[i, axis] - reference[i, axis])
            above = up(high[i, axis] - reference[i, axis])
            if narrow_bounds(displacements[i], axis, below, above) < 0.0:
                return False
    return True


@kernel
def choose_frame(box: FloatArray, positions: FloatArray, linear: Linearization) -> int:
    """
    Choose a frame at a measured pair in which the displacements are small, and bound them.

    Returns the number of unknown ones, -1 when no placement is left and -2 when there is no frame.
    """
    edges = linear.edges
    rough_m = np.full(len(edges), np.inf)
    for m in range(len(edges)):
        n_unknowns = _open_frame(box, positions, edges[m, 0], edges[m, 1], linear)
        if n_unknowns == -1:
            return -1
        if n_unknowns > 0:
            rough_m[m] = _mean_displacement_m(linear)
    best_m, best = np.inf, -1
    for _ in range(min(FRAMES_TRIED, len(edges))):
        m = int(np.argmin(rough_m))
        if math.isinf(rough_m[m]):
            break
        rough_m[m] = np.inf
        _open_frame(box, positions, edges[m, 0], edges[m, 1], linear)
        if not _contract_coordinates(box, linear):
            return -1
        mean_m = _mean_displacement_m(linear)
        if mean_m < best_m:
            best_m, best = mean_m, m
    if best < 0:
        return -2
    n_unknowns = _open_frame(box, positions, edges[best, 0], edges[best, 1], linear)
    return n_unknowns if _contract_coordinates(box, linear) else -1
