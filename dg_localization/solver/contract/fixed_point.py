"""
Contraction of a box to a fixed point: project, reduce, back-project along the axes (Section 4).

The space of dimension q is projected q - 1 times; what is left is the line of Section 4.2. Level
k of the workspace holds the problem after k projections. (The levels are spelt out: numba cannot
load a self-recursive kernel from its cache.)
"""

from __future__ import annotations

import math
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
    copy_box,
    sub_box,
)
from dg_localization.solver.contract.back_projection import back_project
from dg_localization.solver.contract.line import BOTH, reduce_line
from dg_localization.solver.contract.linear import CONTRACTED, EMPTY, LEFT_ALONE, contract_linear
from dg_localization.solver.contract.projection import is_axis, project
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.place.placements import place

UNFINISHED = 3
"""Besides EMPTY and CONTRACTED: there is more to gain."""

SWEEP, NEXT_AXIS = range(2)

SMALL_FLEET = 7
"""Up to so many points all axes are applied, before linear combinations and in projections."""

MOST_THROUGH = 16
"""On the line, points are compared through this many of the best known others."""

LOCAL_POINTS = (20, 20, 12)
"""In a larger fleet of 1, 2, 3 dimensions the first sweep projects only so many points."""

AXES_BEFORE_SPLIT = 12
"""How many axes per point are tried before a box with a gap is split."""

LEAST_GAIN = 0.05
"""A sweep that shortens no range by more than this fraction is the last."""

LEAST_GAP = 0.1
"""A gap narrower than this fraction of the resolution is not worth a split."""

MAX_COMBINATIONS = 4
LEAST_COMBINATION_GAIN = 0.5
"""Linear combinations are repeated, at most so often, while they halve some range."""

EXPLAINED_FACTOR = 3.0
"""How much wider a finished box may be than the first-order effect of the measurement errors."""


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
    widths: FloatArray  # (n, n), m^2, when the sweep began
    explained: FloatArray  # (n, n), m^2
    order: IntArray  # (axes,)
    progress: IntArray  # (2,): SWEEP and NEXT_AXIS


def make_workspace(n_points: int, dimension: int, n_axes: int) -> Workspace:
    """Allocate the scratch arrays for `n_points` in `dimension`."""
    points = np.zeros((dimension, n_points), dtype=np.int64)
    points[0] = np.arange(n_points)
    return Workspace(
        boxes=np.zeros((dimension, 4, n_points, n_points)),
        coordinates=np.zeros((dimension, 2, n_points)),
        points=points,
        distance=np.zeros((4, n_points, n_points)),
        sigma=np.zeros((n_points, n_points), dtype=np.int8),
        widths=np.zeros((n_points, n_points)),
        explained=np.zeros((n_points, n_points)),
        order=np.arange(n_axes),
        progress=np.zeros(2, dtype=np.int64),
    )


@kernel(borrows=True)
def _set_sigma(
    sigma: NDArray[np.int8], sides: Sides, f0: int, f1: int, third: int, known_sides: bool
) -> bool:
    """
    Write the side of all pairs of apexes of a face, or clear it; tell if any is known.

    Two constraints that contradict each other leave both: such points lie on the face.
    """
    known = False
    stop = sides.stop[f0, f1]
    for x in range(sides.start[f0, f1], stop):
        if sides.rows[x, 0] != third:
            continue
        for y in range(x + 1, stop):
            if sides.rows[y, 0] == third and sides.rows[y, 1] == sides.rows[x, 1]:
                i = sides.rows[x, 2]
                k = sides.rows[y, 2]
                side = -sides.rows[x, 3] * sides.rows[y, 3] if known_sides else 0
                if side != 0 and sigma[i, k] != 0 and sigma[i, k] != side:
                    side = BOTH
                sigma[i, k] = sigma[k, i] = side
                known = True
    return known


