# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Cutting a box of the poses of bodies by half-spaces: kernels.

A pose is (x, y, z, yaw); a box (2, 4 n) bounds those of n bodies, one after the other. A
half-space relates two of them, A and B, or one and the frame, which is body n of the view and
never moves. It is c.(db - da) + slope_a dyaw_a + slope_b dyaw_b <= room about the center of the
box; `room` is an upper bound of the rest of the constraint, including errors of data and of
rounding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, rounding_error, sqrt_up, square_up, up

X, Y, Z, YAW = 0, 1, 2, 3
LOW, HIGH = 0, 1

UNDECIDED, SETTLED, RULED_OUT = 0, 1, 2
"""The result of a reading for a box: partly possible, possible all over, impossible."""

# A body as seen from the center of its box: center and half-widths, cosine and sine of the yaw,
# radius of the positions, sum of the center's absolute coordinates.
CENTER, HALF = 0, 4
COSINE, SINE, RADIUS, SIZE = 8, 9, 10, 11
VIEW = 12

Bodies = tuple[int, int]
Slopes = tuple[float, float, float, float, float]
"""Those of x, y, z, and of the yaws of both bodies."""


class Scratch(NamedTuple):
    """Arrays to write to while readings cut a box of n bodies."""

    views: np.ndarray  # (n + 1, VIEW): the bodies, and the frame, from the center of the box
    faces: np.ndarray  # (2, 4 n): the faces that a reading leaves
    smear: np.ndarray  # (4 n,): the greatest change of a reading along each axis, in m
    w: np.ndarray  # (W_SIZE,): the vector of a reading (`cuts`)


@kernel
def with_error(value: float, magnitude: float) -> float:
    """
    Return an upper bound of a sum of products that was computed as `value`.

    The sums of this package take fewer than 100 operations on numbers below 5 times `magnitude`,
    the sum of the absolute lengths in them.
    """
    return up(value + rounding_error(magnitude, 512.0))


@kernel(borrows=True)
def view_box(box: np.ndarray, view: np.ndarray) -> None:
    """Write centers, half-widths and rotations of the bodies of a box to `view` (n + 1, VIEW)."""
    bodies = view.shape[0] - 1
    for body in range(bodies):
        for axis in range(4):
            low, high = box[LOW, 4 * body + axis], box[HIGH, 4 * body + axis]
            center = low if low == high else 0.5 * low + 0.5 * high
            view[body, CENTER + axis] = center
            wide = low < high
            view[body, HALF + axis] = max(up(high - center), up(center - low)) if wide else 0.0
        view[body, COSINE] = math.cos(view[body, CENTER + YAW])
        view[body, SINE] = math.sin(view[body, CENTER + YAW])
        squares = up(square_up(view[body, HALF + X]) + square_up(view[body, HALF + Y]))
        view[body, RADIUS] = sqrt_up(up(squares + square_up(view[body, HALF + Z])))
        view[body, SIZE] = (
            abs(view[body, CENTER + X]) + abs(view[body, CENTER + Y]) + abs(view[body, CENTER + Z])
        )
    view[bodies] = 0.0
    view[bodies, COSINE] = 1.0


@kernel(inlined=True)
def _cut_face(
    faces: np.ndarray, box: np.ndarray, axis: int, slope: float, extent: float, half: float
) -> None:
    """Move a face of the box: |slope| times the remaining width is at most `extent`."""
    if extent >= 2.0 * abs(slope) * half:
        return
    if slope > 0.0:
        faces[HIGH, axis] = min(faces[HIGH, axis], up(box[LOW, axis] + up(extent / slope)))
    elif slope < 0.0:
        faces[LOW, axis] = max(faces[LOW, axis], down(box[HIGH, axis] - up(extent / -slope)))


@kernel(inlined=True)
def cut(
    scratch: Scratch, box: np.ndarray, bodies: Bodies, reach: float, slopes: Slopes, room: float
) -> bool:
    """Cut off the poses outside a half-space with `room`; return whether none is left."""
    view, faces = scratch.views, scratch.faces
    if room < -reach:
        return True
    if room < reach:
        a, b = bodies
        x, y, z, yaw_a, yaw_b = slopes
        extent = max(0.0, up(room + reach))
        if b < view.shape[0] - 1:
            _cut_face(faces, box, 4 * b + X, x, extent, view[b, HALF + X])
            _cut_face(faces, box, 4 * b + Y, y, extent, view[b, HALF + Y])
            _cut_face(faces, box, 4 * b + Z, z, extent, view[b, HALF + Z])
            _cut_face(faces, box, 4 * b + YAW, yaw_b, extent, view[b, HALF + YAW])
        if a < view.shape[0] - 1:
            _cut_face(faces, box, 4 * a + X, -x, extent, view[a, HALF + X])
            _cut_face(faces, box, 4 * a + Y, -y, extent, view[a, HALF + Y])
            _cut_face(faces, box, 4 * a + Z, -z, extent, view[a, HALF + Z])
            _cut_face(faces, box, 4 * a + YAW, yaw_a, extent, view[a, HALF + YAW])
    return False


@kernel(inlined=True)
def reach_of(view: np.ndarray, bodies: Bodies, slopes: Slopes) -> float:
    """Bound the absolute value of the left side of a half-space over the box."""
    a, b = bodies
    x, y, z, yaw_a, yaw_b = slopes
    reach = (
        abs(x) * (view[a, HALF + X] + view[b, HALF + X])
        + abs(y) * (view[a, HALF + Y] + view[b, HALF + Y])
        + abs(z) * (view[a, HALF + Z] + view[b, HALF + Z])
        + abs(yaw_a) * view[a, HALF + YAW]
        + abs(yaw_b) * view[b, HALF + YAW]
    )
    return with_error(reach, reach)


@kernel(inlined=True)
def spread(scratch: Scratch, bodies: Bodies, slopes: Slopes) -> None:
    """Raise `smear` to the change of an undecided reading along each axis of the box."""
    view, smear = scratch.views, scratch.smear
    x, y, z, yaw_a, yaw_b = slopes
    for end in range(2):
        body = bodies[end]
        if body < view.shape[0] - 1:
            yaw = yaw_a if end == 0 else yaw_b
            at = 4 * body
            smear[at + X] = max(smear[at + X], abs(x) * view[body, HALF + X])
            smear[at + Y] = max(smear[at + Y], abs(y) * view[body, HALF + Y])
            smear[at + Z] = max(smear[at + Z], abs(z) * view[body, HALF + Z])
            smear[at + YAW] = max(smear[at + YAW], abs(yaw) * view[body, HALF + YAW])


@kernel(inlined=True)
def beyond_first_order(half_yaw: float, value: float, slope: float) -> float:
    """
    Bound value + slope t - (value cos(t) + slope sin(t)) from above for |t| <= half_yaw.

    It is -value (1 - cos t) - slope (t - sin t).
    """
    return half_yaw * half_yaw * (0.5 * max(value, 0.0) + abs(slope) * half_yaw / 6.0)
