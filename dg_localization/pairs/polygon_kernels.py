# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Kernels of `counted`: convex polygons of places, one for each slice of yaws.

A polygon holds every p with u_j.p <= h_j, where u_j are the directions below and h_j its supports.
Supports are tight: each is reached by a point of the polygon, but for rounding. A half-space
c.p <= b leaves those where u_j is a sum of c and another direction, with weights that are not
negative: u_j = s c + t u_i gives u_j.p <= s b + t h_i.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, sqrt_down, square_down, square_up, up
from dg_localization.pairs.cuts import (
    A_ERROR,
    ACROSS,
    B_ERROR,
    BY_B,
    FARTHEST,
    NEAREST,
    NOBODY,
    OBSERVER,
    RAY,
    RAY_COSINE,
    RAY_SINE,
    TERMS,
    A,
    B,
)
from dg_localization.pairs.half_spaces import X, Y, with_error

SIDES = 24
"""Of a polygon; divisible by four."""

_TURNS = np.arange(SIDES) * (2.0 * math.pi / SIDES)
DIRECTIONS = np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=-1)
"""Any vectors would do. Those along the axes are exact, so that supports bound coordinates."""
DIRECTIONS[:: SIDES // 4] = np.round(DIRECTIONS[:: SIDES // 4])

_FLATTEST = 1e-3
"""Directions that are closer to parallel than this do not make a bound together."""

_LONGEST = 1e100

# Of a slice: cosine and sine of its middle, half of its width.
COSINE, SINE, HALF_YAW = 0, 1, 2


@kernel(borrows=True)
def _size(h: np.ndarray) -> float:
    """Return an upper bound of the lengths of the points of a polygon."""
    quarter = SIDES // 4
    size = 0.0
    for j in range(0, SIDES, quarter):
        size = max(size, abs(h[j]))
    return 2.0 * size


@kernel(borrows=True)
def _support(h: np.ndarray, cx: float, cy: float, size: float) -> float:
    """Return an upper bound of c.p over a polygon, |c| about 1: c is between two directions."""
    turn = math.atan2(cy, cx) * (SIDES / (2.0 * math.pi))
    first = math.floor(turn)
    i, k = int(first) % SIDES, int(first + 1.0) % SIDES
    ix, iy, kx, ky = DIRECTIONS[i, X], DIRECTIONS[i, Y], DIRECTIONS[k, X], DIRECTIONS[k, Y]
    area = ix * ky - iy * kx
    s = max(0.0, (cx * ky - cy * kx) / area)
    t = max(0.0, (ix * cy - iy * cx) / area)
    return with_error(s * h[i] + t * h[k], 8.0 * size)


@kernel(borrows=True)
def _clip(h: np.ndarray, cx: float, cy: float, room: float, size: float, work: np.ndarray) -> bool:
    """Leave of a polygon what has c.p <= room; return whether that is anything."""
    if room >= _support(h, cx, cy, size):
        return True
    if -_support(h, -cx, -cy, size) > room:
        return False
    # Bounds are made of the supports before: all of these hold.
    before, across = work[0], work[1]
    for j in range(SIDES):
        before[j] = h[j]
        across[j] = cx * DIRECTIONS[j, Y] - cy * DIRECTIONS[j, X]
    for j in range(SIDES):
        way = 1 if across[j] >= 0.0 else -1
        i = j
        for _ in range(SIDES // 2):
            i = (i + way) % SIDES
            area = way * across[i]
            if area < _FLATTEST:
                if area < 0.0:
                    break
                continue
            ahead = DIRECTIONS[j, X] * DIRECTIONS[i, Y] - DIRECTIONS[j, Y] * DIRECTIONS[i, X]
            s, t = max(0.0, way * ahead / area), max(0.0, way * across[j] / area)
            bound = with_error(s * room + t * before[i], (1.0 + s + t) / area * (size + abs(room)))
            h[j] = min(h[j], bound)
    return True


@kernel(borrows=True)
def _room(
    row: np.ndarray, view: np.ndarray, cx: float, cy: float, bound: float, size: float
) -> float:
    """
    Return b such that c.w <= bound allows c.p <= b only, w = p + R(yaw) b - a.

    For all yaws of the slice, whatever the errors of both points.
    """
    cosine, sine, half = view[COSINE], view[SINE], view[HALF_YAW]
    bx, by = cosine * row[B] - sine * row[B + 1], sine * row[B] + cosine * row[B + 1]
    value, slope = cx * bx + cy * by, cy * bx - cx * by
    least = value - abs(slope) * half - 0.5 * half * half * max(value, 0.0)
    error = abs(cx) * row[A_ERROR] + abs(cy) * row[A_ERROR + 1]
    error += abs(cosine * cx + sine * cy) * row[B_ERROR]
    error += abs(cosine * cy - sine * cx) * row[B_ERROR + 1]
    error += half * (abs(cx) + abs(cy)) * (row[B_ERROR] + row[B_ERROR + 1])
    room = bound + cx * row[A] + cy * row[A + 1] - least + error
    return with_error(room, (2.0 + half) * (1.0 + half) * row[TERMS] + abs(bound) + size)


@kernel(borrows=True)
def _reach(
    h: np.ndarray, row: np.ndarray, view: np.ndarray, cx: float, cy: float, size: float
) -> float:
    """Return an upper bound of c.w over a polygon and all yaws of the slice."""
    return up(_support(h, cx, cy, size) + _room(row, view, -cx, -cy, 0.0, size))


@kernel(borrows=True)
def _cut_ray(
    h: np.ndarray, row: np.ndarray, view: np.ndarray, size: float, work: np.ndarray
) -> bool:
    """Leave of a polygon the places from which, or of which, the ray can be."""
    rx, ry, tx, ty = row[RAY], row[RAY + 1], row[ACROSS], row[ACROSS + 1]
    s, c, sign = row[RAY_SINE], row[RAY_COSINE], 1.0
    if row[OBSERVER] == BY_B:
        # In the frame of A it is turned by any yaw of the slice, and points the other way.
        sign = -1.0
        cosine, sine, half = view[COSINE], view[SINE], view[HALF_YAW]
        rx, ry = cosine * rx - sine * ry, sine * rx + cosine * ry
        tx, ty = cosine * tx - sine * ty, sine * tx + cosine * ty
        if half > 0.5:
            return True
        s, c = s * math.cos(half) + c * math.sin(half), c * math.cos(half) - s * math.sin(half)
        if c < _FLATTEST:
            return True
    for side in range(2):
        t = c if side == 0 else -c
        cx, cy = sign * (t * tx - s * rx), sign * (t * ty - s * ry)
        if not _clip(h, cx, cy, _room(row, view, cx, cy, 0.0, size), size, work):
            return False
    return True


@kernel(borrows=True)
def _cut_far(
    h: np.ndarray, row: np.ndarray, view: np.ndarray, size: float, work: np.ndarray
) -> bool:
    """Leave of a polygon what is within the greatest distance."""
    for j in range(SIDES):
        cx, cy = DIRECTIONS[j, X], DIRECTIONS[j, Y]
        if not _clip(h, cx, cy, _room(row, view, cx, cy, row[FARTHEST], size), size, work):
            return False
    return True


@kernel(borrows=True)
def _cut_near(
    h: np.ndarray, row: np.ndarray, view: np.ndarray, size: float, work: np.ndarray
) -> bool:
    """
    Leave of a polygon what is beyond a chord of the least distance.

    Where w strays from the line of a unit vector u by T at most, (u.w)^2 >= d^2 - T^2.
    """
    quarter = SIDES // 4
    wx = 0.5 * (h[0] - h[2 * quarter]) - row[A]
    wy = 0.5 * (h[quarter] - h[3 * quarter]) - row[A + 1]
    wx += view[COSINE] * row[B] - view[SINE] * row[B + 1]
    wy += view[SINE] * row[B] + view[COSINE] * row[B + 1]
    norm = math.sqrt(wx * wx + wy * wy)
    if not 1e-100 < norm < _LONGEST:
        return True
    ux, uy = wx / norm, wy / norm
    stray = max(_reach(h, row, view, -uy, ux, size), _reach(h, row, view, uy, -ux, size))
    if not stray < row[NEAREST]:
        return True
    least = sqrt_down(down(square_down(row[NEAREST]) - square_up(max(stray, 0.0))))
    if not _reach(h, row, view, -ux, -uy, size) < least:
        return True
    return _clip(h, -ux, -uy, _room(row, view, -ux, -uy, -least, size), size, work)


@kernel(borrows=True)
def _cut_polygon(h: np.ndarray, row: np.ndarray, view: np.ndarray, work: np.ndarray) -> bool:
    """Leave of a polygon what a reading allows; return whether that is anything."""
    size = _size(h)
    if not size + row[TERMS] < _LONGEST:
        return True
    if row[OBSERVER] != NOBODY and not _cut_ray(h, row, view, size, work):
        return False
    if row[FARTHEST] < _LONGEST and not _cut_far(h, row, view, size, work):
        return False
    return not row[NEAREST] > 0.0 or _cut_near(h, row, view, size, work)


@kernel(borrows=True)
def _is_empty(h: np.ndarray) -> bool:
    """Return whether a polygon is known to have no places."""
    return h[0] == -math.inf


@kernel(borrows=True)
def _is_same(h: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two polygons are the same."""
    for j in range(SIDES):
        if h[j] != other[j]:
            return False
    return True


@kernel
def cut_slices(
    supports: np.ndarray, yaws: np.ndarray, table: np.ndarray, kept: np.ndarray
) -> None:
    """
    Cut the polygons of slices by readings, each of which may be broken at the cost of a level.

    Parameters
    ----------
    supports : numpy.ndarray, shape (n, k + 1, SIDES)
        Level j holds the places of the slice that broke j readings at most.
    yaws : numpy.ndarray, shape (n, 2)
        Middle and half of the yaws of each slice.
    table : numpy.ndarray, shape (m, COLUMNS)
    kept : numpy.ndarray, shape (n, k + 1, SIDES)
        Receives what is left; -inf in all directions where that is nothing.

    """
    view, h, work = np.empty(3), np.empty(SIDES), np.empty((2, SIDES))
    last = supports.shape[1] - 1
    for number in range(supports.shape[0]):
        levels = kept[number]
        levels[:] = supports[number]
        view[COSINE], view[SINE] = math.cos(yaws[number, 0]), math.sin(yaws[number, 0])
        view[HALF_YAW] = yaws[number, 1]
        for reading in range(table.shape[0]):
            if _is_empty(levels[last]):
                break
            for level in range(last, -1, -1):
                if _is_empty(levels[level]):
                    break
                if level > 0 and _is_same(levels[level], levels[level - 1]):
                    continue
                h[:] = levels[level]
                if not _cut_polygon(h, table[reading], view, work):
                    h[:] = -math.inf
                for j in range(SIDES):
                    before = levels[level - 1, j] if level > 0 else -math.inf
                    levels[level, j] = max(h[j], before)


@kernel
def move_slices(
    supports: np.ndarray, yaws: np.ndarray, step: np.ndarray, ball: float, moved: np.ndarray
) -> None:
    """
    Move the polygons of slices by a step in the frame of the body.

    Parameters
    ----------
    supports : numpy.ndarray, shape (n, k + 1, SIDES)
    yaws : numpy.ndarray, shape (n, 2)
        Middle and half of the yaws of each slice, before the step.
    step : numpy.ndarray, shape (2, 2)
        Middles and half-widths of the step along x and y.
    ball : float
        How far it may lead from that, in any direction.
    moved : numpy.ndarray, shape (n, k + 1, SIDES)
        Receives the polygons after the step.

    """
    dx, dy, wide = step[0, X], step[0, Y], step[1, X] + step[1, Y]
    length = abs(dx) + abs(dy)
    for number in range(supports.shape[0]):
        c, s, half = math.cos(yaws[number, 0]), math.sin(yaws[number, 0]), yaws[number, 1]
        x, y = c * dx - s * dy, s * dx + c * dy
        for j in range(SIDES):
            cx, cy = DIRECTIONS[j, X], DIRECTIONS[j, Y]
            value, slope = cx * x + cy * y, cy * x - cx * y
            way = value + abs(slope) * half + 0.5 * half * half * max(-value, 0.0)
            way = min(way, 1.5 * length)
            way += abs(c * cx + s * cy) * step[1, X] + abs(c * cy - s * cx) * step[1, Y]
            way += min(half, 2.0) * wide * 1.5 + ball
            for level in range(supports.shape[1]):
                h = supports[number, level, j]
                if h == -math.inf:
                    moved[number, level, j] = h
                    continue
                moved[number, level, j] = with_error(
                    h + way, abs(h) + (1.0 + half) * (2.0 + half) * (length + wide) + ball
                )


@kernel
def join_slices(
    supports: np.ndarray, sources: np.ndarray, targets: np.ndarray, hulls: np.ndarray
) -> None:
    """
    Widen the polygons of slices by those of others.

    Parameters
    ----------
    supports : numpy.ndarray, shape (n, k + 1, SIDES)
    sources, targets : numpy.ndarray of int, shape (m,)
        Slice `sources` of `supports` widens slice `targets` of `hulls`.
    hulls : numpy.ndarray, shape (l, k + 1, SIDES)

    """
    for number in range(sources.shape[0]):
        source, target = sources[number], targets[number]
        for level in range(supports.shape[1]):
            for j in range(SIDES):
                hulls[target, level, j] = max(hulls[target, level, j], supports[source, level, j])
