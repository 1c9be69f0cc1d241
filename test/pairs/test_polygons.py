# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Polygons in slices of yaws: what a step and a reading leave of them."""

import math

import numpy as np
from pair_cases import range_of
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.pairs import CountedCover, Cover, PastPoses
from dg_localization.pairs.polygon_kernels import DIRECTIONS


def box_of(low, high):
    """Return the cover of a box of x, y and yaw."""
    box = np.zeros((1, 2, 4))
    box[0, :, [0, 1, 3]] = np.transpose([low, high])
    return CountedCover.of_levels([Cover(box)])


def test_what_errs_in_any_direction_widens_by_as_much():
    pose = box_of([1.0, 2.0, 0.8], [1.0, 2.0, 0.8])
    step = PastPoses.at_rest(1)
    box = Interval(np.array([[-0.1, -0.1, 0.0]]), np.array([[0.1, 0.1, 0.0]]))
    by_ball = pose.carried(step, 0.1).cover.hull
    by_box = pose.carried(PastPoses(box, step.yaw_rad)).cover.hull
    assert by_ball.widths_m[:2] == pytest.approx([0.2, 0.2])
    # A box that is turned is wider.
    wide = np.full(2, 0.2 * (math.cos(0.8) + math.sin(0.8)))
    assert by_box.widths_m[:2] == pytest.approx(wide, abs=0.002)


@pytest.mark.parametrize('seed', range(30))
def test_a_reading_leaves_the_hull_of_the_places_it_allows(seed):
    rng = np.random.default_rng(seed)
    yaw = rng.uniform(-math.pi, math.pi)
    low, anchor = rng.uniform(-3.0, 3.0, 2), np.array([*rng.uniform(-6.0, 6.0, 2), 0.0])
    high = low + rng.uniform(0.1, 2.0, 2)
    sensor = np.array([*rng.uniform(-0.5, 0.5, 2), 0.0])
    c, s = math.cos(yaw), math.sin(yaw)
    places = low + rng.uniform(size=(40_000, 2)) * (high - low)
    gaps = anchor[:2] - places - [c * sensor[0] - s * sensor[1], s * sensor[0] + c * sensor[1]]
    lengths, angles = np.linalg.norm(gaps, axis=-1), np.arctan2(gaps[:, 1], gaps[:, 0]) - yaw
    seen = rng.integers(len(places))
    bounds = lengths[seen] + rng.uniform(0.0, 0.3) * np.array([-1.0, 1.0])
    ray, error = angles[seen], rng.uniform(0.05, 0.4)
    inside = (bounds[0] <= lengths) & (lengths <= bounds[1])
    inside &= np.abs((angles - ray + math.pi) % math.tau - math.pi) <= error
    reading = range_of(
        anchor,
        max(bounds[0], 0.0),
        bounds[1],
        sensor,
        rays=[[math.cos(ray), math.sin(ray), 0.0]],
        ray_errors_rad=[error],
        seen_by_b=True,
    )
    left = box_of([*low, yaw], [*high, yaw]).cut(reading)
    reach = np.max(places[inside] @ DIRECTIONS.T, axis=0)
    slack = np.max(left.supports[:, 0], axis=0) - reach
    assert np.all(slack >= 0.0)
    # A chord, the sides of a disc, the width of the slice, and places that were not drawn.
    chord = bounds[0] * (1.0 - math.cos(2.0 * error)) + 0.01 * bounds[1]
    assert np.all(slack < chord + 0.06)


def test_a_ray_that_the_other_body_measured_does_not_turn_with_the_yaw():
    ray = {'rays': [[1.0, 0.0, 0.0]], 'ray_errors_rad': [0.1], 'seen_by_b': False}
    reading = range_of((0.0, 0.0, 0.0), 0.0, math.inf, **ray)
    left = box_of([2.0, -2.0, -1.0], [3.0, 2.0, 2.0]).cut(reading)
    assert left.cover.hull.widths_m[1] == pytest.approx(2.0 * 3.0 * math.tan(0.1), rel=1e-6)
    assert left.cover.hull.yaw_width_rad > 3.0


