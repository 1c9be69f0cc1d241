# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Cuts of a box of poses by one reading: kernels.

The pose (p, yaw) of a body puts its point a at p + R(yaw) a. A reading relates the point a of
body A to the point b of body B by w, the way from the first to the second: its length is a
distance, its direction a ray. Both are half-spaces of w, or bounded by one within a box:

- |w| <= d: u.w <= d for every unit vector u;
- |w| >= d: within a box, w strays from u's line by T at most, and (u.w)^2 >= d^2 - T^2;
- |w| - |r| within bounds, with r the way to another point on the body of w's end: |w| is at least
  u.w, and at most T^2 / (2 |w|) more for the direction u of w from which it strays by T;
- w within an angle eta of a unit vector n: (sin(eta) n + cos(eta) t).w >= 0 for every unit vector
  t perpendicular to n (eta < pi/2), where n and t turn with the body that measured the ray.

To first order a half-space of w is a half-space of the poses about the center of the box; the
remainder of the rotations is bounded by their second and third derivatives. Such a cut is sharp to
second order, so few boxes must be halved.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, sqrt_down, square_down, square_up, up
from dg_localization.poses.half_spaces import (
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
    Bodies,
    Scratch,
    Slopes,
    X,
    Y,
    Z,
    beyond_first_order,
    cut,
    reach_of,
    spread,
    with_error,
)

# Columns of the table of readings; three each where components follow.
A, A_ERROR, B, B_ERROR = 0, 3, 6, 9
NEAREST, FARTHEST = 12, 13
RAY, ACROSS, UPRIGHT = 14, 17, 20
RAY_SINE, RAY_COSINE, OBSERVER = 23, 24, 25
A_RADIUS, B_RADIUS, ERROR_RADIUS, TERMS = 26, 27, 28, 29
A_BODY, B_BODY, GROUP = 30, 31, 32
REFERENCE, REFERENCE_ERROR = 33, 36
LEAST, MOST, HEARD_BY = 39, 40, 41
REFERENCE_RADIUS, REFERENCE_ERROR_RADIUS = 42, 43
COLUMNS = 44

NO_RAY, BY_A, BY_B = 0.0, 1.0, 2.0
"""The observer of the ray of a reading, or of the difference of two distances."""

# Between these lengths a normalized vector has length 1 to within a few units, and nothing
# overflows. Longer vectors bound nothing.
STEEP = 1e-3
"""A direction whose level part is below this has no direction across it in the plane."""

_SHORTEST = 1e-140
LONGEST = 1e140

# The vector w at the center of the box: itself, its parts that turn with the two bodies, its
# length, a bound of its absolute terms anywhere in the box, and of its deviation there.
W, TURNED_A, TURNED_B, NORM, MAGNITUDE, BALL = 0, 3, 5, 7, 8, 9
W_SIZE = 10


@kernel(inlined=True)
def _error_along(
    body: np.ndarray, row: np.ndarray, error: int, cx: float, cy: float, cz: float
) -> float:
    """Bound the contribution of the error of a point of a body to c.w anywhere in the box."""
    along_x = body[COSINE] * cx + body[SINE] * cy
    along_y = body[COSINE] * cy - body[SINE] * cx
    drift = body[HALF + YAW] * (abs(cx) + abs(cy)) * (row[error] + row[error + 1])
    return (
        abs(along_x) * row[error]
        + abs(along_y) * row[error + 1]
        + abs(cz) * row[error + 2]
        + drift
    )


@kernel(inlined=True)
def _stray(
    view: np.ndarray, bodies: Bodies, w: np.ndarray, ux: float, uy: float, uz: float
) -> float:
    """
    Bound the distance of w within the box from the line along the unit vector u.

    It has a level part across u, and a part in the vertical plane of u.
    """
    a, b = view[bodies[0]], view[bodies[1]]
    level = math.sqrt(ux * ux + uy * uy)
    if level < STEEP:
        return w[BALL]
    ex, ey = -uy / level, ux / level
    across = abs(ex) * (a[HALF + X] + b[HALF + X]) + abs(ey) * (a[HALF + Y] + b[HALF + Y])
    for body, at in ((a, TURNED_A), (b, TURNED_B)):
        value, slope = abs(ex * w[at] + ey * w[at + 1]), abs(ex * w[at + 1] - ey * w[at])
        across += slope * body[HALF + YAW] + beyond_first_order(body[HALF + YAW], value, slope)
    upright = abs(uz) * w[BALL] + level * (a[HALF + Z] + b[HALF + Z])
    return min(w[BALL], math.sqrt(across * across + upright * upright))


