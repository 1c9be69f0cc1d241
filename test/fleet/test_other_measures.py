# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Elevations, which turn ranges in space into distances, and range differences of anchors.

A robot is placed by how much nearer some anchors are than others.
"""

from fractions import Fraction
import math
import os

from habits import listen
from histories import History, play_without_a_loss, ticks_of
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from sensing import add_odometry, add_ranges, new_localizer
from shapes import holds, in_space, missing, turn

from dg_localization import Verdict
from dg_localization.fleet import (
    DifferenceErrorModel,
    ElevationErrorModel,
    LinkKey,
    LinkKind,
    Mount,
    OdometryErrorModel,
    RejectionReason,
    SensorBounds,
)
from dg_localization.fleet.elevations import distance_in_plane_m, squared_rise_m2
from dg_localization.fleet.rotations import yaw_of

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


STEPS = int(os.environ.get('DG_HISTORY_STEPS', '240'))
SECONDS = 8.0
ANCHORS_M = {'a': (-6.0, -4.0), 'b': (6.0, -5.0), 'c': (5.0, 6.0), 'd': (-5.0, 5.0)}
TAG_M = (0.3, 0.2)
ERROR_M = 0.1


@settings(max_examples=max(1, STEPS // round(SECONDS)), derandomize=False)
@given(seed=st.integers(0, 2**32 - 1), dimension=st.sampled_from([2, 3]))
def test_the_truth_is_never_lost_where_nothing_else_is_measured(seed, dimension):
    kind = 1 + seed % 3 // 2, 3 + seed % 4, SECONDS, seed % 2, dimension
    history = History.draw([seed, 21], *kind, ranged=False)
    listen(history, np.random.default_rng([seed, 22]))
    play_without_a_loss(history, ticks_of(history, SECONDS))


class Listener:
    """A robot that circles among anchors: right odometry, and differences at their bounds."""

    def __init__(self, dimension=2, places_m=ANCHORS_M, height_m=0.0, stated_m=ERROR_M, **given):
        self.places_m = {name: in_space(place_m) for name, place_m in places_m.items()}
        self.localizer = new_localizer(
            'r',
            {name: place_m[:dimension] for name, place_m in self.places_m.items()},
            dimension=dimension,
            mounts={'r': {'tag': in_space(TAG_M)[:dimension]}},
            range_difference_error=DifferenceErrorModel(-stated_m, stated_m),
            odometry_error=OdometryErrorModel(0.01, 0.0, 0.005, 0.01, 0.002, 0.002, tilt_rad=0.0),
            **given,
        )
        self.height_m, self.rng = height_m, np.random.default_rng(7)

    def pose(self, time_s):
        """Return the place (3,) and the yaw."""
        angle = 0.5 * (time_s - NOW_S)
        place_m = np.array([2.0 * math.cos(angle), 2.0 * math.sin(angle), self.height_m])
        return place_m, angle + 0.5 * math.pi

    def measure(self, time_s, off_m=0.0):
        """Add odometry and one difference; return the rejection of the difference, if any."""
        place_m, yaw = self.pose(time_s)
        add_odometry(self.localizer, 'r', place_m - self.pose(NOW_S)[0], time_s, yaw)
        tag_m = place_m + turn(2, yaw) @ [*TAG_M, 0.0]
        first, second = self.rng.permutation(list(self.places_m))[:2].tolist()
        near_m, far_m = (math.dist(tag_m, self.places_m[name]) for name in (first, second))
        reading_m = far_m - near_m + 0.99 * ERROR_M * self.rng.choice([-1.0, 1.0]) + off_m
        ends = 'r/tag', first, second
        return self.localizer.add_range_difference(*ends, reading_m, time_s, time_s)

    def run(self, seconds, **measured):
        """Measure ten times a second; return the last estimate."""
        for time_s in NOW_S + 0.1 * np.arange(round(10 * seconds)):
            assert self.measure(time_s, **measured) is None
        return self.localizer.step(time_s)

    def assert_placed(self, estimate, width_m):
        (placement,) = estimate.placements
        place_m, yaw = self.pose(estimate.stamp_s)
        q = placement.positions_m.shape[1]
        assert not missing(placement, place_m[:q], [turn(2, yaw)])
        assert np.ptp(placement.enclosure_m[0], axis=0).max() < width_m
        if q == 2:
            assert np.linalg.norm(placement.positions_m[0] - place_m[:2]) < 0.15
        assert placement.heading_half_width_rad[0] < 0.3


@pytest.mark.parametrize('window_outliers', [0, 1])
def test_a_mounted_tag_places_its_robot_and_tells_its_heading(window_outliers):
    listener = Listener(window_outliers=window_outliers)
    listener.assert_placed(listener.run(5.0), 0.4)
    states = listener.localizer.input_states(NOW_S + 5.0)
    heard = {state.key for state in states if state.key.kind is LinkKind.RANGE_DIFFERENCE}
    assert LinkKey(LinkKind.RANGE_DIFFERENCE, 'r/tag', 'b', 'a') in heard and len(heard) == 12
    assert {str(key) for key in heard} >= {'range_difference r/tag->b-a'}


def test_the_best_point_fits_differences():
    listener = Listener()
    (placement,) = listener.run(5.0).placements
    place_m, yaw = listener.pose(NOW_S + 4.9)
    orientations, _ = placement.best_headings
    off = [*(placement.positions_m[0] - place_m[:2])]
    off.append(math.remainder(yaw_of(orientations[0]) - yaw, math.tau))
    deviations = np.sqrt(placement.covariances[0].diagonal()[[0, 1, 5]])
    assert (np.abs(off) < 3.0 * deviations).all() and (deviations < [0.05, 0.05, 0.03]).all()


def test_differences_without_a_memory_are_said_to_place_no_robot():
    estimate = Listener(memory_s=0.0).run(1.0)
    assert 'place no robot without' in estimate.reason and not estimate.links[0].stale


@pytest.mark.parametrize('share', [1.0, 0.8])
def test_bounds_that_are_too_narrow_are_noticed(share):
    listener, wrong = Listener(stated_m=share * ERROR_M), []
    for step in range(60):
        time_s = NOW_S + 0.1 * step
        listener.measure(time_s)
        estimate = listener.localizer.step(time_s)
        place_m = listener.pose(time_s)[0][:2]
        wrong += [*estimate.forgotten, *(missing(one, place_m) for one in estimate.placements)]
    assert any(wrong) == (share < 1.0)


def test_in_space_a_tag_places_its_robot():
    listener = Listener(3, {**ANCHORS_M, 'e': (0.0, 0.0, 4.0)}, height_m=1.0)
    listener.assert_placed(listener.run(8.0), 1.0)


def test_anchors_may_be_above_the_plane():
    elevations_m = {'r': (0.0, 0.2), **dict.fromkeys(ANCHORS_M, (3.0, 3.0))}
    places_m = {name: (*place_m, 3.0) for name, place_m in ANCHORS_M.items()}
    listener = Listener(2, places_m, height_m=0.1, elevations_m=elevations_m)
    listener.assert_placed(listener.run(5.0), 0.4)


def test_a_wrong_difference_is_a_suspect():
    listener = Listener(window_outliers=1)
    listener.run(4.0)
    assert listener.measure(NOW_S + 4.0, off_m=3.0) is None
    estimate = listener.localizer.step(NOW_S + 4.0)
    (suspect,) = estimate.suspects_in_window
    assert suspect.measures == (LinkKind.RANGE_DIFFERENCE,) and suspect.stamp_s == NOW_S + 4.0
    listener.assert_placed(estimate, 0.6)


@pytest.mark.parametrize('age_s', [0.0, 0.01])
def test_a_set_is_forgotten_with_its_readings(age_s):
    """By the differences r is far from s, by a range beside it."""
    places_m = {'a': (0.0, 0.0), 'b': (10.0, 0.0), 'c': (0.0, 10.0)}
    localizer, stamp_s, forgotten = new_localizer('rs', places_m), NOW_S - age_s, []
    away_m = [math.dist(place_m, (3.0, 3.0)) for place_m in places_m.values()]
    add_ranges(localizer, 's', (8.0, 8.0), places_m, stamp_s)
    localizer.add_range('r', 's', 1.0, stamp_s, stamp_s)
    for time_s in (NOW_S, NOW_S + 0.1):
        add_odometry(localizer, 'r', np.zeros(3), time_s)
        add_odometry(localizer, 's', np.zeros(3), time_s)
        for end, far_m in zip('bc' if time_s == NOW_S else '', away_m[1:], strict=False):
            localizer.add_range_difference('r', 'a', end, far_m - away_m[0], stamp_s, stamp_s)
        forgotten.append([one.text for one in localizer.step(time_s).forgotten])
    assert forgotten == [['what was measured before contradicts what is measured now'], []]


def test_differences_that_contradict_themselves_are_left_out():
    listener = Listener()
    listener.run(4.0)
    assert listener.measure(NOW_S + 4.0, off_m=3.0) is None
    estimate = listener.localizer.step(NOW_S + 4.0)
    assert 'r' in estimate.reason and not estimate.placements
    assert any('contradict' in forgotten.text for forgotten in estimate.forgotten)


@pytest.mark.parametrize('hears', [True, False])
def test_a_robot_that_hears_two_sensors_of_another_tells_how_that_is_turned(hears):
    """Ranges alone do not tell this: the robot drives in a circle about the other one."""
    localizer = new_localizer(
        ('r', 's'),
        mounts={'s': {'left': (0.0, 3.0), 'right': (0.0, -3.0)}},
        range_difference_error=DifferenceErrorModel(-0.02, 0.02),
        odometry_error={},
    )
    for step in range(40):
        time_s, angle = NOW_S + 0.1 * step, 0.05 * step
        place_m = np.array([4.0 * math.cos(angle), 4.0 * math.sin(angle), 0.0])
        add_odometry(localizer, 'r', place_m, time_s)
        add_odometry(localizer, 's', np.zeros(3), time_s)
        localizer.add_range('r', 's', 4.0, time_s, time_s)
        left_m, right_m = (math.dist(place_m, (0.0, y, 0.0)) for y in (3.0, -3.0))
        if hears:
            ends = 'r', 's/left', 's/right'
            assert not localizer.add_range_difference(*ends, right_m - left_m, time_s, time_s)
    estimate = localizer.step(time_s)
    # r is at the origin, and sees s along x.
    yaw_rad = -math.atan2(*-place_m[1::-1])
    turned = []
    for one in estimate.placements:
        off_rad = math.remainder(yaw_of(one.orientations_xyzw[1]) - yaw_rad, math.tau)
        turned.append(abs(off_rad) <= one.heading_half_width_rad[1] < 0.5)
    assert any(turned) == hears


@pytest.mark.parametrize(
    ('ends', 'difference_m', 'reason', 'text'),
    [
        (('r', 'a', 'z'), 1.0, RejectionReason.UNKNOWN_ROBOT, "'z' is not one of"),
        (('r', 'a', 'a'), 1.0, RejectionReason.SEVERAL_BODIES, 'not two points of one body'),
        (('r', 'a', 's'), 1.0, RejectionReason.SEVERAL_BODIES, "'s' and 'a' are not two points"),
        (('r/tag', 'r', 'r/tag'), 1.0, RejectionReason.SAME_ROBOT, 'both observer and target'),
        (('r', 'a', 'b'), math.nan, RejectionReason.INVALID_RANGE, 'nan must be a finite'),
        (('r', 'a', 'b'), 'far', RejectionReason.INVALID_RANGE, "'far' must be a finite"),
    ],
)
def test_what_says_nothing_is_refused_with_its_reason(ends, difference_m, reason, text):
    localizer = new_localizer(('r', 's'), anchors=ANCHORS_M, mounts={'r': {'tag': TAG_M}})
    rejection = localizer.add_range_difference(*ends, difference_m, NOW_S, NOW_S)
    assert rejection.reason is reason and text in str(rejection)
    (rejection,) = localizer.add_peers(ends[0], [(ends[1:], difference_m)], NOW_S, NOW_S)
    assert rejection.reason is reason
    key = LinkKey(LinkKind.RANGE_DIFFERENCE, ends[0], ends[2], ends[1])
    states = {state.key: state.rejected for state in localizer.input_states(NOW_S)}
    assert states[key] == {reason: 2}
