# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Without anchors the frame is the odometry frame of the reference robot, while that is known."""

import math

from circling import START_S, Circling
import numpy as np
import pytest
from sensing import add_odometry, new_localizer
from shapes import holds

from dg_localization.fleet import OdometryErrorModel


def circling(**settings):
    defaults = {'odometry_frame': 'odom', 'cameras': True, 'bearing_half_width_rad': 0.02}
    return Circling(3, **{**defaults, 'max_age_s': 0.5, **settings})


def drive(fleet, seconds, **measured):
    return fleet.drive(seconds, every_s=0.5, **measured)


def test_the_frame_is_that_of_the_odometry_and_stands_still():
    fleet = circling()
    for estimate in drive(fleet, 5.0):
        assert (estimate.frame.kind, estimate.frame.points) == ('odometry', ('r0',))
        assert str(estimate.frame) == 'odometry frame odom of r0'
        assert not estimate.frame_change
        (placement,) = fleet.holding(estimate)
        assert placement.heading_known.all()
        assert np.all(np.ptp(placement.enclosure_m, axis=1) < 1.0)


def test_in_the_frame_a_robot_is_where_its_messages_say_however_they_are_scaled():
    error = OdometryErrorModel(
        translation_per_m=0.02, rotation_per_rad=0.02, translation_scale=0.8
    )
    fleet = circling(odometry_error=error)
    fleet.scale = 0.8
    for estimate in drive(fleet, 5.0):
        assert estimate.frame.name == 'odom'
        places, _ = fleet.poses()
        # The newest odometry states where the robot is; all else is as far from it as it truly is.
        assert holds(estimate, places + places[0] / 0.8 - places[0])
        (placement,) = estimate.placements
        assert np.ptp(placement.enclosure_m[0], axis=0).max() < 1e-6


def test_coordinates_do_not_jump_when_the_bearings_stop():
    fleet = circling()
    *_, last = drive(fleet, 5.0)
    # The robots go on to range each other; with what they remember that is enough.
    for estimate in drive(fleet, 40.0, bearings=False):
        assert estimate.frame == last.frame
        (placement,) = fleet.holding(estimate)
        step_m = placement.positions_m - last.placements[0].positions_m
        assert np.abs(step_m).max() < 0.7
        last = estimate


def test_the_frame_does_not_come_and_go_with_the_odometry():
    fleet = circling(max_age_s=0.3)
    assert [e.frame.kind for e in drive(fleet, 1.0)] == ['odometry', 'odometry']
    for _ in range(8):
        for odometry in (None, ('r1', 'r2')):
            (estimate,) = drive(fleet, 0.5, odometry=odometry)
            assert estimate.frame.kind == 'odometry' and estimate.frame_changes == 0
            assert fleet.holding(estimate)
    # Two seconds without it are too many, and two with it bring it back.
    kinds = [e.frame.kind for e in drive(fleet, 3.0, odometry=('r1', 'r2'))]
    assert kinds == ['odometry'] * 2 + ['heading'] * 4
    estimates = list(drive(fleet, 3.0))
    assert [e.frame.kind for e in estimates[:4]] == ['heading'] * 4
    assert estimates[-1].frame.kind == 'odometry' and estimates[-1].frame_changes == 2


@pytest.mark.parametrize('name', ['odom', ''])
def test_a_frame_is_kept_for_two_seconds_without_a_heading(name):
    fleet = circling(memory_s=0.0, odometry_frame=name)
    *_, before = drive(fleet, 2.0)
    kinds, changes = [], 0
    for estimate in drive(fleet, 4.0, bearings=False):
        kinds.append(str(estimate.frame.kind))
        changes += bool(estimate.frame_change)
        if name and estimate.frame == before.frame:
            off_m = [
                np.abs(p.positions_m - fleet.poses()[0]).max() for p in fleet.holding(estimate)
            ]
            assert min(off_m) < 1.0
    assert kinds == [str(before.frame.kind)] * 4 + ['robots'] * 4
    assert changes == estimate.frame_changes == 1