@kernel(inlined=True)
def distance_half_spaces(
    view: np.ndarray, bodies: Bodies, row: np.ndarray, w: np.ndarray
) -> tuple[bool, Slopes, float, float, float]:
    """
    Return whether a distance is within its bounds all over a box, and half-spaces that bound it.

    These are their slopes and reach, and the room of the upper bound and, with reversed slopes, of
    the lower bound of the distance; infinite where it bounds nothing.
    """
    a, b = bodies
    norm, ball, nearest, farthest = w[NORM], w[BALL], row[NEAREST], row[FARTHEST]
    ux, uy, uz = 1.0, 0.0, 0.0
    aligned = _SHORTEST < norm < LONGEST
    if aligned:
        inverse = 1.0 / norm
        ux, uy, uz = w[W] * inverse, w[W + 1] * inverse, w[W + 2] * inverse
    value_a = -ux * w[TURNED_A] - uy * w[TURNED_A + 1]
    slope_a = ux * w[TURNED_A + 1] - uy * w[TURNED_A]
    value_b = ux * w[TURNED_B] + uy * w[TURNED_B + 1]
    slope_b = uy * w[TURNED_B] - ux * w[TURNED_B + 1]
    slopes = (ux, uy, uz, slope_a, slope_b)
    data = _error_along(view[a], row, A_ERROR, ux, uy, uz)
    data += _error_along(view[b], row, B_ERROR, ux, uy, uz)
    if norm + ball <= farthest + data and norm - ball >= nearest - data:
        return True, slopes, 0.0, math.inf, math.inf
    half_a, half_b = view[a, HALF + YAW], view[b, HALF + YAW]
    along = ux * w[W] + uy * w[W + 1] + uz * w[W + 2]
    reach = reach_of(view, bodies, slopes)
    below = data + beyond_first_order(half_a, value_a, slope_a)
    below += beyond_first_order(half_b, value_b, slope_b)
    far = near = math.inf
    if farthest < math.inf:
        far = with_error(farthest - along + below, w[MAGNITUDE] + farthest)
    stray = math.inf
    if aligned and norm - ball < nearest - data:
        stray = _stray(view, bodies, w, ux, uy, uz)
        stray = with_error(stray + row[ERROR_RADIUS], w[MAGNITUDE])
    if nearest > stray:
        least = sqrt_down(down(square_down(nearest) - square_up(stray)))
        if with_error(reach + below - along, w[MAGNITUDE] + reach) < least:
            above = data + beyond_first_order(half_a, -value_a, slope_a)
            above += beyond_first_order(half_b, -value_b, slope_b)
            near = with_error(along - least + above, w[MAGNITUDE] + nearest)
    return False, slopes, reach, far, near


@kernel(inlined=True)
def _cut_distance(scratch: Scratch, box: np.ndarray, bodies: Bodies, row: np.ndarray) -> int:
    """Cut off the poses whose distance of the two points is outside its bounds."""
    w = scratch.w
    settled, slopes, reach, far, near = distance_half_spaces(scratch.views, bodies, row, w)
    if settled:
        return SETTLED
    if w[BALL] < w[NORM]:
        spread(scratch, bodies, slopes)
    else:
        spread(scratch, bodies, (1.0, 1.0, 1.0, row[A_RADIUS], row[B_RADIUS]))
    x, y, z, slope_a, slope_b = slopes
    if cut(scratch, box, bodies, reach, slopes, far):
        return RULED_OUT
    if cut(scratch, box, bodies, reach, (-x, -y, -z, -slope_a, -slope_b), near):
        return RULED_OUT
    return UNDECIDED