@pytest.mark.parametrize('way', [(1.0, 0.0), (-0.3, 2.0), (0.0, 0.0)])
def test_a_step_swings_with_all_yaws_of_a_slice(way):
    rng = np.random.default_rng(0)
    low, high = np.array([1.0, 2.0, 0.3]), np.array([1.5, 2.2, 1.2])
    cover = box_of(low, high)
    error = Interval(np.array([[-0.1, -0.02, 0.0]]), np.array([[0.1, 0.02, 0.0]]))
    turn = Interval(np.array([0.5]), np.array([0.7]))
    moved = cover.carried(
        PastPoses(error + Interval.point(np.array([[*way, 0.0]])), turn), 0.05
    ).cover
    for _pose in range(300):
        x, y, yaw = low + rng.choice([0.0, 0.3, 1.0], 3) * (high - low)
        dx, dy = way + rng.choice([-0.9999, 0.9999], 2) * [0.1, 0.02]
        angle, c, s = rng.uniform(-math.pi, math.pi), math.cos(yaw), math.sin(yaw)
        x += c * dx - s * dy + 0.04999 * math.cos(angle)
        y += s * dx + c * dy + 0.04999 * math.sin(angle)
        assert moved.contains(np.array([x, y, 0.0]), yaw + rng.choice([0.5001, 0.6, 0.6999]))
    before = cover.cover.hull
    assert moved.hull.yaw_width_rad < before.yaw_width_rad + 0.2 + 0.05


@pytest.mark.parametrize(
    ('x', 'broken'), [(0.5, 1), (1.4, 0), (1.8, 1), (2.5, 2)], ids=['B', 'none', 'A', 'both']
)
def test_what_breaks_a_reading_is_one_level_higher(x, broken):
    pose = box_of([0.0, 0.0, 0.1], [3.0, 0.5, 0.2])
    cover = CountedCover(pose.slices, np.repeat(pose.supports, 3, axis=1))
    # A holds up to 1.6 m, B from 1.2 m to 2 m, and the last one everywhere.
    for low_m, high_m in ((0.0, 1.6), (1.2, 2.0), (0.0, 9.0)):
        cover = cover.cut(range_of((0.0, 0.0, 0.0), low_m, high_m))
    place = np.array([x, 0.1, 0.0])
    assert [cover.level(k).contains(place, 0.15) for k in range(broken, 3)] == [True] * (
        3 - broken
    )
    assert not cover.level(0).contains(place, 0.15) or broken == 0


@pytest.mark.parametrize('near', [0.5, 1.5, 2.0, 2.3])
def test_beyond_a_least_distance_nothing_is_lost(near):
    rng = np.random.default_rng(1)
    low, high = np.array([1.0, -1.0]), np.array([2.2, 1.5])
    left = box_of([*low, 0.4], [*high, 0.4]).cut(range_of((0.0, 0.0, 0.0), near, 9.0))
    places = low + rng.choice([0.0, 1.0, 0.5, rng.uniform()], (500, 2)) * (high - low)
    for place in places[np.linalg.norm(places, axis=-1) >= near]:
        assert left.cover.contains(np.array([*place, 0.0]), 0.4)
    if near == 2.3:
        assert left.cover.hull.lower_m[0] > 1.05


@pytest.mark.parametrize('seed', range(20))
def test_half_spaces_one_after_the_other_leave_what_all_allow(seed):
    rng = np.random.default_rng(seed)
    cover = box_of([-1.0, -1.0, 0.0], [1.0, 1.0, 0.0])
    places = rng.uniform(-1.0, 1.0, (20_000, 2))
    for _cut in range(5):
        # Far away, a range is a half-space.
        angle = rng.uniform(-math.pi, math.pi)
        anchor = 1e4 * np.array([math.cos(angle), math.sin(angle), 0.0])
        most = 1e4 + rng.uniform(-0.2, 0.8)
        cover = cover.cut(range_of(anchor, 0.0, most))
        places = places[np.linalg.norm(places - anchor[:2], axis=-1) <= most]
        if len(places) == 0:
            break
        reach = np.max(places @ DIRECTIONS.T, axis=0)
        assert np.all(np.max(cover.supports[:, 0], axis=0) >= reach)
