# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Settings that do not fit the inputs are reported; clocks may differ by what is stated."""

import math

from circling import Circling
import numpy as np
import pytest
from sensing import add_odometry, add_ranges, anchors_at, new_localizer, ray
from shapes import holds

from dg_localization import Verdict
from dg_localization.fleet import OdometryErrorModel, RangeErrorModel
from dg_localization.fleet.rotations import yaw_of

PLACES_M = {'a': (0.0, 0.0), 'b': (10.0, 0.0), 'c': (0.0, 10.0), 'd': (10.0, 10.0)}
SMALL = OdometryErrorModel(
    translation_per_m=0.02, rotation_per_rad=0.02, constant_m=0.01, constant_rad=0.01
)


def localizer_of(**settings):
    known = {'range_error': (-0.05, 0.05, 0.0, 0.0), 'odometry_error': SMALL}
    return new_localizer(('r',), **{'anchors': PLACES_M, **known, **settings})


def measure(localizer, place, stamp_s, now_s, names='abcd'):
    targets_m = {name: PLACES_M[name] for name in names}
    add_ranges(localizer, 'r', place, targets_m, stamp_s, now_s=now_s)


def drive(localizer, x_m, stamp_s, now_s):
    add_odometry(localizer, 'r', (x_m, 0.0), stamp_s, now_s=now_s, frame='odom')


def input_of(localizer, kind, now_s):
    return next(s for s in localizer.input_states(now_s) if s.key.kind.value == kind)


@pytest.mark.parametrize('with_odometry', [False, True])
@pytest.mark.parametrize('ahead_s', [0.02, 0.05, 0.09])
def test_stamps_from_the_future_widen_answers_and_are_named(ahead_s, with_odometry):
    localizer = localizer_of(max_speed_m_s=1.01)
    for step in range(60):
        now_s = 100.0 + 0.1 * step
        place = np.array([1.0 + 0.1 * step, 4.0])
        if with_odometry:
            drive(localizer, place[0], now_s + ahead_s, now_s)
        measure(localizer, place, now_s + ahead_s, now_s, 'abcd'[step % 4])
        if step > 10:
            estimate = localizer.step(localizer.answer_time(now_s + 0.05))
            assert holds(estimate, np.array([1.0 + estimate.stamp_s - 100.0, 4.0]))
            assert 'in the future' in estimate.reason
    assert 'ahead of their arrival' in input_of(localizer, 'range', now_s).warning


def test_stamps_within_the_stated_error_are_no_warning():
    localizer = localizer_of(stamp_error_s=0.05)
    measure(localizer, (3.0, 4.0), 100.04, 100.0)
    assert input_of(localizer, 'range', 100.0).warning == ''
    assert 'future' not in localizer.step(100.05).reason


@pytest.mark.parametrize('speed_m_s', [0.3, 1.0])
@pytest.mark.parametrize('ranges_go_on', [True, False])
def test_silent_odometry_is_told_in_reason_point_and_covariance(speed_m_s, ranges_go_on):
    localizer = localizer_of(max_speed_m_s=1.05)
    for step in range(61):
        now_s = 100.0 + 0.1 * step
        place = np.array([1.0 + speed_m_s * 0.1 * step, 4.0])
        if step <= 50:
            drive(localizer, place[0], now_s, now_s)
        if step <= 50 or ranges_go_on:
            measure(localizer, place, now_s, now_s)
        if step > 53:
            estimate = localizer.step(now_s)
            assert holds(estimate, place)
            assert 'odometry of r is silent for' in estimate.reason
            (placement,) = estimate.placements
            off_m = np.abs(placement.positions_m[0] - place)
            assert np.all(off_m <= 3.0 * np.sqrt(np.diag(placement.covariances[0])[:2]))


@pytest.mark.parametrize('gap_s', [0.4, 1.0, 3.0, 8.0])
@pytest.mark.parametrize('driven_m', [0.3, 1.0, 3.0])
def test_a_driver_that_starts_again_at_zero_is_no_motion(gap_s, driven_m):
    localizer = localizer_of(max_speed_m_s=1.0)
    now_s, x_m = 100.0, 0.0
    while x_m < driven_m:
        now_s, x_m = now_s + 0.1, x_m + 0.06
        drive(localizer, x_m, now_s, now_s)
        measure(localizer, (2.0 + x_m, 5.0), now_s, now_s)
    localizer.step(now_s)
    now_s += gap_s
    drive(localizer, 0.0, now_s, now_s)
    assert 'started anew' in input_of(localizer, 'odometry', now_s).restart
    estimate = localizer.step(now_s)
    assert holds(estimate, np.array([2.0 + x_m, 5.0])) or not estimate.placements


def test_a_robot_that_passes_its_origin_has_not_started_again():
    localizer = localizer_of(max_speed_m_s=1.0)
    for step in range(40):
        now_s = 100.0 + 0.1 * step
        drive(localizer, 1.0 - 0.05 * step, now_s, now_s)
        assert input_of(localizer, 'odometry', now_s).restart == ''


@pytest.mark.parametrize(('gap_s', 'anew'), [(0.5, False), (3.0, True)])
def test_every_gap_can_be_made_a_restart(gap_s, anew):
    localizer = localizer_of(odometry_error={'restart_gap_s': 2.0})
    for now_s in (100.0, 100.1, 100.1 + gap_s):
        drive(localizer, 5.0 + 0.1 * now_s, now_s, now_s)
    assert bool(input_of(localizer, 'odometry', now_s).restart) is anew


