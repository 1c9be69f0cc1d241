# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What one reading rules out of a box of relative poses: kernels.

The pose (x, y, z, yaw) of body B in the frame of body A, both level, puts the point b of B at
p + R(yaw) b. A reading relates it to the point a of A through w = p + R(yaw) b - a: its length is
a distance, its direction a ray, its third component a difference of height. All of these are
half-spaces of w, or are bounded by one within a box:

- |w| <= d: u.w <= d for every unit vector u;
- |w| >= d: within a box, w strays from u's line by T at most, and (u.w)^2 >= d^2 - T^2;
- w within an angle eta of a unit vector n: (sin(eta) n + cos(eta) t).w >= 0 for every unit vector
  t perpendicular to n (eta < pi/2). A ray that B measured is the same in B's frame.

To first order a half-space of w is one of (dx, dy, dz, dyaw) about the center of the box; what is
left of the rotation is bounded by its second and third derivative. Cutting the box with it is
sharp to second order, so few boxes have to be halved.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, sqrt_down, square_down, square_up, up
from dg_localization.pairs.half_spaces import (
    CENTER,
    COSINE,
    HALF,
    HIGH,
    LOW,
    RADIUS,
    RULED_OUT,
    SETTLED,
    SINE,
    SIZE,
    UNDECIDED,
    YAW,
    X,
    Y,
    Z,
    beyond_first_order,
    cut,
    limit,
    reach_of,
    spread,
    with_error,
)

# Columns of the table of readings; three each where components follow.
A, A_ERROR, B, B_ERROR = 0, 3, 6, 9
NEAREST, FARTHEST = 12, 13
RAY, ACROSS, UPRIGHT = 14, 17, 20
RAY_SINE, RAY_COSINE, OBSERVER = 23, 24, 25
LOWEST, HIGHEST = 26, 27
B_RADIUS, ERROR_RADIUS, TERMS = 28, 29, 30
COLUMNS = 31

NOBODY, BY_A, BY_B = 0.0, 1.0, 2.0
"""Who measured the ray of a reading."""

# Between these lengths a normalized vector has length 1 to within a few units, and nothing
# overflows. Longer ones say nothing.
_SHORTEST = 1e-140
_LONGEST = 1e140

# The vector w at the center of the box: itself, the part that turns with the yaw, its length, a
# bound of all absolute terms in it anywhere in the box, and how far it strays within the box.
W, TURNED, NORM, MAGNITUDE, BALL = 0, 3, 5, 6, 7
W_SIZE = 8


@kernel(inlined=True)
def _across(row: np.ndarray, cx: float, cy: float, cz: float) -> float:
    """Bound what the errors of the point of A add to c.w."""
    return abs(cx) * row[A_ERROR] + abs(cy) * row[A_ERROR + 1] + abs(cz) * row[A_ERROR + 2]


@kernel(inlined=True)
def _turning(row: np.ndarray, cx: float, cy: float, cz: float) -> float:
    """Bound what the errors of the point of B add to c.w, where c is in B's frame."""
    return abs(cx) * row[B_ERROR] + abs(cy) * row[B_ERROR + 1] + abs(cz) * row[B_ERROR + 2]


@kernel(inlined=True)
def _data_error(view: np.ndarray, row: np.ndarray, cx: float, cy: float, cz: float) -> float:
    """Bound what the errors of both points add to c.w anywhere in the box."""
    bx = view[COSINE] * cx + view[SINE] * cy
    by = view[COSINE] * cy - view[SINE] * cx
    drift = view[HALF + YAW] * (abs(cx) + abs(cy)) * (row[B_ERROR] + row[B_ERROR + 1])
    return _across(row, cx, cy, cz) + _turning(row, bx, by, cz) + drift


@kernel(inlined=True)
def _limit_from_a(
    faces: np.ndarray,
    smear: np.ndarray,
    box: np.ndarray,
    view: np.ndarray,
    row: np.ndarray,
    w: np.ndarray,
    cx: float,
    cy: float,
    cz: float,
    bound: float,
) -> int:
    """Cut off what violates c.w <= bound, c in A's frame."""
    value = cx * w[TURNED] + cy * w[TURNED + 1]
    slope = cy * w[TURNED] - cx * w[TURNED + 1]
    least = bound - (cx * w[W] + cy * w[W + 1] + cz * w[W + 2])
    least += _data_error(view, row, cx, cy, cz)
    room = least + beyond_first_order(view[HALF + YAW], value, slope)
    room = with_error(room, w[MAGNITUDE] + abs(bound))
    return limit(faces, smear, box, view, (cx, cy, cz, slope), room, least, w[BALL])