@kernel(inlined=True)
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
    known = f0 >= 0 and _set_sigma(work.sigma, sides, f0, f1, f2, True)
    left = reduce_line(
        work.boxes[level],
        work.distance,
        work.points[level],
        count,
        MOST_THROUGH,
        merged if known else -1,
        work.sigma,
    )
    if known:
        _set_sigma(work.sigma, sides, f0, f1, f2, False)
    return left


@kernel(inlined=True)
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


@kernel(inlined=True)
def _reduce_space(work: Workspace, sides: Sides, count: int, a: int, b: int) -> bool:
    """Project space along (a, b) to a plane, reduce that along the axes of faces, and return."""
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
    for x in range(1, shadow_count):
        e = work.points[1, x]
        if is_axis(work.boxes[1], a, e):
            if not _reduce_plane(work, sides, 1, shadow_count, a, e, a, b, e):
                return False
    # The others span no face {a, b, e}, cost n times as much, and save enough boxes only where
    # points are few (docs/projections.md).
    if shadow_count < SMALL_FLEET:
        for x in range(1, shadow_count):
            for y in range(x + 1, shadow_count):
                e, f = work.points[1, x], work.points[1, y]
                if is_axis(work.boxes[1], e, f):
                    if not _reduce_plane(work, sides, 1, shadow_count, e, f, -1, -1, -1):
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


@kernel(borrows=True)
def _remember_widths(box: FloatArray, widths: FloatArray, count: int) -> None:
    """Note the width of every range."""
    for i in range(count):
        for j in range(i + 1, count):
            widths[i, j] = box[UPPER, i, j] - box[LOWER, i, j]


@kernel(borrows=True)
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


@kernel(borrows=True)
def _relative_error(box: FloatArray, i: int, j: int) -> float:
    """Return how much of the squared distance of a pair is unknown, from 0 to 1."""
    if np.isinf(box[UPPER, i, j]):
        return 1.0
    return 1.0 - box[LOWER, i, j] / max(box[UPPER, i, j], 1e-300)


@kernel
def _rank_points(box: FloatArray, a: int, b: int, points: IntArray) -> None:
    """Order the points by how well their distances to the ends of an axis are known."""
    n_points = box.shape[1]
    errors = np.empty(n_points)
    for i in range(n_points):
        errors[i] = _relative_error(box, a, i) + _relative_error(box, b, i)
    errors[a] = errors[b] = -1.0
    points[:] = np.argsort(errors, kind='mergesort')


@kernel(inlined=True)
def _apply_axis(work: Workspace, sides: Sides, a: int, b: int, count: int) -> bool:
    """Project the `count` points known best along an axis, reduce, and back-project."""
    dimension, _, n_points, _ = work.boxes.shape
    box = work.boxes[0]
    if dimension == 1:
        return _reduce_shadow(work, sides, 0, n_points, a, a, a, -1)
    if not is_axis(box, a, b):
        return True
    if n_points > MOST_THROUGH:
        _rank_points(box, a, b, work.points[0])
    if dimension == 2:
        return _reduce_plane(work, sides, 0, count, a, b, a, b, -1)
    return _reduce_space(work, sides, count, a, b)


@kernel
def _combine_group(
    box: FloatArray, dimension: int, edges: IntArray, errors: FloatArray, explained: FloatArray
) -> int:
    """Narrow one group by linear combinations, as long as that gains much."""
    n_points = box.shape[1]
    widths = np.empty((n_points, n_points))
    status = LEFT_ALONE
    # Any placement serves as a reference, that of the box as it was as well as a new one.
    positions = place(box, dimension)
    for _ in range(MAX_COMBINATIONS):
        _remember_widths(box, widths, n_points)
        status = contract_linear(box, positions, edges, errors, explained)
        if status != CONTRACTED or _largest_gain(box, widths, n_points) < LEAST_COMBINATION_GAIN:
            break
    return status


