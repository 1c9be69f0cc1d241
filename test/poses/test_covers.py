# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Covers: what they say of their poses, and that no pose that agrees with the readings is lost.

DG_PROPERTY_PAIRS sets how many random pairs are tried, DG_PROPERTY_SEED the first of them.
"""

from functools import partial
import math
import os

from hypothesis import given, settings, strategies as st
from joined_cases import chunks, first_and_last
import numpy as np
from pair_cases import random_case, turn
from plain_python import in_plain_python
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.poses import Cover, PairOptions, PairReadings, PastPoses, cover_poses
from dg_localization.poses.turns import turned


def points(rows):
    return Interval.point(np.array(rows, dtype=float).reshape(-1, 3))


def ranges(values, half):
    values = np.array(values, dtype=float)
    return Interval(values - half, values + half)


def box(x, y, yaw):
    return [[x - 0.5, y - 0.5, 0.0, yaw - 0.1], [x + 0.5, y + 0.5, 0.0, yaw + 0.1]]


def test_a_ring():
    zero = points([0.0, 0.0, 0.0])
    options = PairOptions(resolution_m=0.05, max_boxes=10000)
    cover = cover_poses(PairReadings.of(zero, zero, ranges([4.0], 0.5)), options)
    assert cover.refined and len(cover.components) == 1
    assert np.allclose(cover.position_m.lower, [-4.5, -4.5, 0.0], atol=1e-9)
    assert np.allclose(cover.position_m.upper, [4.5, 4.5, 0.0], atol=1e-9)
    assert np.diff(cover.yaw_rad) == pytest.approx(2 * math.pi)
    assert cover.volume == pytest.approx(2.0 * math.pi**2 * (4.5**2 - 3.5**2), rel=0.05)
    assert not cover.contains(np.array([3.0, 0.0, 0.0]), 1.0)


def test_boxes_touch_across_the_half_turn_only_where_they_do():
    boxes = [
        box(0.0, 0.0, math.pi - 0.1),
        box(1.0, 0.0, -math.pi + 0.1),
        box(2.5, 0.0, 0.0),
        box(2.0, 0.9, 0.15),
    ]
    first, second = Cover(np.array(boxes)).components
    assert len(first) == len(second) == 2
    arcs = sorted(part.yaw_rad for part in (first, second))
    assert arcs[0] == pytest.approx((-0.1, 0.25))
    assert arcs[1] == pytest.approx((math.pi - 0.2, math.pi + 0.2))


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'distance_m': ranges([3.0], -0.1)}, 'distance_m: .* m is no interval'),
        ({'distance_m': ranges([math.nan], 0.1)}, 'distance_m'),
    ],
)
def test_what_is_no_reading_is_refused(changes, message):
    zero = points(np.zeros((1, 3)))
    with pytest.raises(ValueError, match=message):
        PairReadings.of(zero, zero, **changes)


def test_compiled_kernels_and_python_agree_to_the_last_bit():
    pytest.importorskip('numba')
    calls = []
    for seed in range(12):
        case = random_case(seed, liars=seed % 3)
        options = PairOptions(case.liars, 0.3 * case.scale_m, 60)
        calls.append(partial(cover_poses, case.readings, options, height_m=case.height_m))
    for call, plain in zip(calls, in_plain_python(calls), strict=True):
        cover = call()
        assert np.array_equal(cover.boxes, plain.boxes)
        assert len(cover.components) == len(plain.components)


PAIRS = int(os.environ.get('DG_PROPERTY_PAIRS', '1000'))


def cover_of(case, max_boxes=100, **changes):
    options = PairOptions(case.liars, resolution_m=0.2 * case.scale_m, max_boxes=max_boxes)
    return cover_poses(case.readings, options, height_m=case.height_m, **changes)


def holds(case, cover):
    return cover.contains(case.truth.position_m, case.truth.yaw_rad)


def lost(seeds, **kind):
    """Return the seeds of pairs whose truth is in no box."""
    return [s for s in seeds if not holds(case := random_case(s, **kind), cover_of(case))]


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('seeds', chunks(PAIRS, 200), ids=first_and_last)
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
    lengths = np.sqrt((w**2).sum(axis=-1))
    distances = Interval.point(lengths).hull(Interval.around(lengths, 1e-9))
    readings = PairReadings.of(Interval.point(a), Interval.point(b), distances)
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
    stated = PastPoses(Interval.around(position, error), Interval.around(yaw, 0.01))
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
