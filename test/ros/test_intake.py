# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parts of messages that reach the localizer, and those that are refused."""

from dataclasses import replace
import math

from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Range

from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    LinkKey,
    LinkKind,
    Localizer,
    RangeErrorModel,
    RejectionReason,
)
from dg_localization.ros.interface.intake import Intake
from dg_localization.ros.interface.links import Link
from msg_adapters import PeersReading, RangeReading, adapter_for

KEY = LinkKey(LinkKind.PEERS, 'a', '')
NOW_S = 10.0
RANGE, CLOUD = 'sensor_msgs/msg/Range', 'sensor_msgs/msg/PointCloud2'
RANGES = Link('/a/range/b', RANGE, LinkKey(LinkKind.RANGE, 'a', 'b'))
CLOUDS = Link('/a/peers', CLOUD, KEY)


@pytest.fixture
def localizer():
    anchors = {'a': Anchor((0.0, 0.0)), 'beacon': Anchor((5.0, 0.0))}
    return Localizer(FleetConfig(robots=('a', 'b'), anchors=anchors))


def heard(*rows):
    """Return a message of rows of (reference, peer, difference), without ranges."""
    references, peers, differences_m = zip(*rows, strict=True)
    unknown = np.full((len(rows), 3), math.nan)
    reading = PeersReading(
        NOW_S,
        np.array(peers),
        unknown[:, 0],
        unknown,
        references=np.array(references),
        differences_m=np.array(differences_m),
    )
    return adapter_for(CLOUD).to_message(reading)


def test_range_differences_come_with_peers():
    anchors = {name: Anchor((x, 0.0)) for name, x in (('p', 0.0), ('q', 5.0))}
    localizer = Localizer(FleetConfig(robots=('a', 'b'), anchors=anchors))
    link = replace(CLOUDS, overrides={'difference_min_error': -0.1, 'difference_max_error': 0.3})
    rows = (2, 3, 1.5), (3, 2, math.nan), (2, 9, 1.0), (1, 2, 1.0)
    intake, data = Intake(localizer, True), serialize_message(heard(*rows))
    rejection = intake.take(link, data, NOW_S)
    assert rejection.reason is RejectionReason.UNKNOWN_ROBOT
    states = {str(s.key): (s.accepted, s.rejected) for s in localizer.input_states(NOW_S)}
    assert states == {
        'peers a': (1, {RejectionReason.UNKNOWN_ROBOT: 1, RejectionReason.SEVERAL_BODIES: 1}),
        'range_difference a->q-p': (1, {}),
        'range_difference a->peer beyond 3-p': (0, {RejectionReason.UNKNOWN_ROBOT: 1}),
        'range_difference a->p-b': (0, {RejectionReason.SEVERAL_BODIES: 1}),
    }
    (seen,) = localizer.snapshot(NOW_S).window.observations['a', 'q', 'p']
    assert (seen.least_m, seen.most_m) == pytest.approx((1.2, 1.6))


def take(localizer, link, message, use_header_stamp=False):
    """Take a message, or its bytes; return what is counted of the topic."""
    intake = Intake(localizer, use_header_stamp)
    data = message if isinstance(message, bytes) else serialize_message(message)
    assert intake.take(link, data, NOW_S) is None
    return intake.malformed.get(link.topic)


def cloud(n_rows=1, range_m=math.nan, ray=(math.nan,) * 3):
    """Return a message of `n_rows` readings of b."""
    ranges_m, rays = np.full(n_rows, range_m), np.full((n_rows, 3), ray)
    reading = PeersReading(NOW_S, np.ones(n_rows, int), ranges_m, rays)
    return adapter_for(CLOUD).to_message(reading)


NARROW = {'min_error': -0.02, 'max_error': 0.02, 'half_width': 0.01}


@pytest.mark.parametrize(
    ('overrides', 'bounds_m', 'half_width_rad'),
    [({}, (1.7, 3.05), 0.2), (NARROW, (2.98, 3.02), 0.01)],
)
def test_readings_have_the_bounds_of_their_own_link(overrides, bounds_m, half_width_rad):
    ranging = RangeErrorModel(-0.05, 1.3, 0.0, 0.0)
    config = FleetConfig(('a', 'b'), range_error=ranging, bearing_half_width_rad=0.2)
    localizer, link = Localizer(config), replace(CLOUDS, overrides=overrides)
    assert take(localizer, link, cloud(range_m=3.0, ray=(1.0, 0.0, 0.0))) is None
    snapshot = localizer.snapshot(NOW_S)
    (distance,), (ray,) = snapshot.distances, snapshot.rays
    assert (distance.lower_m, distance.upper_m) == pytest.approx(bounds_m)
    assert ray.half_width_rad == half_width_rad


