# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Cutting a box of relative poses by half-spaces: kernels.

A pose is (x, y, z, yaw). Everything is seen from the center of the box, where a half-space is
x dx + y dy + z dz + yaw dyaw <= room; `room` holds whatever bounds the rest of the constraint
from above over the whole box, errors of the data and of rounding included.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, rounding_error, sqrt_up, square_up, up

X, Y, Z, YAW = 0, 1, 2, 3
LOW, HIGH = 0, 1

UNDECIDED, SETTLED, RULED_OUT = 0, 1, 2
"""What a reading says of a box: possible in part, possible all over, impossible."""

# A box as seen from its center: center and half-widths, cosine and sine of the yaw, radius of the
# positions, sum of the center's absolute coordinates.
CENTER, HALF = 0, 4
COSINE, SINE, RADIUS, SIZE = 8, 9, 10, 11
VIEW = 12


@kernel
def with_error(value: float, magnitude: float) -> float:
    """
    Return an upper bound of a sum of products that was computed as `value`.

    The sums of this room take fewer than 50 operations on numbers below 5 times `magnitude`, the
    sum of the absolute lengths in them.
    """
    return up(value + rounding_error(magnitude, 256.0))


@kernel(borrows=True)
def view_box(box: np.ndarray, view: np.ndarray) -> None:
    """Write center, half-widths and rotation of a box (2, 4) to `view` (VIEW,)."""
    for axis in range(4):
        low, high = box[LOW, axis], box[HIGH, axis]
        center = 0.5 * low + 0.5 * high
        view[CENTER + axis] = center
        view[HALF + axis] = max(up(high - center), up(center - low))
    view[COSINE] = math.cos(view[CENTER + YAW])
    view[SINE] = math.sin(view[CENTER + YAW])
    squares = up(square_up(view[HALF + X]) + square_up(view[HALF + Y]))
    view[RADIUS] = sqrt_up(up(squares + square_up(view[HALF + Z])))
    view[SIZE] = abs(view[CENTER + X]) + abs(view[CENTER + Y]) + abs(view[CENTER + Z])


@kernel(inlined=True)
def _cut_face(
    faces: np.ndarray, box: np.ndarray, axis: int, slope: float, extent: float, reach: float
) -> None:
    """
    Move a face of the box: |slope| times the width that is left is `extent` at most.

    `reach` is |slope| times half the width that was.
    """
    if extent >= 2.0 * reach:
        return
    if slope > 0.0:
        faces[HIGH, axis] = min(faces[HIGH, axis], up(box[LOW, axis] + up(extent / slope)))
    elif slope < 0.0:
        faces[LOW, axis] = max(faces[LOW, axis], down(box[HIGH, axis] - up(extent / -slope)))


@kernel(inlined=True)
def cut(
    faces: np.ndarray,
    box: np.ndarray,
    view: np.ndarray,
    reach: float,
    x: float,
    y: float,
    z: float,
    yaw: float,
    room: float,
) -> bool:
    """
    Cut off what violates x dx + y dy + z dz + yaw dyaw <= room; `reach` bounds the left side.

    Returns whether nothing is left.
    """
    if room < -reach:
        return True
    if room < reach:
        extent = max(0.0, up(room + reach))
        _cut_face(faces, box, X, x, extent, abs(x) * view[HALF + X])
        _cut_face(faces, box, Y, y, extent, abs(y) * view[HALF + Y])
        _cut_face(faces, box, Z, z, extent, abs(z) * view[HALF + Z])
        _cut_face(faces, box, YAW, yaw, extent, abs(yaw) * view[HALF + YAW])
    return False


@kernel(inlined=True)
def reach_of(view: np.ndarray, x: float, y: float, z: float, yaw: float) -> float:
    """Bound |x dx + y dy + z dz + yaw dyaw| over the box."""
    reach = (
        abs(x) * view[HALF + X]
        + abs(y) * view[HALF + Y]
        + abs(z) * view[HALF + Z]
        + abs(yaw) * view[HALF + YAW]
    )
    return with_error(reach, reach)


@kernel(inlined=True)
def spread(smear: np.ndarray, view: np.ndarray, x: float, y: float, z: float, yaw: float) -> None:
    """Note by how much a reading that is undecided changes along each axis of the box."""
    smear[X] = max(smear[X], abs(x) * view[HALF + X])
    smear[Y] = max(smear[Y], abs(y) * view[HALF + Y])
    smear[Z] = max(smear[Z], abs(z) * view[HALF + Z])
    smear[YAW] = max(smear[YAW], abs(yaw) * view[HALF + YAW])


@kernel(inlined=True)
def beyond_first_order(half_yaw: float, value: float, slope: float) -> float:
    """
    Bound how far value cos(t) + slope sin(t) falls below value + slope t, |t| <= half_yaw.

    It is -value (1 - cos t) - slope (t - sin t).
    """
    return half_yaw * half_yaw * (0.5 * max(value, 0.0) + abs(slope) * half_yaw / 6.0)


@kernel(inlined=True)
def limit(
    faces: np.ndarray,
    smear: np.ndarray,
    box: np.ndarray,
    view: np.ndarray,
    slopes: tuple[float, float, float, float],
    room: float,
    least: float,
    ball: float,
) -> int:
    """Cut off what violates slopes.(dx, dy, dz, dyaw) <= room; `least` is room without slack."""
    if least >= ball:
        return SETTLED
    x, y, z, yaw = slopes
    spread(smear, view, x, y, z, yaw)
    if cut(faces, box, view, reach_of(view, x, y, z, yaw), x, y, z, yaw, room):
        return RULED_OUT
    return UNDECIDED
