# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a cover says of its poses: components, hulls, areas, and how sharp it is."""

from functools import partial
import math

import numpy as np
from pair_cases import random_case
from plain_python import in_plain_python
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.poses import Cover, PairOptions, PairReadings, cover_poses


def points(rows):
    return Interval.point(np.array(rows, dtype=float).reshape(-1, 3))


def ranges(values, half):
    values = np.array(values, dtype=float)
    return Interval(values - half, values + half)


def box(x, y, yaw):
    return [[x - 0.5, y - 0.5, 0.0, yaw - 0.1], [x + 0.5, y + 0.5, 0.0, yaw + 0.1]]


def test_a_ring():
    zero = points([0.0, 0.0, 0.0])
    cover = cover_poses(
        PairReadings.of(zero, zero, ranges([4.0], 0.5)),
        PairOptions(resolution_m=0.05, max_boxes=10000),
    )
    assert cover.refined and len(cover.components) == 1
    assert np.allclose(cover.position_m.lower, [-4.5, -4.5, 0.0], atol=1e-9)
    assert np.allclose(cover.position_m.upper, [4.5, 4.5, 0.0], atol=1e-9)
    assert np.diff(cover.yaw_rad) == pytest.approx(2 * math.pi)
    assert cover.volume == pytest.approx(2.0 * math.pi**2 * (4.5**2 - 3.5**2), rel=0.05)
    assert not cover.contains(np.array([3.0, 0.0, 0.0]), 1.0)


def test_boxes_touch_across_the_half_turn_only_where_they_do():
    boxes = np.array(
        [
            box(0.0, 0.0, math.pi - 0.1),
            box(1.0, 0.0, -math.pi + 0.1),
            box(2.5, 0.0, 0.0),
            box(2.0, 0.9, 0.15),
        ]
    )
    first, second = Cover(boxes).components
    assert len(first) == len(second) == 2
    arcs = sorted(part.yaw_rad for part in (first, second))
    assert arcs[0] == pytest.approx((-0.1, 0.25))
    assert arcs[1] == pytest.approx((math.pi - 0.2, math.pi + 0.2))


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        (
            {'distance_m': ranges([3.0], -0.1)},
            'distance_m: .* m is no interval',
        ),
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
