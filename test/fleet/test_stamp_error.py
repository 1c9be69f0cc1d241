# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Clocks of robots differ: what they stamp was true a little earlier or later."""

import math

import numpy as np
import pytest
from sensing import add_odometry, add_ranges, new_localizer, ray
from shapes import holds

from dg_localization import Verdict
from dg_localization.fleet.rotations import yaw_of

ANCHORS_M = {'a0': (0.0, 0.0), 'a1': (8.0, 0.0), 'a2': (3.0, 7.0)}
SPEED_M_S, CIRCLE_M = 1.0, 1.0


class Circling:
    """
    A robot that drives in a circle among anchors, with a clock of its own.

    What it says arrives late: where its clock is ahead by as much, it looks new.
    """

    def __init__(self, ahead_s, with_odometry, **settings):
        self.ahead_s = ahead_s
        self.with_odometry = with_odometry
        self.localizer = new_localizer(
            ('r',),
            anchors=ANCHORS_M,
            range_error=(-1e-4, 1e-4, 0.0, 0.0),
            max_speed_m_s=1.01 * SPEED_M_S,
            max_turn_rate_rad_s=1.01 * SPEED_M_S / CIRCLE_M,
            odometry_error=(1e-3, 0.0, 0.0, 1e-3),
            memory_max_seconds=math.inf,
            solver={'resolution': 0.2, 'max_boxes': 60},
            **settings,
        )

    def pose(self, time_s):
        angle = SPEED_M_S / CIRCLE_M * time_s
        x, y = 3.0 + CIRCLE_M * math.cos(angle), 3.0 + CIRCLE_M * math.sin(angle)
        return np.array([x, y]), angle + 0.5 * math.pi

    def drive(self, seconds, late_s=0.05, since_s=100.0):
        """Yield times and estimates."""
        for tick in range(round(seconds / 0.05) + 1):
            time_s = since_s + 0.05 * tick
            measured_s = time_s - late_s
            place, yaw = self.pose(measured_s)
            stamp_s = measured_s + self.ahead_s
            if self.with_odometry:
                add_odometry(self.localizer, 'r', place, stamp_s, yaw, time_s)
            due = dict([*ANCHORS_M.items()][tick % 7 : tick % 7 + 1])
            add_ranges(self.localizer, 'r', place, due, stamp_s, now_s=time_s)
            if tick % 10 == 9:
                yield time_s, self.localizer.step(time_s)


@pytest.mark.parametrize('with_odometry', [False, True])
@pytest.mark.parametrize('ahead_s', [-0.05, 0.05])
def test_the_truth_is_inside_with_clocks_as_wrong_as_is_stated(ahead_s, with_odometry):
    robot = Circling(ahead_s, with_odometry, stamp_error_s=0.05)
    for time_s, estimate in robot.drive(4.0):
        assert estimate.verdict is not Verdict.INFEASIBLE
        assert not estimate.forgotten
        assert holds(estimate, robot.pose(time_s)[0]), time_s


@pytest.mark.parametrize('with_odometry', [False, True])
def test_stamps_that_are_more_wrong_than_is_stated_are_noticed(with_odometry):
    robot = Circling(0.2, with_odometry, stamp_error_s=0.01)
    answers = list(robot.drive(4.0, late_s=0.2))
    assert not all(holds(estimate, robot.pose(time_s)[0]) for time_s, estimate in answers)


def turning(**settings):
    """Return a localizer of a robot that turns on the spot among anchors, with a camera."""
    return new_localizer(
        ('r',),
        anchors=ANCHORS_M,
        range_error=(-1e-3, 1e-3, 0.0, 0.0),
        bearing_half_width_rad=0.005,
        max_speed_m_s=0.0,
        max_turn_rate_rad_s=1.01,
        memory_s=0.0,
        **settings,
    )


@pytest.mark.parametrize('with_odometry', [False, True])
@pytest.mark.parametrize('ahead_s', [-0.05, 0.05])
def test_a_ray_with_the_stamp_of_the_answer_may_be_of_another_time(ahead_s, with_odometry):
    localizer = turning(stamp_error_s=0.05)
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
    robot, vague = Circling(0.0, True), Circling(0.0, True, stamp_error_s=0.02)
    *_, (_, known) = robot.drive(4.0, late_s=0.0)
    *_, (_, wide) = vague.drive(4.0, late_s=0.0)
    widths_m = [np.ptp(e.placements[0].enclosure_m[0], axis=0) for e in (known, wide)]
    assert np.all(widths_m[0] < 0.1)
    assert np.all(widths_m[0] < widths_m[1]) and np.all(widths_m[1] < 0.5)
