# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds of motion hold exactly, in rational arithmetic."""

from fractions import Fraction

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from dg_localization.fleet.motion import Motion
from dg_localization.fleet.vocabulary import OdometryReading

coordinate = st.floats(-1e6, 1e6)
positions = st.tuples(coordinate, coordinate, coordinate)


def motion_of(*readings, relative_error=0.0, speed=1e9):
    return Motion({'a': speed}, 1.0, relative_error, {'a': readings})


@settings(deadline=None)
@given(start=positions, end=positions)
def test_the_displacement_is_never_below_the_exact_distance(start, end):
    readings = [
        OdometryReading(stamp_s, np.array(position), np.eye(3))
        for stamp_s, position in ((1.0, start), (2.0, end))
    ]
    bound = Fraction(motion_of(*readings, speed=1e9).displacement_m('a', 1.0, 2.0))
    exact = sum((Fraction(x) - Fraction(y)) ** 2 for x, y in zip(start, end, strict=True))
    assert bound**2 >= min(exact, Fraction(10**18))


def test_a_point_that_cannot_move_has_no_displacement():
    still = Motion({'p': 0.0}, 1.0, 0.1, {})
    assert still.displacement_m('p', 1.0, 5.0) == 0.0


def test_odometry_bounds_a_turn_by_its_error():
    readings = [OdometryReading(stamp_s, np.zeros(3), np.eye(3)) for stamp_s in (1.0, 3.0)]
    _, half_width_rad = motion_of(*readings, relative_error=0.1).turn('a', 1.0, 3.0)
    assert half_width_rad == pytest.approx(0.2)
    assert half_width_rad > 0.2


def test_a_robot_may_move_at_full_speed_before_and_after_its_odometry():
    readings = [OdometryReading(stamp_s, np.zeros(3), np.eye(3)) for stamp_s in (2.0, 3.0)]
    motion = motion_of(*readings, speed=2.0)
    assert motion.displacement_m('a', 2.0, 3.0) == pytest.approx(0.0)
    assert 2.0 <= motion.displacement_m('a', 1.0, 3.0) == pytest.approx(2.0)
    assert 2.0 <= motion.displacement_m('a', 2.0, 4.0) == pytest.approx(2.0)


def test_a_body_that_turns_left_sees_a_fixed_direction_turn_right():
    c, s = np.cos(0.3), np.sin(0.3)
    left = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    readings = [OdometryReading(1.0, np.zeros(3), np.eye(3))]
    readings += [OdometryReading(2.0, np.zeros(3), left)]
    rotation, _ = motion_of(*readings).turn('a', 1.0, 2.0)
    assert rotation @ [1.0, 0.0, 0.0] == pytest.approx([c, -s, 0.0])
