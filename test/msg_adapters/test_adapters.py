# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Round trips through real messages, and through CDR, without a node."""

from dataclasses import replace
import math
from types import SimpleNamespace

from message_stand_ins import DEFINITIONS, assert_same
import numpy as np
import pytest

from msg_adapters import (
    Adapter,
    BearingReading,
    CameraReading,
    Diagnostics,
    ElevationReading,
    Level,
    Marker,
    MarkerScene,
    OdometryReading,
    PeersReading,
    PoseList,
    RangeReading,
    Shape,
    Status,
    UncertainPose,
    UnknownTypeError,
    adapter_for,
    known_types,
    register,
)
from msg_adapters.diagnostics import diagnostics_to_cdr
from msg_adapters.headers import header_to_message, stamp_from_message
from msg_adapters.markers import marker_scene_to_cdr
from msg_adapters.poses import pose_array_to_cdr, uncertain_pose_to_cdr

pytest.importorskip('sensor_msgs', reason='the ROS messages are not installed')

THIRD_PARTY = {
    f'{package}/msg/{name}'
    for package, name in (full_name.split('/') for full_name in DEFINITIONS)
}

RANGE = 'sensor_msgs/msg/Range'
BEARING = 'geometry_msgs/msg/Vector3Stamped'
ODOMETRY = 'nav_msgs/msg/Odometry'
ELEVATION = 'geometry_msgs/msg/PointStamped'
PEERS = 'sensor_msgs/msg/PointCloud2'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
POSE_ARRAY = 'geometry_msgs/msg/PoseArray'
POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
MARKERS = 'visualization_msgs/msg/MarkerArray'

QUATERNION = np.array([0.0, 0.0, 0.6, 0.8])
BEARING_READING = BearingReading(12.25, np.array([0.5, -0.25, 0.125]), 'robot_1/base_link')
ODOMETRY_READING = OdometryReading(
    3.5, np.array([1.0, -2.0, 0.5]), QUATERNION, 'robot_1/odom', 'robot_1/base_link'
)
PEERS_READING = PeersReading(
    4.5,
    np.array([0, 3, 2**32 - 1]),
    np.array([1.1, np.nan, np.inf]),
    np.array([[0.1, 0.2, 0.3], [1.0, 0.0, 0.0], [np.nan, np.nan, np.nan]]),
    'robot_2/base_link',
)
HEARD_READING = replace(
    PEERS_READING,
    references=np.array([2, 0, 2**32 - 1]),
    differences_m=np.array([-1.25, np.nan, 0.5]),
)
POSE_LIST = PoseList(
    9.0, 'map', np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), np.array([QUATERNION, QUATERNION])
)
UNCERTAIN_POSE = UncertainPose(
    9.0, 'map', np.array([1.0, 2.0, 0.0]), QUATERNION, np.arange(36.0).reshape(6, 6)
)
SCENE = MarkerScene(
    2.0,
    'map',
    (
        Marker('robots', 0, Shape.SPHERE_LIST, np.ones((3, 3)), np.full((3, 4), 0.5), 0.25),
        Marker('links', 1, Shape.LINE_LIST, np.zeros((2, 3)), np.ones((2, 4)), 0.5),
        Marker('names', 2, Shape.TEXT, np.ones((1, 3)), np.ones((1, 4)), 0.125, 'robot_1'),
    ),
    1.5,
)
DIAGNOSTICS_VALUE = Diagnostics(
    7.0,
    (
        Status(Level.OK, 'localizer: fleet', 'one hypothesis', 'fleet', {'hypotheses': '1'}),
        Status(Level.WARN, 'localizer: robot robot_1', 'flexible'),
        Status(Level.ERROR, 'localizer: input', 'contradicts'),
        Status(Level.STALE, 'localizer: input 2', 'silent'),
    ),
)
VALUES = [
    (RANGE, RangeReading(1.5, 2.25, 0.125, 8.0, 0.0625, 'uwb')),
    (BEARING, BEARING_READING),
    (ODOMETRY, ODOMETRY_READING),
    (ELEVATION, ElevationReading(6.25, -12.5, 'map')),
    (PEERS, PEERS_READING),
    (PEERS, HEARD_READING),
    (CAMERA_INFO, CameraReading(3.5, 'cam_optical_frame', (400.0, 410.0), (320.5, 240.5))),
    (POSE_ARRAY, POSE_LIST),
    (POSE, UNCERTAIN_POSE),
    (DIAGNOSTICS, DIAGNOSTICS_VALUE),
    (MARKERS, SCENE),
]


CDR = {
    POSE_ARRAY: pose_array_to_cdr,
    POSE: uncertain_pose_to_cdr,
    MARKERS: marker_scene_to_cdr,
    DIAGNOSTICS: diagnostics_to_cdr,
}


@pytest.mark.parametrize('type_name, value', VALUES, ids=[name for name, _ in VALUES])
def test_value_survives_the_wire(type_name, value):
    serialization = pytest.importorskip('rclpy.serialization')
    adapter = adapter_for(type_name)
    wire = serialization.serialize_message(adapter.to_message(value))
    message = serialization.deserialize_message(wire, adapter.message_class())
    assert_same(adapter.from_message(message), value)


