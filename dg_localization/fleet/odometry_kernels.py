# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Kernels of `odometry`: the walk back along a track, and the samples around a time."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval import angles
from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import elapsed_up, rounding_error, up

# Plain Python calls the original function, which never waits for a compiler.
angle_up = kernel(angles.angle_up)

_STEP_OPERATIONS = 16.0
"""More operations than a step of `walk_back` takes."""

_AMONG, _AT_END, _BEYOND = range(3)
"""The place of a time: among the samples, at the first or last sample, or beyond them."""


@kernel(borrows=True)
def _forward(turn_error_rad: float, along: float, across: float) -> float:
    """
    Bound the displacement of a point along one axis by an error of a turn.

    `along` and `across` are its coordinates on this axis and on the other before the turns in
    between, which err by at most `turn_error_rad`.
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
def _within(span: float, limit: float, reach: float, place: int) -> float:
    """Return a bound of the motion of a robot from a sample, by samples and limit."""
    limited = up(limit * reach)
    by_limit = place == _BEYOND or (place == _AT_END and limited < math.inf)
    return limited if by_limit else min(span, limited)


@kernel(borrows=True)
def find_nearest(
    times: np.ndarray,
    stamps: np.ndarray,
    positions: np.ndarray,
    yaws: np.ndarray,
    rotations: np.ndarray,
    steps: np.ndarray,
    limits: tuple[float, float, float],
    index: np.ndarray,
    offsets: np.ndarray,
    reaches: np.ndarray,
    places: np.ndarray,
) -> None:
    """
    Find the samples nearest to some times, and bounds of the distance of the robot from them.

    Between two samples the robot is no farther from either than their distance, which is at most
    the stated one plus the error of the steps.

    Parameters
    ----------
    times : numpy.ndarray, shape (m,)
    stamps, yaws : numpy.ndarray, shape (n,)
        Yaws from -pi to pi.
    positions : numpy.ndarray, shape (n, 3)
    rotations : numpy.ndarray, shape (n, 3, 3)
    steps : numpy.ndarray, shape (3, n - 1)
        The greatest errors of every step in m and in rad, and 1 where samples are missing.
    limits : tuple of float
        Speed in m/s, turn rate in rad/s, and latency in s: the samples around a time are those
        from the last one before it by the latency to the first one after it by the latency.
    index : numpy.ndarray of int, shape (m,)
        Receives the nearest samples.
    offsets : numpy.ndarray, shape (3, m)
        Receives the greatest differences from them: distance, yaw, angle of the rotation. Limits
        of yaws are applied in `limit_yaws`.
    reaches : numpy.ndarray, shape (m,)
        Receives the time for which the robot may have moved from them, in s.
    places : numpy.ndarray of int, shape (m,)
        Receives whether a time is among the samples, at an end of them, or beyond them.

    """
    count = stamps.shape[0]
    speed, turn_rate, latency = limits
    slack = 0.0
    if latency > 0.0 or (speed < math.inf and turn_rate < math.inf):
        # Equal numbers need not be equal times (`elapsed_up`).
        largest = max(abs(stamps[0]), abs(stamps[-1]))
        for number in range(times.shape[0]):
            largest = max(largest, abs(times[number]))
        slack = 4.0 * elapsed_up(largest, largest)
    around = up(latency + slack) if slack > 0.0 else latency
    for number in range(times.shape[0]):
        time = times[number]
        low = max(0, np.searchsorted(stamps, time - around, side='right') - 1)
        high = min(count - 1, np.searchsorted(stamps, time + around, side='left'))
        nearest = low
        for sample in range(low, high + 1):
            if abs(stamps[sample] - time) < abs(stamps[nearest] - time):
                nearest = sample
        index[number] = nearest
        _spans_around(positions, yaws, rotations, steps, (nearest, low, high), offsets[:, number])
        reach = up(elapsed_up(time, stamps[nearest]) + latency)
        place = _AMONG
        if time - latency < stamps[0] or time + latency > stamps[-1]:
            place = _BEYOND
        elif time - latency <= stamps[0] + slack or time + latency >= stamps[-1] - slack:
            place = _AT_END
        offsets[0, number] = _within(offsets[0, number], speed, reach, place)
        offsets[2, number] = _within(offsets[2, number], turn_rate, reach, place)
        reaches[number], places[number] = reach, place


@kernel(borrows=True)
def _spans_around(
    positions: np.ndarray,
    yaws: np.ndarray,
    rotations: np.ndarray,
    steps: np.ndarray,
    samples: tuple[int, int, int],
    spans: np.ndarray,
) -> None:
    """Write the greatest differences from one sample to all between two others."""
    nearest, low, high = samples
    spans[0] = spans[1] = spans[2] = 0.0
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
            spans[kind] = max(spans[kind], span)
        off_m, off_rad = up(off_m + steps[0, sample]), up(off_rad + steps[1, sample])
        missing = missing or steps[2, sample] > 0.0
    # The true samples may be farther apart than stated, by the error of the steps.
    if off_m > 0.0:
        spans[0] = up(up(spans[0] + off_m) + up(off_rad * spans[0]))
    for kind in range(1, 3):
        if spans[kind] > 0.0:
            spans[kind] = angle_up(spans[kind])
        if off_rad > 0.0:
            spans[kind] = up(spans[kind] + off_rad)
    if missing:
        spans[0] = spans[1] = spans[2] = math.inf


@kernel(borrows=True)
def limit_yaws(
    spans: np.ndarray,
    turn_rate: float,
    steepness: np.ndarray,
    reaches: np.ndarray,
    places: np.ndarray,
) -> None:
    """
    Bound differences of yaws by the greatest rate of yaws; see `find_nearest`.

    Parameters
    ----------
    spans : numpy.ndarray, shape (m,)
        Differences by the samples; replaced by the result.
    turn_rate : float
        Turn rate of the body, in rad/s.
    steepness : numpy.ndarray, shape (m,)
        Greatest ratio of the rate of yaws to it.
    reaches, places : numpy.ndarray, shape (m,)

    """
    for number in range(spans.shape[0]):
        limit = up(turn_rate * steepness[number])
        spans[number] = _within(spans[number], limit, reaches[number], places[number])