@pytest.mark.parametrize(('up_m', 'away_m'), [(1.0, 4.0), (2.0, 3.0), (2.0, 1.5), (3.0, 1.0)])
def test_a_ray_that_points_above_the_plane_is_widened_and_told(up_m, away_m):
    half_width_rad, places = 0.05, {'t': (0.0, 0.0), 'e': (-8.0, -3.0), 'f': (3.0, -9.0)}
    localizer = localizer_of(anchors={**PLACES_M, **places}, bearing_half_width_rad=half_width_rad)
    place = np.array([0.0, -away_m])
    line = np.array([0.0, away_m, up_m]) / math.hypot(away_m, up_m)
    ray = math.cos(0.99 * half_width_rad) * line
    ray[0] = math.sin(0.99 * half_width_rad)
    for step in range(5):
        now_s = 100.0 + 0.1 * step
        measure(localizer, place, now_s, now_s)
        assert localizer.add_bearing('r', 't', ray, now_s, now_s) is None
        add_ranges(localizer, 'r', place, {name: places[name] for name in 'ef'}, now_s)
    estimate = localizer.step(now_s)
    assert 'not in the plane' in estimate.reason
    for placement in estimate.placements:
        x, _, z, w = placement.orientations_xyzw[0]
        if placement.heading_known[0]:
            assert abs(2.0 * math.atan2(z, w)) <= placement.heading_half_width_rad[0]


ANCHORS_M = {'a0': (0.0, 0.0), 'a1': (8.0, 0.0), 'a2': (3.0, 7.0)}


def driving(ahead_s=0.0, late_s=0.0, **settings):
    """Return a robot that drives in a circle at 0.4 m/s among anchors, by a clock of its own."""
    robot = Circling(
        1,
        anchors=anchors_at(ANCHORS_M),
        range_error=RangeErrorModel(-1e-4, 1e-4, 0.0, 0.0),
        max_speed_m_s=0.404,
        max_turn_rate_rad_s=0.505,
        odometry_error=OdometryErrorModel(1e-3, 0.0, 0.0, 1e-3),
        **settings,
    )
    robot.ahead_s, robot.late_s = ahead_s, late_s
    return robot


@pytest.mark.parametrize('odometry', [(), None])
@pytest.mark.parametrize('ahead_s', [-0.05, 0.05])
def test_the_truth_is_inside_with_clocks_as_wrong_as_is_stated(ahead_s, odometry):
    robot = driving(ahead_s, 0.05, stamp_error_s=0.05)
    for estimate in robot.drive(4.0, every_s=0.5, odometry=odometry):
        assert estimate.verdict is not Verdict.INFEASIBLE
        assert not estimate.forgotten
        assert robot.holding(estimate)


@pytest.mark.parametrize('odometry', [(), None])
def test_stamps_that_are_more_wrong_than_is_stated_are_noticed(odometry):
    """Late readings look new where the clock is ahead by as much."""
    robot = driving(0.2, 0.2, stamp_error_s=0.01)
    answers = robot.drive(4.0, every_s=0.5, odometry=odometry)
    assert not all(robot.holding(estimate) for estimate in answers)


@pytest.mark.parametrize('with_odometry', [False, True])
@pytest.mark.parametrize('ahead_s', [-0.05, 0.05])
def test_a_ray_with_the_stamp_of_the_answer_may_be_of_another_time(ahead_s, with_odometry):
    """A robot with a camera turns on the spot."""
    localizer = new_localizer(
        ('r',),
        anchors=ANCHORS_M,
        range_error=(-1e-3, 1e-3, 0.0, 0.0),
        bearing_half_width_rad=0.005,
        max_speed_m_s=0.0,
        max_turn_rate_rad_s=1.01,
        memory_s=0.0,
        stamp_error_s=0.05,
    )
    measured_s, stamp_s, now_s = 100.0, 100.0 + ahead_s, 100.05
    if with_odometry:
        add_odometry(localizer, 'r', (0.0, 0.0), stamp_s, measured_s, now_s)
    add_ranges(localizer, 'r', (3.0, 3.0), ANCHORS_M, stamp_s, now_s=now_s)
    for name, anchor_m in ANCHORS_M.items():
        seen = ray((3.0, 3.0), anchor_m, measured_s)
        assert localizer.add_bearing('r', name, seen, stamp_s, now_s) is None
    (placement,) = localizer.step(stamp_s).placements
    off_rad = math.remainder(yaw_of(placement.orientations_xyzw[0]) - stamp_s, math.tau)
    assert abs(off_rad) <= placement.heading_half_width_rad[0] < 0.15


def test_where_clocks_are_right_nothing_is_widened():
    widths_m = []
    for robot in (driving(), driving(stamp_error_s=0.02)):
        *_, estimate = robot.drive(4.0)
        widths_m.append(np.ptp(estimate.placements[0].enclosure_m[0], axis=0))
    assert np.all(widths_m[0] < 0.1)
    assert np.all(widths_m[0] < widths_m[1]) and np.all(widths_m[1] < 0.5)