def with_text(value, text):
    """Yield a value with a text in the place of each of its own: as it is, and empty."""
    if isinstance(value, Diagnostics):
        named = {'name': text, 'message': text, 'hardware_id': text, 'values': {'a': text}}
        yield replace(value, statuses=tuple(replace(one, **named) for one in value.statuses))
        yield replace(value, statuses=())
    elif isinstance(value, MarkerScene):
        named = [replace(one, namespace=text) for one in value.markers]
        none = replace(named[0], points_m=np.zeros((0, 3)), colors_rgba=np.zeros((0, 4)))
        yield replace(value, frame_id=text, markers=(none, *named, replace(named[-1], text=text)))
        yield replace(value, frame_id=text, markers=(), lifetime_s=0.0)
    elif isinstance(value, PoseList):
        yield replace(value, frame_id=text)
        none = {'positions_m': np.zeros((0, 3)), 'orientations_xyzw': np.zeros((0, 4))}
        yield replace(value, frame_id=text, **none)
    else:
        yield replace(value, frame_id=text)


# Of every length, so that every alignment comes up.
@pytest.mark.parametrize('text', ['', 'a', 'ab', 'abc', 'abcd', 'abcde', 'abcdefg', 'Halle Süd'])
@pytest.mark.parametrize('type_name', CDR)
def test_message_serialized_without_being_made_is_read_whole(type_name, text):
    serialization = pytest.importorskip('rclpy.serialization')
    for value in with_text(dict(VALUES)[type_name], text):
        data = CDR[type_name](value)
        message = adapter_for(type_name).to_message(value)
        assert_same(adapter_for(type_name).from_message(message), value)
        assert len(serialization.serialize_message(message)) == len(data)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError):
        pose_array_to_cdr(PoseList(1.0, 'm', np.ones((2, 3)), np.ones((1, 4))))
    with pytest.raises(ValueError, match=r'covariance has shape \(3, 3\)'):
        uncertain_pose_to_cdr(UncertainPose(1.0, 'm', np.ones(3), np.ones(4), np.ones((3, 3))))
    marker = Marker('robots', 4, Shape.SPHERE_LIST, np.ones((2, 3)), np.ones((1, 4)), 0.1)
    with pytest.raises(ValueError, match='robots/4 needs a color'):
        marker_scene_to_cdr(MarkerScene(1.0, 'm', (marker,)))
    with pytest.raises(ValueError, match='stamp nan s is not finite'):
        pose_array_to_cdr(PoseList(math.nan, 'm', np.ones((1, 3)), np.ones((1, 4))))


def test_every_adapter_has_a_round_trip_here_or_beside():
    others = {name for name in known_types() if name not in dict(VALUES)}
    # Those have stand-ins, and their round trips in test_third_party_adapters.py.
    assert others == {name for name in known_types() if name in THIRD_PARTY}
    assert len(others) == 11


@pytest.mark.parametrize('sentinel', [math.nan, math.inf, -math.inf])
def test_range_sentinels_of_rep_117_pass_unchanged(sentinel):
    adapter = adapter_for(RANGE)
    message = adapter.to_message(RangeReading(1.0, sentinel, 0.5, 8.0))
    np.testing.assert_equal(adapter.from_message(message).range_m, sentinel)


def test_range_limits_and_variance_of_zero_are_not_given():
    from_message, range_class = adapter_for(RANGE).from_message, adapter_for(RANGE).message_class()
    message = range_class(range=2.0, min_range=0.0, max_range=0.0, variance=0.0)
    assert from_message(message) == RangeReading(0.0, 2.0)
    # Those of old recordings have none.
    header = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=500_000_000), frame_id='')
    message = SimpleNamespace(header=header, range=3.0, min_range=0.0, max_range=0.0)
    assert from_message(message) == RangeReading(1.5, 3.0)


def test_marker_array_of_another_node_is_refused():
    adapter = adapter_for(MARKERS)
    with pytest.raises(ValueError, match='DELETEALL'):
        adapter.from_message(adapter.message_class()())


@pytest.mark.parametrize(
    'stamp_s, sec, nanosec',
    [(0.0, 0, 0), (1.5, 1, 500_000_000), (0.9999999999, 1, 0), (-0.25, -1, 750_000_000)],
)
def test_stamp_is_rounded_and_normalized(stamp_s, sec, nanosec):
    stamp = header_to_message(stamp_s, '').stamp
    assert (stamp.sec, stamp.nanosec) == (sec, nanosec)
    assert stamp_from_message(stamp) == pytest.approx(stamp_s, abs=1e-9)


@pytest.mark.parametrize('nanosec', [1_000_000_000, 4_000_000_000, 2**32 - 1])
@pytest.mark.parametrize('type_name', [RANGE, BEARING, ODOMETRY])
def test_a_second_of_nanoseconds_is_refused_by_name(type_name, nanosec):
    adapter = adapter_for(type_name)
    message = adapter.message_class()()
    message.header.stamp.nanosec = nanosec
    with pytest.raises(ValueError, match=f'nanosec {nanosec} of the stamp .* below 1000000000'):
        adapter.from_message(message)


def test_unknown_type_is_named_with_the_known_ones():
    with pytest.raises(UnknownTypeError, match=r"'gps_msgs/msg/Fix'; there are .*msg/Range"):
        adapter_for('gps_msgs/msg/Fix')


def test_own_type_is_registered_and_looked_up_lazily():
    register(Adapter('not_installed_msgs/msg/Thing', dict, vars, print))
    adapter = adapter_for('not_installed_msgs/msg/Thing')
    with pytest.raises(UnknownTypeError, match='install the ROS package not_installed_msgs'):
        adapter.message_class()


def test_malformed_type_name_is_refused():
    with pytest.raises(ValueError, match='package/msg/Type'):
        register(Adapter('Range', dict, vars, print))
