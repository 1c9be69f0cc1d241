# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Without anchors the frame is the odometry frame of the reference robot, while that is known."""

from itertools import permutations
import math

import numpy as np
import pytest

from dg_localization import SolverOptions
from dg_localization.fleet import FleetConfig, Localizer, OdometryErrorModel, RangeErrorModel

START_S = 100.0
TICK_S = 0.1
ROBOTS = ('robot_1', 'robot_2', 'robot_3')
CENTERS_M = np.array([[0.0, 0.0], [4.0, 0.5], [1.5, 3.5]])
RADII_M = np.array([0.8, 0.6, 1.0])
RATES = np.array([0.5, -0.8, 0.6])
ORIGIN_M, TURN_RAD = np.array([20.0, -7.0]), 2.2
"""Where the odometry frames lie in the world, and how they are turned."""


def unturned(yaw_rad):
    return [0.0, 0.0, math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)]


def rotation(angle_rad):
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


class Circling:
    """Robots that drive in circles, and a localizer that hears them."""

    def __init__(self, **settings):
        defaults = {
            'range_error': RangeErrorModel(min_error_relative=-0.01, max_error_relative=0.01),
            'bearing_half_width_rad': 0.02,
            'odometry_error': OdometryErrorModel(translation_per_m=0.02, rotation_per_rad=0.02),
            'max_age_s': 0.5,
            'memory_max_seconds': math.inf,
            'solver': SolverOptions(max_boxes=200),
        }
        self.localizer = Localizer(FleetConfig(robots=ROBOTS, **{**defaults, **settings}))
        self.names = {robot: f'{robot}/odom' for robot in ROBOTS}
        self.shift_m = np.zeros(2)
        self.scale = 1.0
        self.time_s = 0.0

    @property
    def now_s(self):
        return START_S + self.time_s

    def truth(self):
        """Return positions (n, 2) and yaws (n,) in the odometry frames, which do not drift."""
        angles = RATES * self.time_s + np.arange(len(ROBOTS))
        around = RADII_M[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        yaws = angles + np.sign(RATES) * 0.5 * math.pi
        return (CENTERS_M + around) @ rotation(TURN_RAD).T + ORIGIN_M, yaws + TURN_RAD

    def drive(self, seconds, *, bearings=True, odometry=ROBOTS):
        """Drive on, measuring; yield an estimate twice a second."""
        for tick in range(1, round(seconds / TICK_S) + 1):
            self.time_s += TICK_S
            places, yaws = self.truth()
            now_s = self.now_s
            for robot in odometry:
                row = ROBOTS.index(robot)
                place = [*((places[row] + self.shift_m) / self.scale), 0.0]
                rejection = self.localizer.add_odometry(
                    robot, place, unturned(yaws[row]), now_s, now_s, self.names[robot]
                )
                assert rejection is None
            for i, j in permutations(range(len(ROBOTS)), 2):
                gap = places[j] - places[i]
                self.localizer.add_range(
                    ROBOTS[i], ROBOTS[j], float(np.linalg.norm(gap)), now_s, now_s
                )
                if bearings:
                    ray = [*(rotation(-yaws[i]) @ gap), 0.0]
                    self.localizer.add_bearing(ROBOTS[i], ROBOTS[j], ray, now_s, now_s)
            if tick % 5 == 0:
                yield self.localizer.step(now_s)

    def holds(self, placement):
        """Return whether the truth lies in a placement in an odometry frame."""
        places, yaws = self.truth()
        low, high = placement.enclosure_m[:, 0] - 1e-9, placement.enclosure_m[:, 1] + 1e-9
        known = placement.heading_known
        z, w = placement.orientations_xyzw[known, 2:].T
        off = np.abs(np.remainder(2.0 * np.arctan2(z, w) - yaws[known] + math.pi, 2.0 * math.pi))
        return bool(
            np.all((low <= places) & (places <= high))
            and np.all(np.abs(off - math.pi) <= placement.heading_half_width_rad[known] + 1e-9)
        )


def test_the_frame_is_that_of_the_odometry_and_stands_still():
    fleet = Circling()
    for estimate in fleet.drive(5.0):
        assert (estimate.frame.kind, estimate.frame.points) == ('odometry', ('robot_1',))
        assert estimate.frame.name == 'robot_1/odom'
        assert str(estimate.frame) == 'odometry frame robot_1/odom of robot_1'
        assert not estimate.frame_change
        (placement,) = estimate.placements
        assert fleet.holds(placement)
        assert placement.heading_known.all()
        assert np.all(np.ptp(placement.enclosure_m, axis=1) < 1.0)


def test_in_the_frame_a_robot_is_where_its_messages_say_however_they_are_scaled():
    error = OdometryErrorModel(
        translation_per_m=0.02, rotation_per_rad=0.02, translation_scale=0.8
    )
    fleet = Circling(odometry_error=error)
    fleet.scale = 0.8
    for estimate in fleet.drive(5.0):
        assert estimate.frame.name == 'robot_1/odom'
        (placement,) = estimate.placements
        places, _ = fleet.truth()
        # The newest odometry states where the robot is; all else is as far from it as it truly is.
        shifted = places + places[0] / 0.8 - places[0]
        low, high = placement.enclosure_m[:, 0] - 1e-9, placement.enclosure_m[:, 1] + 1e-9
        assert np.all((low <= shifted) & (shifted <= high))
        assert np.ptp(placement.enclosure_m[0], axis=0).max() < 1e-6


def test_coordinates_do_not_jump_when_the_bearings_stop():
    fleet = Circling()
    *_, last = fleet.drive(5.0)
    # The robots go on to range each other; with what they remember that is enough.
    for estimate in fleet.drive(40.0, bearings=False):
        assert estimate.frame == last.frame
        (placement,) = estimate.placements
        assert fleet.holds(placement)
        step_m = placement.positions_m - last.placements[0].positions_m
        assert np.abs(step_m).max() < 0.7
        last = estimate


def test_the_frame_does_not_come_and_go_with_the_odometry():
    fleet = Circling(max_age_s=0.3)
    assert [e.frame.kind for e in fleet.drive(1.0)] == ['odometry', 'odometry']
    for _ in range(8):
        for odometry in (ROBOTS, ROBOTS[1:]):
            (estimate,) = fleet.drive(0.5, odometry=odometry)
            assert estimate.frame.kind == 'odometry' and estimate.frame_changes == 0
            assert all(fleet.holds(placement) for placement in estimate.placements)
    # Two seconds without it are too many, and two with it bring it back.
    kinds = [e.frame.kind for e in fleet.drive(3.0, odometry=ROBOTS[1:])]
    assert kinds == ['odometry'] * 3 + ['heading'] * 3
    estimates = list(fleet.drive(3.0))
    assert [e.frame.kind for e in estimates[:4]] == ['heading'] * 4
    assert estimates[-1].frame.kind == 'odometry' and estimates[-1].frame_changes == 2


@pytest.mark.parametrize('name', ['odom', ''])
def test_a_frame_is_kept_for_two_seconds_without_a_heading(name):
    fleet = Circling(memory_s=0.0)
    fleet.names = dict.fromkeys(ROBOTS, name)
    *_, before = fleet.drive(2.0)
    kinds, changes = [], 0
    for estimate in fleet.drive(4.0, bearings=False):
        kinds.append(str(estimate.frame.kind))
        changes += bool(estimate.frame_change)
        if name and estimate.frame == before.frame:
            assert any(fleet.holds(placement) for placement in estimate.placements)
            off_m = [
                np.abs(one.positions_m - fleet.truth()[0]).max() for one in estimate.placements
            ]
            assert min(off_m) < 1.0
    assert kinds == [str(before.frame.kind)] * 4 + ['robots'] * 4
    assert changes == estimate.frame_changes == 1


def test_odometry_that_starts_anew_has_another_frame():
    fleet = Circling()
    *_, before = fleet.drive(2.0)
    fleet.shift_m = np.array([30.0, 0.0])
    estimates = list(fleet.drive(4.0))
    changes = [e.frame_change for e in estimates if e.frame_change]
    assert {e.frame.kind for e in estimates[:3]} == {'heading'}
    assert {e.frame.kind for e in estimates[5:]} == {'odometry'}
    assert len(changes) == 2
    name = 'odometry frame robot_1/odom of robot_1'
    assert f'{name}, started anew at {START_S + 2.1:.3f} s now' in changes[1]
    assert estimates[-1].frame != before.frame
    assert estimates[-1].placements[0].positions_m[0] == pytest.approx(
        fleet.truth()[0][0] + fleet.shift_m, abs=0.2
    )


@pytest.mark.parametrize(('tilt_rad', 'kind'), [(0.15, 'odometry'), (0.25, 'heading')])
def test_a_tilted_odometry_frame_does_not_fit_the_plane(tilt_rad, kind):
    localizer = Localizer(FleetConfig(robots=('a', 'b')))
    orientation = [math.sin(tilt_rad / 2.0), 0.0, 0.0, math.cos(tilt_rad / 2.0)]
    localizer.add_odometry('a', [1.0, 2.0, 3.0], orientation, START_S, START_S, 'odom')
    localizer.add_range('a', 'b', 3.0, START_S, START_S)
    localizer.add_bearing('a', 'b', [1.0, 0.0, 0.0], START_S, START_S)
    assert localizer.step(START_S).frame.kind == kind


def test_old_odometry_widens_the_answer():
    widths_m = []
    for age_s in (0.0, 0.2):
        localizer = Localizer(
            FleetConfig(robots=('a', 'b'), max_speed_m_s=0.5, max_turn_rate_rad_s=1.0)
        )
        now_s = START_S + age_s
        localizer.add_odometry('a', [1.0, 2.0, 0.0], unturned(0.5), START_S, START_S, 'odom')
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
