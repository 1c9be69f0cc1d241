# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Stated and measured elevations, and how they turn ranges in space into distances."""

from fractions import Fraction
import math

from hypothesis import given, strategies as st
import numpy as np
import pytest
from sensing import add_odometry, add_ranges, new_localizer
from shapes import holds

from dg_localization import Verdict
from dg_localization.fleet import (
    ElevationErrorModel,
    LinkKey,
    LinkKind,
    Mount,
    RejectionReason,
    SensorBounds,
)
from dg_localization.fleet.elevations import distance_in_plane_m, squared_rise_m2

NOW_S = 5.0
PLACES = {'a': (0.0, 0.0), 'b': (6.0, 0.0), 'c': (0.0, 6.0)}
PLACE_M = (2.0, 3.0)
KEY = LinkKey(LinkKind.ELEVATION, 'r', '')


def make(**settings):
    """Return a localizer of a robot that flies anywhere up to 20 m above three anchors."""
    defaults = {
        'anchors': PLACES,
        'elevations_m': {'r': (0.0, 20.0)},
        'elevation_error': ElevationErrorModel(-0.1, 0.1),
        'range_error': (-0.001, 0.001, 0.0, 0.0),
        'max_speed_m_s': 2.0,
    }
    return new_localizer(['r'], **(defaults | settings))


def measure(localizer, height_m, stamp_s=NOW_S, now_s=NOW_S, place_m=PLACE_M, sensor='r'):
    """Add the ranges to all anchors of a robot at a height."""
    anchors_m = {name: (*anchor_m, 0.0) for name, anchor_m in PLACES.items()}
    add_ranges(localizer, sensor, (*place_m, height_m), anchors_m, stamp_s, now_s=now_s)


def enclosure_of(localizer, now_s=NOW_S):
    """Return the width of the widest placement; the robot truly is in one."""
    estimate = localizer.step(now_s)
    assert holds(estimate, PLACE_M)
    return max(np.ptp(placement.enclosure_m[0], axis=0).max() for placement in estimate.placements)


# Their squares neither overflow nor underflow, so that the root below is right to 1e-15 of it.
sizes = st.floats(1e-100, 1e-99) | st.floats(1e-3, 1e6) | st.floats(1e99, 1e100) | st.just(0.0)
numbers = st.builds(lambda size, sign: sign * size, sizes, st.sampled_from([-1.0, 1.0]))


@given(numbers, numbers, numbers, numbers, numbers, numbers)
def test_the_distance_in_the_plane_is_inside_its_bounds(x, y, first, second, wider, narrower):
    """Exact distances of exact points, in rational numbers."""
    horizontal = Fraction(x) ** 2 + Fraction(y) ** 2
    squared = horizontal + (Fraction(first) - Fraction(second)) ** 2
    apart_m = math.sqrt(float(squared))
    distance_m = (apart_m * (1.0 - 1e-9), apart_m * (1.0 + 1e-9))
    one = (min(first, narrower), max(first, narrower))
    other = (min(second, wider), max(second, wider))
    lower_m, upper_m = distance_in_plane_m(distance_m, squared_rise_m2(one, other))
    assert Fraction(lower_m) ** 2 <= horizontal
    assert upper_m >= 0.0 and horizontal <= Fraction(upper_m) ** 2


def test_a_range_shorter_than_the_rise_contradicts_it():
    assert distance_in_plane_m((2.8, 2.9), squared_rise_m2((0.0, 0.0), (3.0, 3.5)))[1] < 0.0
    localizer = make(elevations_m={'r': (3.0, 3.5)})
    localizer.add_range('r', 'a', 2.9, NOW_S, NOW_S)
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is Verdict.INFEASIBLE
    assert [str(key) for key in estimate.conflicts[0]] == ['range r->a']


def test_a_reading_narrows_what_is_stated():
    stated = make()
    measure(stated, 8.0)
    read = make()
    assert read.add_elevation('r', 8.05, NOW_S, NOW_S) is None
    measure(read, 8.0)
    assert enclosure_of(read) < 0.3 * enclosure_of(stated)
    (state,) = (state for state in read.input_states(NOW_S) if state.key == KEY)
    assert state.accepted == 1 and state.in_use


@pytest.mark.parametrize('after_s', [-0.4, 0.4])
@pytest.mark.parametrize('speed_m_s', [-2.0, 2.0])
def test_a_reading_of_another_time_is_widened_by_how_far_it_can_climb(after_s, speed_m_s):
    localizer = make()
    localizer.add_elevation('r', 8.0, NOW_S, NOW_S)
    stamp_s = NOW_S + after_s
    now_s = max(NOW_S, stamp_s)
    measure(localizer, 8.0 + 0.999 * speed_m_s * after_s + 0.099, stamp_s, now_s)
    enclosure_of(localizer, now_s)