@kernel(inlined=True)
def _cut_side(
    scratch: Scratch,
    box: np.ndarray,
    bodies: Bodies,
    row: np.ndarray,
    cx: float,
    cy: float,
    cz: float,
) -> int:
    """
    Cut off the poses that violate c.v <= 0, where v is the target in the frame of the observer.

    With the origin o and the yaw of the observer it is (R(yaw) c).(target - o) - c.sensor: both
    factors of the product move. Their changes multiplied are bounded by `drift`.
    """
    view, w = scratch.views, scratch.w
    by_a = row[OBSERVER] == BY_A
    observer, target = bodies if by_a else (bodies[1], bodies[0])
    sign = 1.0 if by_a else -1.0
    turned_observer, turned_target = (TURNED_A, TURNED_B) if by_a else (TURNED_B, TURNED_A)
    error_observer, error_target = (A_ERROR, B_ERROR) if by_a else (B_ERROR, A_ERROR)
    cosine, sine = view[observer, COSINE], view[observer, SINE]
    x, y = cosine * cx - sine * cy, sine * cx + cosine * cy
    half_observer, half_target = view[observer, HALF + YAW], view[target, HALF + YAW]
    to_x = sign * w[W] + w[turned_observer]
    to_y = sign * w[W + 1] + w[turned_observer + 1]
    value_observer, slope_observer = x * to_x + y * to_y, x * to_y - y * to_x
    target_x, target_y = w[turned_target], w[turned_target + 1]
    value_target, slope_target = x * target_x + y * target_y, y * target_x - x * target_y
    least = -sign * (x * w[W] + y * w[W + 1] + cz * w[W + 2])
    least += _error_along(view[target], row, error_target, x, y, cz)
    least += abs(cx) * row[error_observer] + abs(cy) * row[error_observer + 1]
    least += abs(cz) * row[error_observer + 2]
    drift = view[target, HALF + X] + view[target, HALF + Y]
    drift += view[observer, HALF + X] + view[observer, HALF + Y]
    drift += row[error_target] + row[error_target + 1]
    drift += half_target * (abs(target_x) + abs(target_y))
    slack = drift * half_observer * (abs(cx) + abs(cy))
    slack += beyond_first_order(half_observer, value_observer, slope_observer)
    slack += beyond_first_order(half_target, value_target, slope_target)
    if by_a:
        slopes = (x, y, cz, slope_observer, slope_target)
    else:
        slopes = (-x, -y, -cz, slope_target, slope_observer)
    reach = reach_of(view, bodies, slopes)
    if least - slack >= reach:
        return SETTLED
    spread(scratch, bodies, slopes)
    if cut(scratch, box, bodies, reach, slopes, with_error(least + slack, w[MAGNITUDE])):
        return RULED_OUT
    return UNDECIDED


@kernel(inlined=True)
def _cut_ray(scratch: Scratch, box: np.ndarray, bodies: Bodies, row: np.ndarray) -> int:
    """Cut off the poses whose target is outside the cone about the measured ray."""
    view, w = scratch.views, scratch.w
    by_a = row[OBSERVER] == BY_A
    observer = bodies[0] if by_a else bodies[1]
    sign = 1.0 if by_a else -1.0
    cosine, sine = sign * view[observer, COSINE], sign * view[observer, SINE]
    vx, vy = cosine * w[W] + sine * w[W + 1], cosine * w[W + 1] - sine * w[W]
    vz = sign * w[W + 2]
    a = vx * row[ACROSS] + vy * row[ACROSS + 1] + vz * row[ACROSS + 2]
    b = vx * row[UPRIGHT] + vy * row[UPRIGHT + 1] + vz * row[UPRIGHT + 2]
    if b == 0.0:
        a = 1.0
    else:
        norm = math.sqrt(a * a + b * b)
        if _SHORTEST < norm < LONGEST:
            a, b = a / norm, b / norm
        else:
            a, b = 1.0, 0.0
    # In the plane a cone has two sides.
    flat = view[bodies[0], HALF + Z] == 0.0 and view[bodies[1], HALF + Z] == 0.0
    sides = 2 if b == 0.0 and flat else 4
    result = SETTLED
    for _side in range(sides):
        cx = row[RAY_COSINE] * (a * row[ACROSS] + b * row[UPRIGHT]) - row[RAY_SINE] * row[RAY]
        cy = row[RAY_COSINE] * (a * row[ACROSS + 1] + b * row[UPRIGHT + 1])
        cy -= row[RAY_SINE] * row[RAY + 1]
        cz = row[RAY_COSINE] * (a * row[ACROSS + 2] + b * row[UPRIGHT + 2])
        cz -= row[RAY_SINE] * row[RAY + 2]
        state = _cut_side(scratch, box, bodies, row, cx, cy, cz)
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
def _bent(norm: float, stray: float) -> float:
    """Bound |v| - u.v, where v deviates by `stray` from u times `norm`."""
    if stray < 2.0 * norm:
        return up(up(square_up(stray) / norm) * 0.5)
    return 2.0 * stray