@kernel(inlined=True)
def _limit_from_b(
    faces: np.ndarray,
    smear: np.ndarray,
    box: np.ndarray,
    view: np.ndarray,
    row: np.ndarray,
    w: np.ndarray,
    bx: float,
    by: float,
    bz: float,
) -> int:
    """
    Cut off what violates c.v <= 0, where v = R(-yaw) (a - p) - b is the ray as B sees it.

    It is (R(yaw) c).(a - p) - c.b.
    """
    cx = view[COSINE] * bx - view[SINE] * by
    cy = view[SINE] * bx + view[COSINE] * by
    # a - p at the center.
    qx = w[TURNED] - w[W]
    qy = w[TURNED + 1] - w[W + 1]
    value = cx * qx + cy * qy
    slope = cx * qy - cy * qx
    half_yaw = view[HALF + YAW]
    least = cx * w[W] + cy * w[W + 1] + bz * w[W + 2]
    least += _across(row, cx, cy, bz) + _turning(row, bx, by, bz)
    drift = view[HALF + X] + view[HALF + Y] + row[A_ERROR] + row[A_ERROR + 1]
    drift *= half_yaw * (abs(bx) + abs(by))
    room = least + drift + beyond_first_order(half_yaw, value, slope)
    room = with_error(room, w[MAGNITUDE])
    return limit(faces, smear, box, view, (-cx, -cy, -bz, slope), room, least, w[BALL])


@kernel(inlined=True)
def _cut_distance(
    faces: np.ndarray,
    smear: np.ndarray,
    box: np.ndarray,
    view: np.ndarray,
    row: np.ndarray,
    w: np.ndarray,
) -> int:
    """Cut off where the distance of the two points is not the measured one."""
    norm, ball, nearest, farthest = w[NORM], w[BALL], row[NEAREST], row[FARTHEST]
    ux, uy, uz = 1.0, 0.0, 0.0
    aligned = _SHORTEST < norm < _LONGEST
    if aligned:
        inverse = 1.0 / norm
        ux, uy, uz = w[W] * inverse, w[W + 1] * inverse, w[W + 2] * inverse
    data = _data_error(view, row, ux, uy, uz)
    if norm + ball <= farthest + data and norm - ball >= nearest - data:
        return SETTLED
    value = ux * w[TURNED] + uy * w[TURNED + 1]
    slope = uy * w[TURNED] - ux * w[TURNED + 1]
    if ball < norm:
        spread(smear, view, ux, uy, uz, slope)
    else:
        spread(smear, view, 1.0, 1.0, 1.0, row[B_RADIUS])
    along = ux * w[W] + uy * w[W + 1] + uz * w[W + 2]
    reach = reach_of(view, ux, uy, uz, slope)
    below = data + beyond_first_order(view[HALF + YAW], value, slope)
    if farthest < math.inf:
        room = with_error(farthest - along + below, w[MAGNITUDE] + farthest)
        if cut(faces, box, view, reach, ux, uy, uz, slope, room):
            return RULED_OUT
    stray = with_error(ball + row[ERROR_RADIUS], w[MAGNITUDE])
    if aligned and nearest > stray:
        least = sqrt_down(down(square_down(nearest) - square_up(stray)))
        if with_error(reach + below - along, w[MAGNITUDE] + reach) < least:
            above = data + beyond_first_order(view[HALF + YAW], -value, slope)
            room = with_error(along - least + above, w[MAGNITUDE] + nearest)
            if cut(faces, box, view, reach, -ux, -uy, -uz, -slope, room):
                return RULED_OUT
    return UNDECIDED