@pytest.mark.parametrize('after_s', [1.5, -1.5])
def test_a_reading_of_another_time_counts_no_more(after_s):
    """A reading from the future does not count either, after the clock was set back."""
    localizer = make(max_speed_m_s=0.0, max_age_s=1.0)
    localizer.add_elevation('r', 8.0, NOW_S, NOW_S)
    measure(localizer, 12.0, NOW_S + after_s, NOW_S + after_s)
    enclosure_of(localizer, NOW_S + after_s)


def test_readings_that_contradict_each_other_count_neither():
    localizer = make()
    assert localizer.add_elevation('r', 3.0, NOW_S, NOW_S) is None
    rejection = localizer.add_elevation('r', 8.0, NOW_S, NOW_S)
    assert rejection.reason is RejectionReason.INVALID_ELEVATION
    assert '8.0 m contradicts what is known: 2.900 to 3.100 m' in str(rejection)
    for height_m in (3.0, 8.0, 15.0):
        measure(localizer, height_m)
        enclosure_of(localizer)
        localizer.reset()
    localizer.add_elevation('r', 3.0, NOW_S, NOW_S)
    localizer.add_elevation('r', 8.0, NOW_S, NOW_S)
    assert localizer.add_elevation('r', 8.0, NOW_S, NOW_S) is None
    measure(localizer, 8.0)
    assert enclosure_of(localizer) < 1.0


@pytest.mark.parametrize(
    ('point', 'value', 'reason', 'text'),
    [
        ('r', 25.0, RejectionReason.INVALID_ELEVATION, '0.000 to 20.000 m'),
        ('r', math.nan, RejectionReason.INVALID_ELEVATION, 'a finite number of meters'),
        ('r', 'high', RejectionReason.INVALID_ELEVATION, "'high'"),
        ('a', 1.0, RejectionReason.INVALID_ELEVATION, "'a' has no stated elevation"),
        ('x', 1.0, RejectionReason.UNKNOWN_ROBOT, "'x'"),
    ],
)
def test_what_is_no_elevation_is_rejected(point, value, reason, text):
    localizer = make()
    rejection = localizer.add_elevation(point, value, NOW_S, NOW_S)
    assert rejection.reason is reason
    assert text in str(rejection)
    measure(localizer, 8.0)
    enclosure_of(localizer)


@pytest.mark.parametrize('stamp_s', [0.0, math.nan, NOW_S - 2.0, NOW_S + 1.0])
def test_a_reading_without_a_time_is_rejected(stamp_s):
    assert make().add_elevation('r', 8.0, stamp_s, NOW_S) is not None


def test_readings_have_error_bounds_of_their_own():
    own = SensorBounds(elevation_error=ElevationErrorModel(0.0, 2.0))
    localizer = new_localizer('rs', elevations_m={'r': (0.0, 20.0), 's': (0.0, 20.0)})
    localizer.add_elevation('s', 10.0, NOW_S, NOW_S, own)
    assert localizer.add_elevation('s', 8.0, NOW_S, NOW_S, own) is None
    assert '8.000 to 8.000' in str(localizer.add_elevation('s', 10.5, NOW_S, NOW_S, own))
    assert localizer.add_elevation('r', 10.0, NOW_S, NOW_S) is None
    assert '9.500 to 10.500' in str(localizer.add_elevation('r', 12.0, NOW_S, NOW_S))


@pytest.mark.parametrize('sensor', ['r', 'r/left'])
def test_ranges_from_above_are_remembered(sensor):
    """A robot that drives ahead is ranged from 3 m above: the memory gives its heading."""
    half_widths_rad = {}
    for memory_s in (0.0, 30.0):
        localizer = make(
            mounts={'r': {'left': Mount((0.4, 0.2))}},
            elevations_m=dict.fromkeys(PLACES, (3.0, 3.0)),
            range_error=(-0.02, 0.02, 0.0, 0.0),
            max_speed_m_s=0.5,
            memory_s=memory_s,
            memory_max_seconds=math.inf,
        )
        for tick in range(12):
            now_s = NOW_S + 0.5 * tick
            position_m = np.array([1.0 + 0.2 * tick, 3.0])
            add_odometry(localizer, 'r', position_m, now_s)
            tag_m = position_m + ([0.4, 0.2] if '/' in sensor else [0.0, 0.0])
            # As far as it is from anchors 3 m above it.
            measure(localizer, 3.0, now_s, now_s, tag_m, sensor)
            estimate = localizer.step(now_s)
            assert estimate.forgotten == ()
        (placement,) = estimate.placements
        assert holds(estimate, position_m)
        half_widths_rad[memory_s] = placement.heading_half_width_rad[0]
        known = placement.heading_known[0]
    assert known and half_widths_rad[30.0] < 0.5 < half_widths_rad[0.0]
