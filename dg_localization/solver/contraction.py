"""
Contraction of a box to a fixed point: project, reduce, back-project along the axes (Section 4).

The space of dimension q is projected q - 1 times; what is left is the line of Section 4.2. Level
k of the workspace holds the problem after k projections. (The levels are spelt out: numba cannot
load a self-recursive kernel from its cache.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.solver.back_projection import back_project
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.jit import kernel
from dg_localization.solver.line import reduce_line
from dg_localization.solver.projection import project
from dg_localization.solver.smoothing import smooth_triangles


class Sides(NamedTuple):
    """
    The known sides of points, sorted by face, for the kernels.

    The rows ``start[f0, f1]`` to ``stop[f0, f1]`` belong to the faces whose two smallest points
    are f0 < f1 (f0 = f1 in one dimension). Each row is (third point or -1, group, apex, sign).
    Two apexes of one face and group lie on the same side where their signs agree.
    """

    start: IntArray
    stop: IntArray
    rows: IntArray


class Workspace(NamedTuple):
    """Scratch arrays of one contraction, a slice per level of projection."""

    boxes: FloatArray  # (q, 4, n, n): the box and its projections
    coordinates: FloatArray  # (q, 2, n)
    points: IntArray  # (q, n)
    distance: FloatArray  # (4, n, n)
    sigma: NDArray[np.int8]  # (n, n)


def make_workspace(n_points: int, dimension: int) -> Workspace:
    """Allocate the scratch arrays for `n_points` in `dimension`."""
    points = np.zeros((dimension, n_points), dtype=np.int64)
    points[0] = np.arange(n_points)
    return Workspace(
        boxes=np.zeros((dimension, 4, n_points, n_points)),
        coordinates=np.zeros((dimension, 2, n_points)),
        points=points,
        distance=np.zeros((4, n_points, n_points)),
        sigma=np.zeros((n_points, n_points), dtype=np.int8),
    )


@kernel
def _set_sigma(
    sigma: NDArray[np.int8], sides: Sides, f0: int, f1: int, third: int, value: int
) -> bool:
    """Write `value` times the side of all pairs of apexes of a face; tell if any is known."""
    known = False
    stop = sides.stop[f0, f1]
    for x in range(sides.start[f0, f1], stop):
        if sides.rows[x, 0] != third:
            continue
        for y in range(x + 1, stop):
            if sides.rows[y, 0] == third and sides.rows[y, 1] == sides.rows[x, 1]:
                i = sides.rows[x, 2]
                k = sides.rows[y, 2]
                sigma[i, k] = sigma[k, i] = -value * sides.rows[x, 3] * sides.rows[y, 3]
                known = True
    return known


@kernel
def _reduce_shadow(
    work: Workspace, sides: Sides, level: int, count: int, merged: int, f0: int, f1: int, f2: int
) -> bool:
    """Reduce the line at `level` under the sides of the face {f0, f1, f2} that `merged` shows."""
    if f2 >= 0:
        # Sort the three points of the face.
        if f0 > f1:
            f0, f1 = f1, f0
        if f1 > f2:
            f1, f2 = f2, f1
        if f0 > f1:
            f0, f1 = f1, f0
    elif f0 > f1:
        f0, f1 = f1, f0
    known = f0 >= 0 and _set_sigma(work.sigma, sides, f0, f1, f2, 1)
    left = reduce_line(
        work.boxes[level],
        work.distance,
        work.points[level],
        count,
        merged if known else -1,
        work.sigma,
    )
    if known:
        _set_sigma(work.sigma, sides, f0, f1, f2, 0)
    return left


@kernel
def _reduce_plane(
    work: Workspace,
    sides: Sides,
    level: int,
    count: int,
    a: int,
    b: int,
    f0: int,
    f1: int,
    f2: int,
) -> bool:
    """Project the plane at `level` along (a, b) to a line, reduce that, and return."""
    shadow_count = project(
        work.boxes[level],
        work.boxes[level + 1],
        work.coordinates[level],
        work.points[level],
        count,
        work.points[level + 1],
        a,
        b,
    )
    if shadow_count < 0:
        return False
    if not _reduce_shadow(work, sides, level + 1, shadow_count, a, f0, f1, f2):
        return False
    return back_project(
        work.boxes[level],
        work.boxes[level + 1],
        work.coordinates[level],
        work.points[level + 1],
        shadow_count,
        a,
        b,
    )


@kernel
def _reduce_space(work: Workspace, sides: Sides, count: int, a: int, b: int) -> bool:
    """Project space along (a, b) to a plane, reduce that along all its axes, and return."""
    shadow_count = project(
        work.boxes[0],
        work.boxes[1],
        work.coordinates[0],
        work.points[0],
        count,
        work.points[1],
        a,
        b,
    )
    if shadow_count < 0:
        return False
    for x in range(shadow_count):
        for y in range(x + 1, shadow_count):
            c = work.points[1, x]
            e = work.points[1, y]
            if work.boxes[1, UPPER, c, e] == np.inf:
                continue
            # Only axes through the common image of a and b span a face, {a, b, e}.
            f0, f1, f2 = (a, b, e) if c == a else (-1, -1, -1)
            if not _reduce_plane(work, sides, 1, shadow_count, c, e, f0, f1, f2):
                return False
    return back_project(
        work.boxes[0],
        work.boxes[1],
        work.coordinates[0],
        work.points[1],
        shadow_count,
        a,
        b,
    )


@kernel
def _reduce_directly(work: Workspace, sides: Sides, count: int) -> bool:
    """Reduce a one-dimensional problem, in which every point is a face."""
    for x in range(count):
        face = work.points[0, x]
        if x == 0 or sides.stop[face, face] > sides.start[face, face]:
            if not _reduce_shadow(work, sides, 0, count, face, face, face, -1):
                return False
    return True


@kernel
def _remember_widths(box: FloatArray, widths: FloatArray, count: int) -> None:
    """Note the width of every range."""
    for i in range(count):
        for j in range(i + 1, count):
            widths[i, j] = box[UPPER, i, j] - box[LOWER, i, j]


@kernel
def _largest_gain(box: FloatArray, widths: FloatArray, count: int) -> float:
    """Return the largest relative reduction of a range since its width was noted."""
    gain = 0.0
    for i in range(count):
        for j in range(i + 1, count):
            width = widths[i, j]
            if np.isinf(width):
                if box[UPPER, i, j] < np.inf:
                    return 1.0
            elif width > 0.0:
                gain = max(gain, 1.0 - (box[UPPER, i, j] - box[LOWER, i, j]) / width)
    return gain


@kernel
def contract(
    box: FloatArray,
    work: Workspace,
    sides: Sides,
    axes: IntArray,
    max_sweeps: int,
    least_gain: float,
) -> bool:
    """
    Contract a box in place until a sweep over its axes gains little.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2.
    work : Workspace
        Scratch arrays; its first level is overwritten by `box`.
    sides : Sides
        The known sides.
    axes : ndarray of int, shape (k, 2)
        The axes to project along, tried in this order.
    max_sweeps : int
        Most sweeps over the axes.
    least_gain : float
        Stop when no range lost more than this fraction of its width in a sweep.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

    Notes
    -----
    Three laws: the result lies inside the input; no solution of the input is lost; what is
    removed once stays removed. (Section 4, with the triangle inequalities of Section 5.1 first.)

    """
    dimension = work.boxes.shape[0]
    n_points = box.shape[1]
    work.boxes[0][:] = box
    left = smooth_triangles(work.boxes[0], work.distance, work.points[0], n_points)
    widths = np.empty((n_points, n_points))
    for _ in range(max_sweeps):
        if not left:
            break
        _remember_widths(work.boxes[0], widths, n_points)
        if dimension == 1:
            left = _reduce_directly(work, sides, n_points)
        else:
            for x in range(axes.shape[0]):
                a = axes[x, 0]
                b = axes[x, 1]
                if work.boxes[0, UPPER, a, b] == np.inf or work.boxes[0, LOWER, a, b] <= 0.0:
                    continue
                if dimension == 2:
                    left = _reduce_plane(work, sides, 0, n_points, a, b, a, b, -1)
                else:
                    left = _reduce_space(work, sides, n_points, a, b)
                if not left:
                    break
        if left and _largest_gain(work.boxes[0], widths, n_points) < least_gain:
            break
    box[:] = work.boxes[0]
    return left