@kernel(inlined=True)
def _cut_difference(scratch: Scratch, box: np.ndarray, bodies: Bodies, row: np.ndarray) -> int:
    """
    Cut off the poses whose difference of two distances is outside its bounds.

    With unit vectors u and v to the target and to the reference at the center of the box, it is
    u.(vector to the target) - v.(vector to the reference), up to `_bent`.
    """
    view, w = scratch.views, scratch.w
    by_a = row[HEARD_BY] == BY_A
    observer, far = bodies if by_a else (bodies[1], bodies[0])
    sign = 1.0 if by_a else -1.0
    turned_observer, turned_target = (TURNED_A, TURNED_B) if by_a else (TURNED_B, TURNED_A)
    error_observer, error_target = (A_ERROR, B_ERROR) if by_a else (B_ERROR, A_ERROR)
    target, radius = (B, A_RADIUS) if by_a else (A, B_RADIUS)
    cosine, sine = view[far, COSINE], view[far, SINE]
    x = cosine * row[REFERENCE] - sine * row[REFERENCE + 1]
    y = sine * row[REFERENCE] + cosine * row[REFERENCE + 1]
    vx = sign * w[W] + x - w[turned_target]
    vy = sign * w[W + 1] + y - w[turned_target + 1]
    vz = sign * w[W + 2] + row[REFERENCE + 2] - row[target + 2]
    norm, reference = w[NORM], math.sqrt(vx * vx + vy * vy + vz * vz)
    if not (_SHORTEST < norm < LONGEST and _SHORTEST < reference < LONGEST):
        spread(scratch, bodies, (1.0, 1.0, 1.0, row[A_RADIUS], row[B_RADIUS]))
        return UNDECIDED
    ux, uy, uz = sign * w[W] / norm, sign * w[W + 1] / norm, sign * w[W + 2] / norm
    vx, vy, vz = vx / reference, vy / reference, vz / reference
    cx, cy, cz = ux - vx, uy - vy, uz - vz
    half_observer, half_far = view[observer, HALF + YAW], view[far, HALF + YAW]
    value_observer = -cx * w[turned_observer] - cy * w[turned_observer + 1]
    slope_observer = cx * w[turned_observer + 1] - cy * w[turned_observer]
    value_far = ux * w[turned_target] + uy * w[turned_target + 1] - vx * x - vy * y
    slope_far = uy * w[turned_target] - ux * w[turned_target + 1] - vy * x + vx * y
    if by_a:
        slopes = (cx, cy, cz, slope_observer, slope_far)
    else:
        slopes = (-cx, -cy, -cz, slope_far, slope_observer)
    reach = reach_of(view, bodies, slopes)
    data = _error_along(view[observer], row, error_observer, cx, cy, cz)
    data += _error_along(view[far], row, error_target, ux, uy, uz)
    data += _error_along(view[far], row, REFERENCE_ERROR, vx, vy, vz)
    below = data + beyond_first_order(half_observer, value_observer, slope_observer)
    below += beyond_first_order(half_far, value_far, slope_far)
    above = data + beyond_first_order(half_observer, -value_observer, -slope_observer)
    above += beyond_first_order(half_far, -value_far, -slope_far)
    ball = view[observer, RADIUS] + view[far, RADIUS] + row[radius] * half_observer
    ball += row[REFERENCE_RADIUS] * half_far + row[REFERENCE_ERROR_RADIUS]
    bent = _bent(norm, with_error(w[BALL] + row[ERROR_RADIUS], w[MAGNITUDE]))
    bent_reference = _bent(reference, with_error(ball, w[MAGNITUDE]))
    along, least, most = norm - reference, row[LEAST], row[MOST]
    never_above = along + reach + above + bent <= most + data
    if never_above and along - reach - below - bent_reference >= least - data:
        return SETTLED
    if w[BALL] < norm and ball < reference:
        spread(scratch, bodies, slopes)
    else:
        spread(scratch, bodies, (1.0, 1.0, 1.0, row[A_RADIUS], row[B_RADIUS]))
    room = with_error(most - along + below + bent_reference, w[MAGNITUDE] + abs(most))
    if cut(scratch, box, bodies, reach, slopes, room):
        return RULED_OUT
    sx, sy, sz, slope_a, slope_b = slopes
    slopes = (-sx, -sy, -sz, -slope_a, -slope_b)
    room = with_error(along - least + above + bent, w[MAGNITUDE] + abs(least))
    return RULED_OUT if cut(scratch, box, bodies, reach, slopes, room) else UNDECIDED