@pytest.mark.parametrize('use_header_stamp', [False, True])
def test_stamps_are_corrected_by_the_offset_of_their_link(localizer, adapt, use_header_stamp):
    adapt(RANGE, lambda message: RangeReading(NOW_S, 3.0))
    late = replace(RANGES, overrides={'stamp_offset': -0.25})
    intake = Intake(localizer, use_header_stamp)
    assert intake.take(late, serialize_message(Range()), NOW_S) is None
    (state,) = [state for state in intake.states(NOW_S).values() if state.accepted]
    assert state.age_s == 0.25
    too_late = replace(RANGES, overrides={'stamp_offset': -25.0})
    assert 'old' in intake.take(too_late, serialize_message(Range()), NOW_S).text


@pytest.mark.parametrize('is_simulated', [False, True])
def test_a_clock_that_comes_after_what_it_dates_proves_no_stamp_wrong(
    localizer, adapt, is_simulated
):
    adapt(RANGE, lambda message: RangeReading(NOW_S + 0.09, 3.0))
    intake = Intake(localizer, True, is_simulated=is_simulated)
    assert intake.take(RANGES, serialize_message(Range()), NOW_S) is None
    (state,) = [state for state in intake.states(NOW_S).values() if state.accepted]
    assert ('ahead of their arrival' in state.warning) != is_simulated
    # What is further ahead than `max_future` is refused either way.
    adapt(RANGE, lambda message: RangeReading(NOW_S + 0.2, 3.0))
    assert intake.take(RANGES, serialize_message(Range()), NOW_S).reason is RejectionReason.FUTURE


def test_a_range_from_before_iron_is_named(localizer):
    data = serialize_message(Range(range=3.0))[:-4]
    assert 'before Iron' in take(localizer, RANGES, data).last


@pytest.mark.parametrize(
    ('overrides', 'accepted'),
    [
        ({}, [3.0, 65.535]),
        ({'min_reading': -1.0}, [0.0, 3.0, 65.535]),
        ({'min_reading': 0.3, 'max_reading': 65.535}, [3.0]),
    ],
)
def test_readings_that_stand_for_none_are_refused_with_a_reason_of_their_own(overrides, accepted):
    localizer = Localizer(FleetConfig(robots=('a', 'b')))
    intake = Intake(localizer, use_header_stamp=False)
    link, taken_m = replace(RANGES, overrides=overrides), []
    for reading_m in (0.0, 3.0, 65.535):
        rejection = intake.take(link, serialize_message(Range(range=reading_m)), NOW_S)
        if rejection is None:
            taken_m.append(reading_m)
        else:
            assert rejection.reason is RejectionReason.NO_READING
            assert 'm is no reading: it is at or ' in rejection.text
    assert taken_m == accepted


def test_the_frame_of_odometry_has_no_slash_at_the_beginning(localizer):
    message = Odometry(child_frame_id='/a/base_link')
    message.header.frame_id = '/a/odom'
    message.pose.pose.orientation.w = 1.0
    intake = Intake(localizer, use_header_stamp=False)
    link = Link('/a/odom', 'nav_msgs/msg/Odometry', LinkKey(LinkKind.ODOMETRY, 'a', ''))
    assert intake.take(link, serialize_message(message), NOW_S) is None
    assert intake.bodies == {'a': 'a/base_link'}
    assert localizer.snapshot(NOW_S).motion.odometry['a'][-1].frame == 'a/odom'


def test_an_input_that_rejects_most_of_its_readings_lately_is_named_with_the_cause(localizer):
    intake = Intake(localizer, use_header_stamp=False)
    for second in range(30):
        now_s = NOW_S + second
        range_m = 3.0 if second < 15 else -3.0
        for _ in range(3):
            intake.take(RANGES, serialize_message(Range(range=range_m)), now_s)
        found = intake.rejecting(now_s)
        assert bool(found) == (second >= 20), second
    assert 'is negative' in found[RANGES.key]


def test_nonsense_of_an_adapter_is_counted_and_named(localizer, adapt):
    adapt(RANGE, lambda message: None)
    found = take(localizer, RANGES, Range(range=3.0), use_header_stamp=True)
    assert found.count == 1
    assert 'returned NoneType, it must return RangeReading' in found.last


def test_cloud_has_no_more_rows_than_the_fleet_can_need(localizer):
    n_most = 2 * len(localizer.config.points)
    found = take(localizer, CLOUDS, cloud(n_most + 1))
    assert f'the cloud has {n_most + 1} points, for this fleet at most {n_most}' in found.last
    assert localizer.input_states(NOW_S) == []
    assert take(localizer, CLOUDS, cloud(0)) is None
