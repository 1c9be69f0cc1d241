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
