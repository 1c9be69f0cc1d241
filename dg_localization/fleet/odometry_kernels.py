# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Kernels of `odometry`: the walk back along a track, and the samples around a time."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import rounding_error, up

_STEP_OPERATIONS = 16.0
"""More than a step of `walk_back` takes."""


@kernel(borrows=True)
def _forward(turn_error_rad: float, along: float, across: float) -> float:
    """
    Bound how far an error of a turn moves a point along one axis.

    `along` and `across` are its coordinates on this axis and on the other before the turns in
    between, which err by `turn_error_rad` at most.
    """
    return abs(across) + min(1.0, turn_error_rad) * abs(along)


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
    Bound where samples of a track are, seen from the level frame of one of them.

    Parameters
    ----------
    positions : numpy.ndarray, shape (n, 3)
        In m, in the odometry frame.
    yaw : float
        Of sample `last`, in rad.
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
            error_x += step_errors_rad[step] * _forward(turn, along_x, along_y)
            error_y += step_errors_rad[step] * _forward(turn, along_y, along_x)
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
def find_nearest(
    times: np.ndarray,
    stamps: np.ndarray,
    positions: np.ndarray,
    yaws: np.ndarray,
    rotations: np.ndarray,
    latency: float,
    index: np.ndarray,
    spans: np.ndarray,
) -> None:
    """
    Find the samples nearest to some times, and how far from them the robot may have been.

    Between two samples it is no farther from either than they are apart.

    Parameters
    ----------
    times : numpy.ndarray, shape (m,)
    stamps, yaws : numpy.ndarray, shape (n,)
        Yaws from -pi to pi.
    positions : numpy.ndarray, shape (n, 3)
    rotations : numpy.ndarray, shape (n, 3, 3)
    latency : float
        In s: samples around a time reach from the last one this much before it to the first one
        this much after it.
    index : numpy.ndarray of int, shape (m,)
        Receives the nearest samples.
    spans : numpy.ndarray, shape (3, m)
        Receives the greatest differences from them: distance, yaw, angle of the rotation.

    """
    count = stamps.shape[0]
    for number in range(times.shape[0]):
        time = times[number]
        low = max(0, np.searchsorted(stamps, time - latency, side='right') - 1)
        high = min(count - 1, np.searchsorted(stamps, time + latency, side='left'))
        nearest = low
        for sample in range(low, high + 1):
            if abs(stamps[sample] - time) < abs(stamps[nearest] - time):
                nearest = sample
        index[number] = nearest
        spans[0, number] = spans[1, number] = spans[2, number] = 0.0
        for sample in range(low, high):
            before = _differences(positions, yaws, rotations, nearest, sample)
            after = _differences(positions, yaws, rotations, nearest, sample + 1)
            step = _differences(positions, yaws, rotations, sample, sample + 1)
            for kind in range(3):
                span = up(min(before[kind], after[kind]) + step[kind])
                if sample == nearest or sample + 1 == nearest:
                    span = step[kind]
                spans[kind, number] = max(spans[kind, number], span)