@kernel
def combine(box: FloatArray, dimension: int, groups: Groups, explained: FloatArray) -> bool:
    """
    Narrow every group of connected points by linear combinations of its measured pairs.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2, narrowed in place.
    dimension : int
        The dimension q of the space.
    groups : Groups
        The groups.
    explained : ndarray, shape (n, n)
        Where the widths that measurement errors explain are written, in m^2; zero for the pairs
        of a group that the measurements do not make rigid.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

    """
    explained[:] = 0.0
    for group in range(len(groups.offsets) - 1):
        members = groups.members[groups.offsets[group] : groups.offsets[group + 1]]
        size = len(members)
        if size < 2:
            continue
        edges = groups.edges[groups.edge_offsets[group] : groups.edge_offsets[group + 1]]
        errors = groups.errors[groups.edge_offsets[group] : groups.edge_offsets[group + 1]]
        local = sub_box(box, members)
        local_explained = np.empty((size, size))
        status = _combine_group(local, dimension, edges, errors, local_explained)
        if status == EMPTY:
            return False
        if status == LEFT_ALONE:
            continue
        for x in range(size):
            for y in range(size):
                if x != y:
                    explained[members[x], members[y]] = local_explained[x, y]
                    for plane in range(4):
                        box[plane, members[x], members[y]] = local[plane, x, y]
    return True


@kernel(borrows=True)
def _is_narrow(box: FloatArray, resolution_m: float) -> bool:
    """Tell whether every bounded distance is known to the resolution."""
    n_points = box.shape[1]
    for i in range(n_points):
        for j in range(i + 1, n_points):
            upper = box[UPPER, i, j]
            if upper < np.inf and math.sqrt(upper) - math.sqrt(box[LOWER, i, j]) > resolution_m:
                return False
    return True


@kernel(borrows=True)
def excess(
    box: FloatArray, explained: FloatArray, factor: float, resolution_m: float, i: int, j: int
) -> float:
    """Return how many times wider a range is than it has to be; nothing is asked of no bound."""
    low, high = box[LOWER, i, j], box[UPPER, i, j]
    if np.isinf(high):
        return 0.0
    if explained[i, j] > 0.0:
        middle_m = math.sqrt(0.5 * (low + high))
        return (high - low) / (factor * explained[i, j] + resolution_m * 2.0 * middle_m)
    return (math.sqrt(high) - math.sqrt(low)) / resolution_m


@kernel(borrows=True)
def _is_explained(
    box: FloatArray, explained: FloatArray, factor: float, resolution_m: float
) -> bool:
    """Tell whether no range is wider than it has to be."""
    n_points = box.shape[1]
    for i in range(n_points):
        for j in range(i + 1, n_points):
            if excess(box, explained, factor, resolution_m, i, j) > 1.0:
                return False
    return True


@kernel(borrows=True)
def widest_gap_m(box: FloatArray) -> float:
    """Return the width of the widest known gap in m."""
    n_points = box.shape[1]
    widest = 0.0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            high = box[GAP_UPPER, i, j]
            if high > box[GAP_LOWER, i, j]:
                widest = max(widest, math.sqrt(high) - math.sqrt(box[GAP_LOWER, i, j]))
    return widest


@kernel
def _rank_axes(work: Workspace, axes: IntArray, order: IntArray) -> None:
    """Order the axes by how well the distances to their two ends are known, best first."""
    box = work.boxes[0]
    n_points = box.shape[1]
    errors = np.empty((n_points, n_points))
    for i in range(n_points):
        # In one dimension an axis has the same point at both ends.
        for j in range(i, n_points):
            errors[i, j] = errors[j, i] = _relative_error(box, i, j)
    badness = np.empty(len(axes))
    for x in range(len(axes)):
        a, b = axes[x, 0], axes[x, 1]
        known = 0.0
        for i in range(n_points):
            if i != a and i != b:
                known += 1.0 / (0.01 + (errors[a, i] + errors[b, i]) + errors[a, b])
        badness[x] = -known
    # Stable, and so the same with and without numba.
    order[:] = np.argsort(badness, kind='mergesort')


