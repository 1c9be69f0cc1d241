# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Kernels of `odometry`: the walk back along a track, and the differences between samples."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval import angles
from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import rounding_error, up

# Plain Python calls the original function, which never waits for a compiler.
angle_up = kernel(angles.angle_up)

_STEP_OPERATIONS = 16.0
"""More operations than a step of `walk_back` takes."""


@kernel(borrows=True)
def walk_back(
    positions: np.ndarray,
    yaw: float,
    step_errors_m: np.ndarray,
    step_errors_rad: np.ndarray,
    then: np.ndarray,
    last: int,
    centers: np.ndarray,
    halves: np.ndarray,
    turns: np.ndarray,
) -> None:
    """
    Bound the samples of a track in the level frame of one of them.

    Parameters
    ----------
    positions : numpy.ndarray, shape (n, 3)
        In m, in the odometry frame.
    yaw : float
        The yaw of sample `last`, in rad.
    step_errors_m, step_errors_rad : numpy.ndarray, shape (n - 1,)
    then : numpy.ndarray of int, shape (m,)
        Samples up to `last`.
    last : int
    centers, halves : numpy.ndarray, shape (m, 3)
        Receive the boxes of the positions.
    turns : numpy.ndarray, shape (m,)
        Receives the greatest errors of the yaws.

    """
    cosine, sine = math.cos(yaw), math.sin(yaw)
    for number in range(then.shape[0]):
        first = then[number]
        error_x, error_y, error_m, turn = 0.0, 0.0, 0.0, 0.0
        size = abs(positions[last, 0]) + abs(positions[last, 1]) + abs(positions[last, 2])
        for step in range(last - 1, first - 1, -1):
            end = step + 1
            dx = positions[end, 0] - positions[first, 0]
            dy = positions[end, 1] - positions[first, 1]
            along_x, along_y = cosine * dx + sine * dy, cosine * dy - sine * dx
            turn += step_errors_rad[step]
            # An error of a turn moves a point across its direction, and back along it by as much
            # as earlier turns err.
            error_x += step_errors_rad[step] * (abs(along_y) + min(1.0, turn) * abs(along_x))
            error_y += step_errors_rad[step] * (abs(along_x) + min(1.0, turn) * abs(along_y))
            error_m += step_errors_m[step]
            size = max(size, abs(dx) + abs(dy))
        dx = positions[first, 0] - positions[last, 0]
        dy = positions[first, 1] - positions[last, 1]
        x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
        z = positions[first, 2] - positions[last, 2]
        size += abs(positions[first, 0]) + abs(positions[first, 1]) + abs(positions[first, 2])
        magnitude = 2.0 * size + error_x + error_y + error_m + turn
        slack = rounding_error(magnitude, _STEP_OPERATIONS * (last - first + 1.0))
        centers[number, 0], centers[number, 1], centers[number, 2] = x, y, z
        halves[number, 0] = up(error_x + error_m + slack)
        halves[number, 1] = up(error_y + error_m + slack)
        halves[number, 2] = up(error_m + slack)
        turns[number] = up(turn + slack)


@kernel(borrows=True)
def _rotation_angle(first: np.ndarray, second: np.ndarray) -> float:
    """Return the angle between two rotations, from the length of their difference."""
    squares = 0.0
    for row in range(3):
        for column in range(3):
            squares += (first[row, column] - second[row, column]) ** 2
    ratio = math.sqrt(squares / 8.0)
    # The arcsine loses its precision near one.
    return 2.0 * math.asin(ratio) if ratio < 0.99 else math.pi


@kernel(borrows=True)
def step_angles(rotations: np.ndarray, angles: np.ndarray) -> None:
    """Write the angles between successive rotations (n, 3, 3) to `angles` (n - 1,)."""
    for step in range(angles.shape[0]):
        angles[step] = _rotation_angle(rotations[step], rotations[step + 1])


@kernel(borrows=True)
def _differences(
    positions: np.ndarray, yaws: np.ndarray, rotations: np.ndarray, first: int, second: int
) -> tuple[float, float, float]:
    """Return the distance of two samples, the difference of their yaws and the turn between."""
    squares = 0.0
    for axis in range(3):
        squares += (positions[second, axis] - positions[first, axis]) ** 2
    distance = math.sqrt(squares)
    if squares > 0.0:
        distance = up(distance + rounding_error(distance, 8.0))
    turn = abs(yaws[second] - yaws[first])
    turn = min(turn, 2.0 * math.pi - turn)
    return distance, turn, _rotation_angle(rotations[second], rotations[first])


@kernel(borrows=True)
def spans_around(
    positions: np.ndarray,
    yaws: np.ndarray,
    rotations: np.ndarray,
    steps: np.ndarray,
    samples: np.ndarray,
    spans: np.ndarray,
) -> None:
    """
    Bound the differences between one sample and all samples between two others.

    Between two samples the robot is no farther from either than their distance, which is at most
    the stated one plus the error of the steps.

    Parameters
    ----------
    positions : numpy.ndarray, shape (n, 3)
    yaws : numpy.ndarray, shape (n,)
        From -pi to pi.
    rotations : numpy.ndarray, shape (n, 3, 3)
    steps : numpy.ndarray, shape (3, n - 1)
        The greatest errors of every step in m and in rad, and 1 where samples are missing.
    samples : numpy.ndarray of int, shape (3, m)
        The sample, and the first and the last of the others.
    spans : numpy.ndarray, shape (3, m)
        Receives the greatest differences: distance, yaw, angle of the rotation.

    """
    for number in range(samples.shape[1]):
        nearest, low, high = samples[0, number], samples[1, number], samples[2, number]
        spans[:, number] = 0.0
        off_m, off_rad = 0.0, 0.0
        missing = False
        for sample in range(low, high):
            before = _differences(positions, yaws, rotations, nearest, sample)
            after = _differences(positions, yaws, rotations, nearest, sample + 1)
            step = _differences(positions, yaws, rotations, sample, sample + 1)
            for kind in range(3):
                span = up(min(before[kind], after[kind]) + step[kind])
                if sample == nearest or sample + 1 == nearest:
                    span = step[kind]
                spans[kind, number] = max(spans[kind, number], span)
            off_m, off_rad = up(off_m + steps[0, sample]), up(off_rad + steps[1, sample])
            missing = missing or steps[2, sample] > 0.0
        # The true samples may be farther apart than stated, by the error of the steps.
        if off_m > 0.0:
            spans[0, number] = up(up(spans[0, number] + off_m) + up(off_rad * spans[0, number]))
        for kind in range(1, 3):
            if spans[kind, number] > 0.0:
                spans[kind, number] = angle_up(spans[kind, number])
            if off_rad > 0.0:
                spans[kind, number] = up(spans[kind, number] + off_rad)
        if missing:
            spans[:, number] = math.inf
