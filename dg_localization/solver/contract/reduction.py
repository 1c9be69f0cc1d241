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
from dg_localization.solver.box import (
    GAP_LOWER,
    GAP_UPPER,
    LOWER,
    UPPER,
    FloatArray,
    IntArray,
    exclude,
    narrow,
)
from dg_localization.solver.contract.back_projection import back_project
from dg_localization.solver.contract.line import reduce_line
from dg_localization.solver.contract.projection import Rows, is_axis, lanes_of, make_rows, project
from dg_localization.solver.contract.sides import Sides, set_sigma
from dg_localization.solver.contract.widths import rank_points

SMALL_FLEET = 7
"""Up to this many points all axes are applied, before linear combinations and in projections."""

MOST_THROUGH = 16
"""On the line, points are compared through this many of the best known others."""

Face = tuple[int, int, int]
"""The points of a face, filled up to three with -1."""

NO_FACE = (-1, -1, -1)


class Workspace(NamedTuple):
    """Scratch arrays of one contraction; `rows` has a level for each projection, at least one."""

    box: FloatArray  # (4, n, n)
    points: IntArray  # (n,): the points in the order in which they are projected
    row_points: IntArray  # (q - 1, n): this and the next four are `Rows`
    ends: FloatArray
    squared: FloatArray
    along: FloatArray
    across: FloatArray
    distance: FloatArray  # (4, n, w)
    is_open: NDArray[np.bool_]  # (n, w)
    n_open: IntArray  # (n,)
    names: IntArray  # (n,): the points on the line
    in_order: IntArray  # (n,): 0, 1, ..., the points of a projected box
    sigma: NDArray[np.int8]  # (n, n)


def make_workspace(n_points: int, dimension: int) -> Workspace:
    """Allocate the scratch arrays for `n_points` in `dimension`."""
    levels = max(1, dimension - 1)
    rows = Rows._make(np.zeros((levels, *p.shape), p.dtype) for p in make_rows(n_points))
    shape = rows.across.shape[2:]
    return Workspace(
        np.zeros((4, n_points, n_points)),
        np.arange(n_points),
        *rows,
        distance=np.zeros((4, *shape)),
        is_open=np.zeros(shape, dtype=np.bool_),
        n_open=np.zeros(n_points, dtype=np.int64),
        names=np.zeros(n_points, dtype=np.int64),
        in_order=np.arange(n_points),
        sigma=np.zeros((n_points, n_points), dtype=np.int8),
    )


@kernel(inlined=True)
def rows_of(work: Workspace, level: int) -> Rows:
    """Return the rows of a projection."""
    return Rows(
        work.row_points[level],
        work.ends[level],
        work.squared[level],
        work.along[level],
        work.across[level],
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
    work: Workspace, sides: Sides, level: int, points: IntArray, merged: int, face: Face
) -> bool:
    """Reduce the line of some points at `level`, where `merged` is the image of a face."""
    f0, f1, f2 = _in_order(face)
    known = f0 >= 0 and set_sigma(work.sigma, sides, f0, f1, f2, True)
    left = reduce_line(
        work.across[level],
        work.distance,
        work.is_open,
        work.n_open,
        points,
        MOST_THROUGH,
        merged if known else -1,
        work.sigma,
    )
    if known:
        set_sigma(work.sigma, sides, f0, f1, f2, False)
    return left


@kernel(inlined=True)
def reduce_plane(work: Workspace, sides: Sides, count: int, a: int, b: int) -> bool:
    """Project the plane along (a, b) to a line, reduce that, and return."""
    rows = rows_of(work, 0)
    n_projected = project(work.box, rows, work.points[:count], a, b)
    if n_projected < 0:
        return False
    if not reduce_to_line(work, sides, 0, rows.points[:n_projected], a, (a, b, -1)):
        return False
    return back_project(work.box, rows, n_projected, a, b)


