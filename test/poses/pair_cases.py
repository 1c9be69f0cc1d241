# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Random pairs of bodies with known truth, whose readings obey their bounds or lie."""

from dataclasses import dataclass
import math

import numpy as np

from dg_localization.interval.arrays import Interval
from dg_localization.poses import PairReadings, PastPoses

# Bounds are met exactly as often as not; this takes the rounding of the truth itself.
TRUTH_ROUNDING = 1e-12


@dataclass
class Truth:
    position_m: np.ndarray
    yaw_rad: float


@dataclass
class Case:
    readings: PairReadings
    truth: Truth
    height_m: tuple[float, float]
    scale_m: float
    liars: int


def turn(yaw, points):
    """Turn points (..., 3) about the vertical axis."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def where_in_bounds(rng, shape):
    """Draw where truths lie in their bounds, from -1 to 1: often at an end."""
    inside = rng.uniform(-1.0, 1.0, shape)
    return np.where(rng.random(shape) < 0.5, np.sign(inside), inside)


def around(rng, truth, half):
    """Return intervals of given half-widths that hold the truth, anywhere in them."""
    truth = np.asarray(truth, dtype=float)
    middle = truth + where_in_bounds(rng, truth.shape) * half
    slack = half + TRUTH_ROUNDING * (np.abs(truth) + half + np.max(np.abs(truth), initial=0.0))
    return Interval(middle - slack, middle + slack)


def random_case(seed, *, scale_m=None, liars=0, alone=False):
    """
    Draw a pair: plane or space, odometry and levers at bounds.

    There are ranges, rays and range differences either way, or such differences alone.
    """
    rng = np.random.default_rng(seed)
    scale_m = 10.0 ** rng.uniform(-3.0, 3.0) if scale_m is None else scale_m
    space = bool(rng.random() < 0.4)
    count = int(rng.integers(3, 30))
    flat = np.array([1.0, 1.0, 1.0 if space else 0.0])
    truth = Truth(rng.normal(size=3) * scale_m * flat, float(rng.uniform(-math.pi, math.pi)))
    if rng.random() < 0.2:
        truth.yaw_rad = math.pi
    if rng.random() < 0.1:
        truth.position_m = np.zeros(3)
    poses, points = [], []
    for _body in range(2):
        still = rng.random() < 0.2
        positions = rng.normal(size=(count, 3)) * 0.5 * scale_m * flat * (not still)
        yaws = rng.normal(size=count) * (not still)
        error = rng.choice([0.0, 0.01, 0.1])
        poses.append((positions, yaws))
        stated = PastPoses(
            around(rng, positions, error * scale_m * flat * np.ones((count, 1))),
            around(rng, yaws, rng.choice([0.0, 0.01, 0.2])),
        )
        mounts = rng.normal(size=(count, 3)) * 0.1 * scale_m * flat * (rng.random() < 0.5)
        error_m = rng.choice([0.0, 0.02]) * scale_m * flat * np.ones((count, 1))
        bounds = around(rng, mounts, error_m)
        points.append((stated, positions + turn(yaws, mounts), stated.points_now(bounds)))
    (stated_a, true_a, points_a), (stated_b, true_b, points_b) = points
    w = truth.position_m + turn(truth.yaw_rad, true_b) - true_a
    distance = scale_m * np.linalg.norm(w / scale_m, axis=-1)
    stated = stated_a, stated_b
    distances, rays = _distances(rng, distance), _rays(rng, w, truth, poses, stated)
    heard = _differences(
        np.random.default_rng([seed, 5]),
        scale_m * flat,
        truth,
        poses,
        stated,
        (true_a, true_b),
        rays[2],
    )
    if alone:
        distances, rays = None, (None, None, rays[2])
    readings = PairReadings.of(points_a, points_b, distances, *rays, heard)
    readings = _with_lies(rng, readings, liars, scale_m)
    height = truth.position_m[2]
    slack = 1e-9 * scale_m
    height_m = (0.0, 0.0) if not space else (height - scale_m, height + slack)
    return Case(readings, truth, height_m, scale_m, liars)


def _distances(rng, distance):
    bounds = around(rng, distance, rng.choice([0.0, 0.03, 0.2]) * distance)
    unknown = rng.random(distance.shape) < 0.2
    unknown[0] = False
    least = np.where(unknown, 0.0, np.maximum(bounds.lower, 0.0))
    return Interval(least, np.where(unknown, math.inf, bounds.upper))


def _differences(rng, spread_m, truth, poses, stated, points, by_b):
    """Return references on the body of the target, and bounds of some differences."""
    (true_a, true_b), count = points, len(by_b)
    arms = rng.normal(size=(count, 3)) * rng.choice([0.1, 2.0]) * spread_m
    bounds = around(rng, arms, rng.choice([0.0, 0.02]) * spread_m * np.ones((count, 1)))
    true = [positions + turn(yaws, arms) for positions, yaws in poses]
    now = [body.points_now(bounds) for body in stated]
    on_b = truth.position_m + turn(truth.yaw_rad, true_b)
    on_b_too = truth.position_m + turn(truth.yaw_rad, true[1])
    to_target, from_a, from_b = (
        # Squares of these may be out of the range of numbers.
        spread_m[0] * np.linalg.norm((first - second) / spread_m[0], axis=-1)
        for first, second in ((on_b, true_a), (on_b_too, true_a), (on_b, true[0]))
    )
    apart = to_target - np.where(by_b, from_b, from_a)
    # What the lengths are rounded by is no part of their difference.
    known = around(rng, apart, rng.choice([0.0, 0.02, 0.3]) * spread_m[0] + 1e-12 * to_target)
    unknown = rng.random(count) < 0.3
    references = Interval(
        np.where(by_b[:, None], now[0].lower, now[1].lower),
        np.where(by_b[:, None], now[0].upper, now[1].upper),
    )
    return references, Interval(
        np.where(unknown, -math.inf, known.lower), np.where(unknown, math.inf, known.upper)
    )


def _rays(rng, w, truth, poses, stated):
    """Return rays, their errors, and who measured them."""
    count = len(w)
    by_b = rng.random(count) < 0.5
    error = rng.choice([0.0, 0.05, 0.5])
    true = np.where(by_b[:, None], turn(-truth.yaw_rad, -w), w)
    then = np.where(by_b[:, None], turn(-poses[1][1], true), turn(-poses[0][1], true))
    off = where_in_bounds(rng, count) * error
    if np.any(w[:, 2]):
        then = turn(off, then) if error == 0.0 else _tilted(rng, then, np.abs(off))
    else:
        then = turn(off, then)
    errors = np.where(rng.random(count) < 0.4, math.inf, error + 1e-9)
    now = [body.rays_now(then, errors) for body in stated]
    rays = np.where(by_b[:, None], now[1][0], now[0][0])
    return rays, np.where(by_b, now[1][1], now[0][1]), by_b


def _tilted(rng, rays, angles):
    """Return rays turned by given angles in random directions."""
    across = np.cross(rays, rng.normal(size=rays.shape))
    norms = np.linalg.norm(across, axis=-1, keepdims=True)
    across = np.divide(across, norms, out=np.zeros_like(across), where=norms > 0.0)
    across *= np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.cos(angles)[:, None] * rays + np.sin(angles)[:, None] * across


def _with_lies(rng, readings, liars, scale_m):
    """Return the readings, some of them of a quite different distance and direction."""
    chosen = rng.choice(len(readings), size=min(liars, len(readings)), replace=False)
    lower, upper = readings.distance_m.lower.copy(), readings.distance_m.upper.copy()
    rays = readings.rays.copy()
    lies = rng.uniform(0.0, 5.0, len(chosen)) * scale_m
    lower[chosen], upper[chosen] = lies, lies * 1.05
    lie = np.zeros(len(readings))
    lie[chosen] = lies
    rays[chosen] = rng.normal(size=(len(chosen), 3)) * [1.0, 1.0, 0.0]
    return PairReadings.of(
        readings.points_a_m,
        readings.points_b_m,
        Interval(lower, upper),
        rays,
        readings.ray_errors_rad,
        readings.seen_by_b,
        (
            readings.references_m,
            Interval(readings.difference_m.lower + lie, readings.difference_m.upper + lie),
        ),
    )