@kernel(inlined=True)
def _cut_ray(
    faces: np.ndarray,
    smear: np.ndarray,
    box: np.ndarray,
    view: np.ndarray,
    row: np.ndarray,
    w: np.ndarray,
) -> int:
    """Cut off where the other point is not within the cone about the measured ray."""
    by_a = row[OBSERVER] == BY_A
    vx, vy, vz = w[W], w[W + 1], w[W + 2]
    if not by_a:
        vx, vy = -view[COSINE] * vx - view[SINE] * vy, view[SINE] * vx - view[COSINE] * vy
        vz = -vz
    a = vx * row[ACROSS] + vy * row[ACROSS + 1] + vz * row[ACROSS + 2]
    b = vx * row[UPRIGHT] + vy * row[UPRIGHT + 1] + vz * row[UPRIGHT + 2]
    if b == 0.0:
        a = 1.0
    else:
        norm = math.sqrt(a * a + b * b)
        if _SHORTEST < norm < _LONGEST:
            a, b = a / norm, b / norm
        else:
            a, b = 1.0, 0.0
    # In the plane a cone has two sides.
    sides = 2 if b == 0.0 and view[HALF + Z] == 0.0 else 4
    result = SETTLED
    for _side in range(sides):
        cx = row[RAY_COSINE] * (a * row[ACROSS] + b * row[UPRIGHT]) - row[RAY_SINE] * row[RAY]
        cy = row[RAY_COSINE] * (a * row[ACROSS + 1] + b * row[UPRIGHT + 1])
        cy -= row[RAY_SINE] * row[RAY + 1]
        cz = row[RAY_COSINE] * (a * row[ACROSS + 2] + b * row[UPRIGHT + 2])
        cz -= row[RAY_SINE] * row[RAY + 2]
        if by_a:
            state = _limit_from_a(faces, smear, box, view, row, w, cx, cy, cz, 0.0)
        else:
            state = _limit_from_b(faces, smear, box, view, row, w, cx, cy, cz)
        if state == RULED_OUT:
            return RULED_OUT
        if state == UNDECIDED:
            result = UNDECIDED
        if sides == 2:
            a, b = -a, -b
        else:
            a, b = -b, a
    return result


@kernel(inlined=True)
def _cut_height(
    faces: np.ndarray,
    smear: np.ndarray,
    box: np.ndarray,
    view: np.ndarray,
    row: np.ndarray,
    w: np.ndarray,
) -> int:
    """Cut off where the point of B is not as far above that of A as measured."""
    low, high = -row[LOWEST], row[HIGHEST]
    first = _limit_from_a(faces, smear, box, view, row, w, 0.0, 0.0, 1.0, high)
    second = _limit_from_a(faces, smear, box, view, row, w, 0.0, 0.0, -1.0, low)
    if first == RULED_OUT or second == RULED_OUT:
        return RULED_OUT
    return SETTLED if first == SETTLED and second == SETTLED else UNDECIDED


@kernel(inlined=True)
def _place(view: np.ndarray, row: np.ndarray, w: np.ndarray) -> None:
    """Write the vector w at the center of the box, and what goes with it."""
    bx = view[COSINE] * row[B] - view[SINE] * row[B + 1]
    by = view[SINE] * row[B] + view[COSINE] * row[B + 1]
    w[W] = view[CENTER + X] + bx - row[A]
    w[W + 1] = view[CENTER + Y] + by - row[A + 1]
    w[W + 2] = view[CENTER + Z] + row[B + 2] - row[A + 2]
    w[TURNED], w[TURNED + 1] = bx, by
    w[NORM] = math.sqrt(w[W] * w[W] + w[W + 1] * w[W + 1] + w[W + 2] * w[W + 2])
    w[MAGNITUDE] = view[SIZE] + view[RADIUS] + row[TERMS]
    w[BALL] = up(view[RADIUS] + up(row[B_RADIUS] * view[HALF + YAW]))


@kernel(borrows=True)
def cut_box(
    faces: np.ndarray,
    smear: np.ndarray,
    w: np.ndarray,
    box: np.ndarray,
    view: np.ndarray,
    row: np.ndarray,
) -> int:
    """
    Find what one reading leaves of a box.

    Parameters
    ----------
    faces : numpy.ndarray, shape (2, 4)
        Receives the lower and upper faces of what is left.
    smear : numpy.ndarray, shape (4,)
        Raised to how much the reading changes along each axis of the box, in m.
    w : numpy.ndarray, shape (W_SIZE,)
        Room to work in.
    box : numpy.ndarray, shape (2, 4)
    view : numpy.ndarray, shape (VIEW,)
        The box as `view_box` writes it.
    row : numpy.ndarray, shape (COLUMNS,)
        The reading.

    Returns
    -------
    int
        UNDECIDED, SETTLED or RULED_OUT.

    """
    for axis in range(4):
        faces[LOW, axis], faces[HIGH, axis] = box[LOW, axis], box[HIGH, axis]
    _place(view, row, w)
    if not w[MAGNITUDE] < _LONGEST:
        return UNDECIDED
    result = SETTLED
    if row[NEAREST] > 0.0 or row[FARTHEST] < math.inf:
        result = _cut_distance(faces, smear, box, view, row, w)
    if row[OBSERVER] != NOBODY and result != RULED_OUT:
        state = _cut_ray(faces, smear, box, view, row, w)
        result = state if state != SETTLED else result
    if result != RULED_OUT and (row[LOWEST] > -math.inf or row[HIGHEST] < math.inf):
        state = _cut_height(faces, smear, box, view, row, w)
        result = state if state != SETTLED else result
    for axis in range(4):
        if faces[LOW, axis] > faces[HIGH, axis]:
            return RULED_OUT
    return result