@kernel(inlined=True)
def reduce_projected_plane(
    work: Workspace, sides: Sides, points: IntArray, x: int, y: int, face: Face
) -> bool:
    """Do the same with a projection of space, along the points in its rows `x` and `y`."""
    plane, rows = rows_of(work, 0), rows_of(work, 1)
    n_projected = project(plane.across, rows, points, x, y)
    if n_projected < 0:
        return False
    for z in range(n_projected):
        work.names[z] = plane.points[rows.points[z]]
    if not reduce_to_line(work, sides, 1, work.names[:n_projected], plane.points[x], face):
        return False
    return back_project(plane.across, rows, n_projected, x, y)


@kernel(inlined=True)
def reduce_space(work: Workspace, sides: Sides, count: int, a: int, b: int) -> bool:
    """Project space along (a, b) to a plane, reduce that along the axes of faces, and return."""
    rows = rows_of(work, 0)
    n_projected = project(work.box, rows, work.points[:count], a, b)
    if n_projected < 0:
        return False
    points, last = work.in_order[:n_projected], n_projected - 1
    for x in range(last):
        if is_axis(rows.across, last, x):
            if not reduce_projected_plane(work, sides, points, last, x, (a, b, rows.points[x])):
                return False
    # Other axes span no face {a, b, e}, cost n times as much, and save enough boxes only if there
    # are few points (benchmarks/notes).
    if n_projected < SMALL_FLEET:
        for x in range(last):
            for y in range(x + 1, last):
                if is_axis(rows.across, x, y):
                    if not reduce_projected_plane(work, sides, points, x, y, NO_FACE):
                        return False
    return back_project(work.box, rows, n_projected, a, b)


@kernel(inlined=True)
def _reduce_whole_line(work: Workspace, sides: Sides, merged: int) -> bool:
    """Reduce a fleet on a line; its box has no spare lanes."""
    box, across = work.box, work.across[0]
    count = box.shape[1]
    for x in range(count):
        for plane in range(4):
            for y in range(lanes_of(count)):
                across[plane, x, y] = box[plane, x, y] if y < count else 0.0
    if not reduce_to_line(work, sides, 0, work.in_order, merged, (merged, merged, -1)):
        return False
    for x in range(count):
        for y in range(x + 1, count):
            if not narrow(box, x, y, across[LOWER, x, y], across[UPPER, x, y]):
                return False
            if not exclude(box, x, y, across[GAP_LOWER, x, y], across[GAP_UPPER, x, y]):
                return False
    return True


@kernel(borrows=True)
def apply_axes(
    box: FloatArray,
    points: IntArray,
    row_points: IntArray,
    ends: FloatArray,
    squared: FloatArray,
    along: FloatArray,
    across: FloatArray,
    distance: FloatArray,
    is_open: NDArray[np.bool_],
    n_open: IntArray,
    names: IntArray,
    in_order: IntArray,
    sigma: NDArray[np.int8],
    start: IntArray,
    stop: IntArray,
    rows: IntArray,
    dimension: int,
    axes: IntArray,
    count: int,
) -> bool:
    """
    Project the `count` points known best along one axis after the other, reduce, back-project.

    Called as ``apply_axes(*work, *sides, dimension, axes, count)``: arguments from Python are
    flat, because numba takes six times as long to unpack named tuples.

    Return False if the box is proved to hold no placement.
    """
    work = Workspace(
        box,
        points,
        row_points,
        ends,
        squared,
        along,
        across,
        distance,
        is_open,
        n_open,
        names,
        in_order,
        sigma,
    )
    sides = Sides(start, stop, rows)
    for x in range(len(axes)):
        a, b = axes[x, 0], axes[x, 1]
        if dimension == 1:
            left = _reduce_whole_line(work, sides, a)
        elif not is_axis(box, a, b):
            continue
        else:
            if box.shape[1] > MOST_THROUGH:
                rank_points(box, a, b, points)
            if dimension == 2:
                left = reduce_plane(work, sides, count, a, b)
            else:
                left = reduce_space(work, sides, count, a, b)
        if not left:
            return False
    return True
