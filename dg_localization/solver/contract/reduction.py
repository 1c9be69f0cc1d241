# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
One axis: project, reduce, back-project (Sections 4.1 to 4.3).

The space of dimension q is projected q - 1 times; what is left is the line of Section 4.2. Level
k of the workspace holds the problem after k projections. (The levels are spelt out: numba cannot
load a self-recursive kernel from its cache.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.contract.axes import rank_points
from dg_localization.solver.contract.back_projection import back_project
from dg_localization.solver.contract.line import LANES, reduce_line
from dg_localization.solver.contract.projection import is_axis, project
from dg_localization.solver.contract.sides import Sides, set_sigma

SMALL_FLEET = 7
"""Up to so many points all axes are applied, before linear combinations and in projections."""

MOST_THROUGH = 16
"""On the line, points are compared through this many of the best known others."""

Face = tuple[int, int, int]
"""The points of a face; -1 for those that it has less than three."""

NO_FACE = (-1, -1, -1)


class Workspace(NamedTuple):
    """Scratch arrays of one contraction, a slice per level of projection."""

    boxes: FloatArray  # (q, 4, n, n): the box and its projections
    coordinates: FloatArray  # (q, 2, n)
    points: IntArray  # (q, n)
    distance: FloatArray  # (4, n, w), with w points in whole lanes
    is_open: NDArray[np.bool_]  # (n, w)
    n_open: IntArray  # (n,)
    sigma: NDArray[np.int8]  # (n, n)


def make_workspace(n_points: int, dimension: int) -> Workspace:
    """Allocate the scratch arrays for `n_points` in `dimension`."""
    points = np.zeros((dimension, n_points), dtype=np.int64)
    points[0] = np.arange(n_points)
    width = (n_points + LANES - 1) // LANES * LANES
    return Workspace(
        boxes=np.zeros((dimension, 4, n_points, n_points)),
        coordinates=np.zeros((dimension, 2, n_points)),
        points=points,
        distance=np.zeros((4, n_points, width)),
        is_open=np.zeros((n_points, width), dtype=np.bool_),
        n_open=np.zeros(n_points, dtype=np.int64),
        sigma=np.zeros((n_points, n_points), dtype=np.int8),
    )


@kernel(inlined=True)
def _in_order(face: Face) -> Face:
    """Return a face with its points in ascending order; a third one of -1 stays last."""
    f0, f1, f2 = face
    if f0 > f1:
        f0, f1 = f1, f0
    if f2 >= 0:
        if f1 > f2:
            f1, f2 = f2, f1
        if f0 > f1:
            f0, f1 = f1, f0
    return f0, f1, f2


@kernel(inlined=True)
def reduce_to_line(
    work: Workspace, sides: Sides, level: int, count: int, merged: int, face: Face
) -> bool:
    """Reduce the line at `level`, where `merged` is the image of a face with known sides."""
    f0, f1, f2 = _in_order(face)
    known = f0 >= 0 and set_sigma(work.sigma, sides, f0, f1, f2, True)
    left = reduce_line(
        work.boxes[level],
        work.distance,
        work.is_open,
        work.n_open,
        work.points[level, :count],
        MOST_THROUGH,
        merged if known else -1,
        work.sigma,
    )
    if known:
        set_sigma(work.sigma, sides, f0, f1, f2, False)
    return left


@kernel(inlined=True)
def reduce_plane(
    work: Workspace, sides: Sides, level: int, count: int, a: int, b: int, face: Face
) -> bool:
    """Project the plane at `level` along (a, b) to a line, reduce that, and return."""
    box, projected = work.boxes[level], work.boxes[level + 1]
    coordinates = work.coordinates[level]
    points, projected_points = work.points[level, :count], work.points[level + 1]
    n_projected = project(box, projected, coordinates, points, projected_points, a, b)
    if n_projected < 0:
        return False
    if not reduce_to_line(work, sides, level + 1, n_projected, a, face):
        return False
    return back_project(box, projected, coordinates, projected_points[:n_projected], a, b)


@kernel(inlined=True)
def reduce_space(work: Workspace, sides: Sides, count: int, a: int, b: int) -> bool:
    """Project space along (a, b) to a plane, reduce that along the axes of faces, and return."""
    box, projected, coordinates = work.boxes[0], work.boxes[1], work.coordinates[0]
    points, projected_points = work.points[0, :count], work.points[1]
    n_projected = project(box, projected, coordinates, points, projected_points, a, b)
    if n_projected < 0:
        return False
    for x in range(1, n_projected):
        e = projected_points[x]
        if is_axis(projected, a, e):
            if not reduce_plane(work, sides, 1, n_projected, a, e, (a, b, e)):
                return False
    # The others span no face {a, b, e}, cost n times as much, and save enough boxes only where
    # points are few (docs/projections.md).
    if n_projected < SMALL_FLEET:
        for x in range(1, n_projected):
            for y in range(x + 1, n_projected):
                e, f = projected_points[x], projected_points[y]
                if is_axis(projected, e, f):
                    if not reduce_plane(work, sides, 1, n_projected, e, f, NO_FACE):
                        return False
    return back_project(box, projected, coordinates, projected_points[:n_projected], a, b)


@kernel(inlined=True)
def _apply_axis(work: Workspace, sides: Sides, a: int, b: int, count: int) -> bool:
    """Project the `count` points known best along an axis, reduce, and back-project."""
    dimension, _, n_points, _ = work.boxes.shape
    box = work.boxes[0]
    if dimension == 1:
        return reduce_to_line(work, sides, 0, n_points, a, (a, a, -1))
    if not is_axis(box, a, b):
        return True
    if n_points > MOST_THROUGH:
        rank_points(box, a, b, work.points[0])
    if dimension == 2:
        return reduce_plane(work, sides, 0, count, a, b, (a, b, -1))
    return reduce_space(work, sides, count, a, b)


@kernel(borrows=True)
def apply_axes(
    boxes: FloatArray,
    coordinates: FloatArray,
    points: IntArray,
    distance: FloatArray,
    is_open: NDArray[np.bool_],
    n_open: IntArray,
    sigma: NDArray[np.int8],
    start: IntArray,
    stop: IntArray,
    rows: IntArray,
    axes: IntArray,
    count: int,
) -> bool:
    """
    Project along one axis after the other, reduce, and back-project.

    Called as ``apply_axes(*work, *sides, axes, count)``: what enters from Python enters flat,
    because numba takes six times as long to unpack named tuples.

    Parameters
    ----------
    boxes, coordinates, points, distance, is_open, n_open, sigma
        The fields of a `Workspace`; the first box is narrowed in place.
    start, stop, rows
        The fields of `Sides`.
    axes : ndarray of int, shape (k, 2)
        The axes, in the order in which they are applied.
    count : int
        How many points are projected, those best known from the ends of the axis.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

    """
    work = Workspace(boxes, coordinates, points, distance, is_open, n_open, sigma)
    sides = Sides(start, stop, rows)
    for x in range(len(axes)):
        if not _apply_axis(work, sides, axes[x, 0], axes[x, 1], count):
            return False
    return True
