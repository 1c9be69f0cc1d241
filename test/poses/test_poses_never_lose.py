# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The promise of a pair set: no pose that agrees with the readings is ever lost.

DG_PROPERTY_PAIRS sets how many random pairs are tried.
"""

import math
import os

from hypothesis import given, settings, strategies as st
import numpy as np
from pair_cases import random_case, turn
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.poses import PairOptions, PairReadings, PastPoses, cover_poses
from dg_localization.poses.turns import turned

PAIRS = int(os.environ.get('DG_PROPERTY_PAIRS', '1000'))
CHUNK = 200
CHUNKS = [range(seed, min(seed + CHUNK, PAIRS)) for seed in range(0, PAIRS, CHUNK)]


def cover_of(case, max_boxes=100, **changes):
    options = PairOptions(case.liars, resolution_m=0.2 * case.scale_m, max_boxes=max_boxes)
    return cover_poses(case.readings, options, height_m=case.height_m, **changes)


def holds(case, cover):
    return cover.contains(case.truth.position_m, case.truth.yaw_rad)


def lost(seeds, **kind):
    """Return the seeds of pairs whose truth is in no box."""
    return [s for s in seeds if not holds(case := random_case(s, **kind), cover_of(case))]


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('seeds', CHUNKS, ids=lambda seeds: f'{seeds[0]}-{seeds[-1]}')
def test_no_truth_is_lost(seeds):
    assert not lost(seeds)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('liars', [0, 2])
def test_no_truth_is_lost_by_range_differences_alone(liars):
    bounded = 0
    for seed in range(300):
        cover = cover_of(case := random_case(seed, liars=liars, alone=True))
        assert holds(case, cover), seed
        bounded += cover.bounded
    assert bounded > 30


@pytest.mark.parametrize('liars', [1, 2, 5])
def test_no_truth_is_lost_among_liars(liars):
    assert not lost(range(300), liars=liars)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('exponent', [-320, -300, -160, -100, 100, 140, 155, 300])
def test_no_truth_is_lost_at_any_scale(exponent):
    scale_m = 10.0**exponent
    for seed in range(20):
        with np.errstate(over='ignore', under='ignore', invalid='ignore'):
            case = random_case(seed, scale_m=scale_m)
            options = PairOptions(resolution_m=max(0.5 * scale_m, 5e-324), max_boxes=60)
            cover = cover_poses(case.readings, options, height_m=case.height_m)
        assert holds(case, cover), seed


@settings(max_examples=200, derandomize=False)
@given(
    xy=st.lists(st.tuples(*[st.integers(-20, 20)] * 6), min_size=1, max_size=8),
    x=st.integers(-20, 20),
    y=st.integers(-20, 20),
    quarter=st.integers(-2, 2),
)
def test_no_truth_is_lost_on_a_grid(xy, x, y, quarter):
    # Right angles and integers: coincident points, ranges of zero and poses on faces of boxes.
    cells = np.array(xy, dtype=float)
    level = np.zeros((len(cells), 1))
    a, b = np.hstack([cells[:, :2], level]), np.hstack([cells[:, 2:4], level])
    yaw = quarter * math.pi / 2
    w = np.array([x, y, 0.0]) + np.round(turn(yaw, b)) - a
    squares = (w**2).sum(axis=-1)
    readings = PairReadings.of(
        Interval.point(a),
        Interval.point(b),
        Interval.point(np.sqrt(squares)).hull(Interval.around(np.sqrt(squares), 1e-9)),
    )
    cover = cover_poses(readings, PairOptions(resolution_m=2.0, max_boxes=200))
    assert cover.contains(np.array([x, y, 0.0]), yaw)


@pytest.mark.parametrize('max_boxes', [1, 16, 17, 40])
def test_a_cover_of_few_boxes_is_complete(max_boxes):
    for seed in range(60):
        case = random_case(seed)
        cover = cover_of(case, max_boxes)
        assert holds(case, cover)
        assert len(cover) <= max(max_boxes, 16)


def test_a_cover_is_complete_whenever_it_is_stopped():
    for seed in range(20):
        case = random_case(seed)
        for looks in (0, 1, 2, 5, 9):
            left = iter([False] * looks)
            cover = cover_of(case, 500, stopped=lambda left=left: next(left, True))
            assert holds(case, cover)
            if looks == 0:
                assert not cover.refined


def motion_of(rng, scale_m, space):
    """Draw what a body does between two ticks, truth and stated bounds."""
    flat = np.array([1.0, 1.0, float(space)])
    position, yaw = rng.normal(size=(1, 3)) * 0.1 * scale_m * flat, rng.normal(size=1) * 0.3
    error = 0.01 * scale_m * flat
    stated = PastPoses(
        Interval(position - error, position + error), Interval(yaw - 0.01, yaw + 0.01)
    )
    return position[0], float(yaw[0]), stated


def moved_truth(truth, a, b):
    """Return the pose of B now in the frame of A now, both having moved."""
    yaw = truth.yaw_rad + a[1] - b[1]
    position = a[0] + turn(a[1], truth.position_m) - turn(yaw, b[0])
    return position, yaw


def ahead(past):
    """Return a pose of now seen from then, by that of then seen from now."""
    return PastPoses(turned(-past.yaw_rad, -past.position_m), -past.yaw_rad)


def test_a_cover_is_carried_by_both_odometries():
    for seed in range(200):
        case = random_case(seed)
        rng = np.random.default_rng([seed, 1])
        cover = cover_of(case)
        space = case.height_m != (0.0, 0.0)
        for _tick in range(3):
            a, b = (motion_of(rng, case.scale_m, space) for _body in range(2))
            case.truth.position_m, case.truth.yaw_rad = moved_truth(case.truth, a, b)
            cover = cover.carried(ahead(b[2]), 0.0, a[2], not space).coarsened(40)
            assert holds(case, cover), seed


def test_carried_and_new_covers_hold_the_same_truth():
    for seed in range(100):
        case = random_case(seed, space=False)
        before = cover_of(case)
        rng = np.random.default_rng([seed, 2])
        a, b = (motion_of(rng, case.scale_m, False) for _body in range(2))
        position, yaw = moved_truth(case.truth, a, b)
        readings = PairReadings.of(
            a[2].position_m + _turned_points(a[2], case.readings.points_a_m),
            b[2].position_m + _turned_points(b[2], case.readings.points_b_m),
            case.readings.distance_m,
        )
        options = PairOptions(resolution_m=0.2 * case.scale_m, max_boxes=400)
        start = before.carried(ahead(b[2]), 0.0, a[2], True).coarsened(50)
        carried = cover_poses(readings, options, within=start)
        anew = cover_poses(readings, options)
        assert carried.contains(position, yaw) and anew.contains(position, yaw), seed
        assert inside(carried, start)


def _turned_points(motion, points):
    count = points.lower.shape[0]
    yaw = Interval(np.repeat(motion.yaw_rad.lower, count), np.repeat(motion.yaw_rad.upper, count))
    return PastPoses(Interval.point(np.zeros((count, 3))), yaw).points_now(points)


def inside(cover, other):
    """Return whether each box lies in a box of the other cover."""
    low, high = cover.boxes[:, None, 0], cover.boxes[:, None, 1]
    within = (other.boxes[None, :, 0] <= low) & (high <= other.boxes[None, :, 1])
    return bool(np.all(np.any(np.all(within, axis=-1), axis=1)))