@kernel(inlined=True)
def place_ends(view: np.ndarray, bodies: Bodies, row: np.ndarray, w: np.ndarray) -> None:
    """Write the vector w at the center of the box, with its parts and bounds."""
    a, b = view[bodies[0]], view[bodies[1]]
    w[TURNED_A] = a[COSINE] * row[A] - a[SINE] * row[A + 1]
    w[TURNED_A + 1] = a[SINE] * row[A] + a[COSINE] * row[A + 1]
    w[TURNED_B] = b[COSINE] * row[B] - b[SINE] * row[B + 1]
    w[TURNED_B + 1] = b[SINE] * row[B] + b[COSINE] * row[B + 1]
    w[W] = b[CENTER + X] + w[TURNED_B] - a[CENTER + X] - w[TURNED_A]
    w[W + 1] = b[CENTER + Y] + w[TURNED_B + 1] - a[CENTER + Y] - w[TURNED_A + 1]
    w[W + 2] = b[CENTER + Z] + row[B + 2] - a[CENTER + Z] - row[A + 2]
    w[NORM] = math.sqrt(w[W] * w[W] + w[W + 1] * w[W + 1] + w[W + 2] * w[W + 2])
    w[MAGNITUDE] = a[SIZE] + a[RADIUS] + b[SIZE] + b[RADIUS] + row[TERMS]
    turns = up(up(row[A_RADIUS] * a[HALF + YAW]) + up(row[B_RADIUS] * b[HALF + YAW]))
    w[BALL] = up(up(a[RADIUS] + b[RADIUS]) + turns)


@kernel(borrows=True)
def cut_box(scratch: Scratch, box: np.ndarray, row: np.ndarray) -> int:
    """
    Cut a viewed box by one reading; return UNDECIDED, SETTLED or RULED_OUT.

    Writes the faces of the remaining box, and raises the smear if the reading is undecided.
    """
    faces, w = scratch.faces, scratch.w
    for axis in range(box.shape[1]):
        faces[LOW, axis], faces[HIGH, axis] = box[LOW, axis], box[HIGH, axis]
    bodies = (int(row[A_BODY]), int(row[B_BODY]))
    place_ends(scratch.views, bodies, row, w)
    if not w[MAGNITUDE] < LONGEST:
        return UNDECIDED
    result = SETTLED
    if row[NEAREST] > 0.0 or row[FARTHEST] < math.inf:
        result = _cut_distance(scratch, box, bodies, row)
    if row[OBSERVER] != NO_RAY and result != RULED_OUT:
        state = _cut_ray(scratch, box, bodies, row)
        result = state if state != SETTLED else result
    if row[HEARD_BY] != NO_RAY and result != RULED_OUT:
        state = _cut_difference(scratch, box, bodies, row)
        result = state if state != SETTLED else result
    for axis in range(box.shape[1]):
        if faces[LOW, axis] > faces[HIGH, axis]:
            return RULED_OUT
    return result