@kernel(borrows=True)
def contract(
    box: FloatArray,
    work: Workspace,
    sides: Sides,
    axes: IntArray,
    groups: Groups,
    factor: float,
    resolution_m: float,
    max_sweeps: int,
    batch: int,
    most_axes: int,
) -> int:
    """
    Contract a box in place until nothing gains much; call again while it is UNFINISHED.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2.
    work : Workspace
        Scratch arrays, and how far the contraction of this box has come: `progress`, zero at
        first.
    sides : Sides
        The known sides.
    axes : ndarray of int, shape (k, 2)
        The axes to project along.
    groups : Groups
        The connected points and their measured pairs.
    factor : float
        Stop when no range is more than so many times wider than the measurement errors explain.
    resolution_m : float
        Stop when every distance is known to this many metres.
    max_sweeps : int
        Most sweeps over all axes.
    batch : int
        After how many axes linear combinations are tried.
    most_axes : int
        After how many axes to return, so that the caller can look at the clock.

    Returns
    -------
    int
        ``EMPTY`` when the box is proved to hold no placement, ``CONTRACTED``, or ``UNFINISHED``.

    Notes
    -----
    Three laws: the result lies inside the input; no solution of the input is lost; what is
    removed once stays removed. (Section 4, with the triangle inequalities of Section 5.1 first.)

    """
    dimension, _, n_points, _ = work.boxes.shape
    inner = work.boxes[0]
    copy_box(box, inner)
    progress = work.progress
    if progress[SWEEP] == 0 and progress[NEXT_AXIS] == 0:
        for point in range(n_points):
            work.points[0, point] = point
    status = UNFINISHED
    applied = 0
    while status == UNFINISHED and applied < most_axes:
        is_local = progress[SWEEP] == 0 and n_points > LOCAL_POINTS[dimension - 1]
        if progress[NEXT_AXIS] == 0:
            if progress[SWEEP] < 2 and not smooth_triangles(
                inner, work.distance, work.points[0], n_points
            ):
                status = EMPTY
                break
            _remember_widths(inner, work.widths, n_points)
            _rank_axes(work, axes, work.order)
        # The best axes of a first, local sweep are the measured pairs and what they soon reveal.
        end = min(len(axes), len(groups.edges)) if is_local else len(axes)
        full = (progress[NEXT_AXIS] // batch + 1) * batch
        last = min(full, progress[NEXT_AXIS] + most_axes - applied, end)
        for x in range(progress[NEXT_AXIS], last):
            axis = work.order[x]
            count = LOCAL_POINTS[dimension - 1] if is_local else n_points
            if not _apply_axis(work, sides, axes[axis, 0], axes[axis, 1], count):
                status = EMPTY
                break
        applied += last - progress[NEXT_AXIS]
        progress[NEXT_AXIS] = last
        if status == EMPTY:
            break
        if is_local and last == end:
            progress[NEXT_AXIS] = 0
            progress[SWEEP] += 1
        if is_local or last < min(full, end):
            continue
        if widest_gap_m(inner) > LEAST_GAP * resolution_m:
            # The two parts will be looked at one by one; until then they blur each other.
            if last >= min(end, AXES_BEFORE_SPLIT * n_points):
                status = CONTRACTED
        elif not combine(inner, dimension, groups, work.explained):
            status = EMPTY
        elif _is_narrow(inner, resolution_m) or _is_explained(
            inner, work.explained, factor, resolution_m
        ):
            status = CONTRACTED
        elif last == end:
            progress[NEXT_AXIS] = 0
            progress[SWEEP] += 1
            slow = _largest_gain(inner, work.widths, n_points) < LEAST_GAIN
            if slow or progress[SWEEP] >= max_sweeps:
                status = CONTRACTED
    copy_box(inner, box)
    return status
