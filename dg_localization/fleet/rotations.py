# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rotations as matrices, unit quaternions (x, y, z, w), and angles; unit vectors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.interval.angles import angle_up, cosine
from dg_localization.interval.arrays import Interval, up

FloatArray = NDArray[np.float64]

STEEPEST_RAD = 1.5
"""At a steeper pitch, roll and yaw are not distinguished."""

UNBOUNDED = 1e300
"""
The ratio of the rates of roll and yaw to the rate of the body then. It is finite, so that a body
that does not turn keeps both.
"""


def rotation_of_quaternion(quaternion_xyzw: ArrayLike) -> FloatArray:
    """
    Return the rotation matrices of unit quaternions.

    Parameters
    ----------
    quaternion_xyzw : array_like, shape (4,) or (k, 4)

    Returns
    -------
    numpy.ndarray, shape (3, 3) or (k, 3, 3)

    """
    x, y, z, w = np.asarray(quaternion_xyzw, dtype=float).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrices = np.array(rows)
    return matrices if matrices.ndim == 2 else matrices.transpose(2, 0, 1)


def rotation_angle_rad(rotation: np.ndarray) -> float:
    """Return the angle of a rotation matrix, in [0, pi]."""
    axis = _axis_of(rotation)
    return math.atan2(math.sqrt(axis @ axis), float(rotation.trace()) - 1.0)


def _axis_of(m: np.ndarray) -> FloatArray:
    """Return the axis of a rotation matrix, with twice the sine of its angle as length."""
    return np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])


def yaw_of(xyzw: FloatArray) -> float:
    """Return the angle in rad of a rotation about z, a unit quaternion, shape (4,)."""
    return 2.0 * math.atan2(float(xyzw[2]), float(xyzw[3]))


def quaternion_of_yaw(yaw_rad: float) -> FloatArray:
    """Return the unit quaternion xyzw of a rotation about z."""
    return np.array([0.0, 0.0, math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad)])


def nearest_in_arc(yaw_rad: float, middle_rad: float, half_rad: float) -> tuple[float, float]:
    """Return the angle in an arc nearest to a given one, and its greatest distance to the ends."""
    off_rad = math.remainder(yaw_rad - middle_rad, math.tau)
    off_rad = min(max(off_rad, -half_rad), half_rad)
    return middle_rad + off_rad, min(math.pi, angle_up(angle_up(half_rad + abs(off_rad))))


def quaternion_of(rotation: FloatArray) -> FloatArray:
    """Return the unit quaternion xyzw of a rotation matrix."""
    # The products of its components, times four.
    products = np.zeros((4, 4))
    products[:3, :3] = rotation + rotation.T
    products[3, :3] = products[:3, 3] = _axis_of(rotation)
    a, b, c = rotation.diagonal()
    squares = [1.0 + a - b - c, 1.0 - a + b - c, 1.0 - a - b + c, 1.0 + a + b + c]
    np.fill_diagonal(products, squares)
    best = products[int(np.argmax(squares))]
    quaternion = best / np.linalg.norm(best)
    return np.asarray(quaternion if quaternion[3] >= 0.0 else -quaternion)


def quaternion_of_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> tuple[float, ...]:
    """Return the quaternion of a rotation about the fixed axes x, y and z, in this order."""
    (sr, cr), (sp, cp), (sy, cy) = (
        (math.sin(angle / 2.0), math.cos(angle / 2.0)) for angle in (roll_rad, pitch_rad, yaw_rad)
    )
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def level_rotations(rotations: FloatArray) -> FloatArray:
    """Return rotations without roll and pitch, shape (n, 3, 3)."""
    return rotations_about_z(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))


def rotations_about_z(yaws_rad: FloatArray) -> FloatArray:
    """Return rotations about the upright axis, shape (n, 3, 3)."""
    turns = np.zeros((len(yaws_rad), 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(yaws_rad)
    turns[:, 1, 0], turns[:, 0, 1] = np.sin(yaws_rad), -np.sin(yaws_rad)
    turns[:, 2, 2] = 1.0
    return turns


def steepness(rotations: FloatArray, within_rad: FloatArray) -> FloatArray:
    """
    Return bounds of the ratio of the rates of yaw and tilt to the rate of the body.

    It is one over the cosine of the greatest pitch near a rotation (rates of Euler angles).

    Parameters
    ----------
    rotations : numpy.ndarray, shape (n, 3, 3)
        From body to a frame whose z axis is upright.
    within_rad : numpy.ndarray, shape (n,)
        Bounds of the angle between the body and these rotations.

    Returns
    -------
    numpy.ndarray, shape (n,)
        Upper bounds; `UNBOUNDED` if the body may pitch by more than `STEEPEST_RAD`.

    """
    cosines = np.hypot(rotations[:, 0, 0], rotations[:, 1, 0])
    pitch_rad = np.abs(np.arctan2(rotations[:, 2, 0], cosines))
    steepest_rad = angle_up(up(pitch_rad + within_rad))
    below = steepest_rad < STEEPEST_RAD
    cosines = cosine(Interval.point(np.where(below, steepest_rad, 0.0))).lower
    return np.where(below, up(1.0 / cosines), UNBOUNDED)


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """Return the vectors along the last axis scaled to length 1; a zero vector stays."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 0.0, lengths, 1.0))


def angles_rad(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles between unit vectors along the last axis, in [0, pi]."""
    # Exact to rounding for all angles, unlike the arccosine near 0 and pi.
    difference = np.linalg.norm(first - second, axis=-1)
    total = np.linalg.norm(first + second, axis=-1)
    return np.asarray(2.0 * np.arctan2(difference, total))


def best_rotation(
    start: FloatArray, end: FloatArray, weights: FloatArray | None = None
) -> FloatArray:
    """
    Return the rotation that takes vectors closest to others, by least squares.

    Parameters
    ----------
    start, end : numpy.ndarray, shape (m, q)
    weights : numpy.ndarray, shape (m,), optional

    Returns
    -------
    numpy.ndarray, shape (q, q)

    """
    scaled = end if weights is None else end * weights[:, None]
    if start.shape[1] == 2:
        along = float((scaled * start).sum())
        across = float(start[:, 0] @ scaled[:, 1] - start[:, 1] @ scaled[:, 0])
        length = math.hypot(along, across)
        c, s = (along / length, across / length) if length else (1.0, 0.0)
        return np.array([[c, -s], [s, c]])
    left, _, right = np.linalg.svd(scaled.T @ start)
    signs = np.ones(start.shape[1])
    signs[-1] = np.linalg.det(left @ right)
    return np.asarray(left @ np.diag(signs) @ right)