def test_odometry_that_starts_anew_has_another_frame():
    fleet = circling()
    *_, before = drive(fleet, 2.0)
    fleet.started_m = np.array([30.0, 0.0])
    estimates = list(drive(fleet, 4.0))
    changes = [e.frame_change for e in estimates if e.frame_change]
    assert {e.frame.kind for e in estimates[:3]} == {'heading'}
    assert {e.frame.kind for e in estimates[5:]} == {'odometry'}
    assert len(changes) == 2
    assert f'frame odom of r0, started anew at {START_S + 2.25:.3f} s now' in changes[1]
    assert estimates[-1].frame != before.frame
    assert estimates[-1].placements[0].positions_m[0] == pytest.approx(
        fleet.poses()[0][0] + fleet.started_m, abs=0.2
    )


@pytest.mark.parametrize(('tilt_rad', 'kind'), [(0.15, 'odometry'), (0.25, 'heading')])
def test_a_tilted_odometry_frame_does_not_fit_the_plane(tilt_rad, kind):
    localizer = new_localizer(('a', 'b'))
    orientation = [math.sin(tilt_rad / 2.0), 0.0, 0.0, math.cos(tilt_rad / 2.0)]
    localizer.add_odometry('a', [1.0, 2.0, 3.0], orientation, START_S, START_S, 'odom')
    localizer.add_range('a', 'b', 3.0, START_S, START_S)
    localizer.add_bearing('a', 'b', [1.0, 0.0, 0.0], START_S, START_S)
    assert localizer.step(START_S).frame.kind == kind


def test_late_odometry_may_state_where_the_robot_was_or_will_be():
    localizer = new_localizer(
        ('a', 'b'), max_speed_m_s=0.5, odometry_error=OdometryErrorModel(latency_s=0.2)
    )
    add_odometry(localizer, 'a', (1.0, 2.0), START_S, frame='odom')
    localizer.add_range('a', 'b', 3.0, START_S, START_S)
    localizer.add_bearing('a', 'b', [1.0, 0.0, 0.0], START_S, START_S)
    (placement,) = localizer.step(START_S).placements
    assert np.all(np.ptp(placement.enclosure_m[0], axis=0) >= 2 * 0.5 * 0.2)


def test_old_odometry_widens_the_answer():
    widths_m = []
    for age_s in (0.0, 0.2):
        localizer = new_localizer(('a', 'b'), max_speed_m_s=0.5, max_turn_rate_rad_s=1.0)
        now_s = START_S + age_s
        add_odometry(localizer, 'a', (1.0, 2.0), START_S, 0.5, frame='odom')
        localizer.add_range('a', 'b', 3.0, now_s, now_s)
        localizer.add_bearing('a', 'b', [1.0, 0.0, 0.0], now_s, now_s)
        localizer.add_bearing('b', 'a', [1.0, 0.0, 0.0], now_s, now_s)
        estimate = localizer.step(now_s)
        (placement,) = estimate.placements
        assert estimate.frame.kind == 'odometry'
        assert age_s + 0.05 < placement.heading_half_width_rad[1] < age_s + 0.3
        assert placement.heading_half_width_rad[0] == pytest.approx(age_s, abs=1e-6)
        assert np.ptp(placement.enclosure_m[0], axis=0) == pytest.approx(2 * 0.5 * age_s)
        assert placement.positions_m[0] == pytest.approx([1.0, 2.0])
        covariance = placement.covariances[0]
        assert covariance[5, 5] == pytest.approx(age_s**2, abs=1e-6)
        assert np.diag(covariance)[:2] == pytest.approx((0.5 * age_s) ** 2, abs=1e-6)
        along = [math.cos(0.5), math.sin(0.5)]
        assert placement.positions_m[1] == pytest.approx(
            [1.0 + 3.0 * along[0], 2.0 + 3.0 * along[1]], abs=0.1
        )
        widths_m.append(np.ptp(placement.enclosure_m[1], axis=0).max())
    assert widths_m[1] > widths_m[0] + 2 * 3.0 * math.cos(0.5) * 0.19
