# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Messages to values and back, also through CDR, without a node."""

from dataclasses import asdict, replace
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('sensor_msgs', reason='the ROS messages are not installed')

from message_stand_ins import DEFINITIONS  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from sensor_msgs.msg import CameraInfo, RegionOfInterest  # noqa: E402

from msg_adapters import (  # noqa: E402
    Adapter,
    BearingReading,
    CameraReading,
    Diagnostics,
    ElevationReading,
    IdentifiedReading,
    Level,
    Marker,
    MarkerScene,
    OdometryReading,
    PeersReading,
    PixelReading,
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
from msg_adapters.diagnostics import diagnostics_to_cdr  # noqa: E402
from msg_adapters.headers import header_to_message, stamp_from_message  # noqa: E402
from msg_adapters.markers import marker_scene_to_cdr  # noqa: E402
from msg_adapters.poses import pose_array_to_cdr, uncertain_pose_to_cdr  # noqa: E402

RANGE, BEARING = 'sensor_msgs/msg/Range', 'geometry_msgs/msg/Vector3Stamped'
ODOMETRY, PEERS = 'nav_msgs/msg/Odometry', 'sensor_msgs/msg/PointCloud2'
CAMERA_INFO, POSE_ARRAY = 'sensor_msgs/msg/CameraInfo', 'geometry_msgs/msg/PoseArray'
POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
MARKERS = 'visualization_msgs/msg/MarkerArray'
RANGE_STAMPED, SENSOR_UWB = 'uwb_ros/msg/RangeStamped', 'px4_msgs/msg/SensorUwb'
LINK_TRACKS = 'nlink_parser/msg/Linktrack', 'nlink_parser_ros2_interfaces/msg/Linktrack'
APRILTAGS = 'apriltag_msgs/msg/AprilTagDetectionArray'
DETECTIONS_2D = 'vision_msgs/msg/Detection2DArray'
DETECTIONS_3D = 'vision_msgs/msg/Detection3DArray'

PLACES = np.array([[4.0, -1.0, 0.5], [8.0, 2.0, np.nan], [1.0, 0.0, np.inf]])
QUATERNION, NAN = np.array([0.0, 0.0, 0.6, 0.8]), math.nan
POINTS, COLORS = np.ones((3, 3)), np.full((3, 4), 0.5)
PEER_ROWS = PeersReading(4.5, np.array([0, 3, 2**32 - 1]), np.array([1.1, NAN, 2.0]), PLACES, 'b')
DIFFERENCES = {'references': np.array([2, 0, 9]), 'differences_m': np.array([-1.25, NAN, 0.5])}
RANGES = IdentifiedReading(2.5, '1:0', ('1:3', '2:0'), np.array([4.25, 6.5]), frame_id='uwb')
ONE_RANGE = IdentifiedReading(1.5, '4660', ('21',), np.array([3.25]))
RAYS = IdentifiedReading(3.0, '', ('r2', 'r3'), np.full(2, NAN), np.outer([1, 2], PLACES[0]))
PIXELS = PixelReading(7.5, ('tag36h11:4', 'tag36h11:12'), PLACES[:2, :2], 'c')
SCENE = (
    Marker('robots', 0, Shape.SPHERE_LIST, POINTS, COLORS, 0.25),
    Marker('links', 1, Shape.LINE_LIST, POINTS[:2], COLORS[:2], 0.5),
    Marker('names', 2, Shape.TEXT, POINTS[:1], COLORS[:1], 0.125, 'robot_1'),
)
STATUSES = (
    Status(Level.OK, 'localizer: fleet', 'one hypothesis', 'fleet', {'hypotheses': '1'}),
    *(Status(level, 'localizer: input', 'contradicts') for level in Level),
)
VALUES = [
    (RANGE, RangeReading(1.5, 2.25, 0.125, 8.0, 0.0625, 'uwb')),
    *((RANGE, RangeReading(1.0, sentinel, 0.5, 8.0)) for sentinel in (NAN, math.inf, -math.inf)),
    (BEARING, BearingReading(12.25, PLACES[0], 'robot_1/base_link')),
    (ODOMETRY, OdometryReading(3.5, PLACES[0], QUATERNION, 'robot_1/odom', 'robot_1/base_link')),
    ('geometry_msgs/msg/PointStamped', ElevationReading(6.25, -12.5, 'map')),
    (PEERS, PEER_ROWS),
    (PEERS, replace(PEER_ROWS, **DIFFERENCES)),
    (CAMERA_INFO, CameraReading(3.5, 'cam_optical_frame', (400.0, 410.0), (320.5, 240.5))),
    (POSE_ARRAY, PoseList(9.0, 'map', PLACES, np.tile(QUATERNION, (3, 1)))),
    (POSE, UncertainPose(9.0, 'map', PLACES[0], QUATERNION, np.arange(36.0).reshape(6, 6))),
    (DIAGNOSTICS, Diagnostics(7.0, STATUSES)),
    (MARKERS, MarkerScene(2.0, 'map', SCENE, 1.5)),
    (RANGE_STAMPED, replace(ONE_RANGE, observer_id='10', frame_id='uwb')),
    (SENSOR_UWB, ONE_RANGE),
    *((f'{name}Nodeframe2', RANGES) for name in LINK_TRACKS),
    # These have no header.
    *(
        (f'{n}Nodeframe{k}', replace(RANGES, stamp_s=0.0, frame_id=''))
        for n in LINK_TRACKS
        for k in '35'
    ),
    (APRILTAGS, PIXELS),
    (DETECTIONS_2D, PIXELS),
    *((DETECTIONS_3D, replace(RAYS, frame_id=name)) for name in ('base_link', 'x_optical_frame')),
]
THIRD_PARTY = [name for name in dict(VALUES) if name.replace('/msg', '') in DEFINITIONS]
CDR = {
    POSE_ARRAY: pose_array_to_cdr,
    POSE: uncertain_pose_to_cdr,
    MARKERS: marker_scene_to_cdr,
    DIAGNOSTICS: diagnostics_to_cdr,
}


def assert_same(actual, expected):
    """Compare two plain values field by field, arrays by value and shape."""
    assert type(actual) is type(expected)
    np.testing.assert_equal(asdict(actual), asdict(expected))


@pytest.mark.usefixtures('third_party_messages')
@pytest.mark.parametrize('type_name, value', VALUES, ids=[name for name, _ in VALUES])
def test_value_survives_the_message_and_the_wire(type_name, value):
    adapter = adapter_for(type_name)
    message = adapter.to_message(value)
    assert isinstance(message, adapter.message_class()) and isinstance(value, adapter.value_class)
    if type_name not in THIRD_PARTY:
        message = deserialize_message(serialize_message(message), adapter.message_class())
    assert_same(adapter.from_message(message), value)


def test_every_adapter_has_a_value_here():
    assert set(known_types()) == set(dict(VALUES))


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
    for value in with_text(dict(VALUES)[type_name], text):
        data = CDR[type_name](value)
        message = adapter_for(type_name).to_message(value)
        assert_same(adapter_for(type_name).from_message(message), value)
        assert len(serialize_message(message)) == len(data)


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


def test_types_are_registered_and_looked_up_lazily_by_their_full_names(monkeypatch):
    with pytest.raises(UnknownTypeError, match=r"'gps_msgs/msg/Fix'; there are .*msg/Range"):
        adapter_for('gps_msgs/msg/Fix')
    monkeypatch.setattr('msg_adapters.registry._adapters', {})
    register(Adapter('not_installed_msgs/msg/Thing', dict, vars, print))
    adapter = adapter_for('not_installed_msgs/msg/Thing')
    with pytest.raises(UnknownTypeError, match='install the ROS package not_installed_msgs'):
        adapter.message_class()
    with pytest.raises(ValueError, match='package/msg/Type'):
        register(Adapter('Range', dict, vars, print))


@pytest.mark.parametrize('type_name', THIRD_PARTY)
def test_package_that_is_missing_is_named(type_name):
    with pytest.raises(UnknownTypeError, match=f'install the ROS package {type_name[:7]}'):
        adapter_for(type_name).message_class()


def test_every_type_is_in_the_documentation():
    page = (Path(__file__).parents[2] / 'docs/sensors.md').read_text(encoding='utf-8')
    for type_name in THIRD_PARTY:
        package, _, name = type_name.split('/')
        assert package in page and name.rstrip('0123456789') in page


@pytest.mark.usefixtures('third_party_messages')
@pytest.mark.parametrize('type_name, value', [(DETECTIONS_2D, PIXELS), (DETECTIONS_3D, RAYS)])
def test_the_likeliest_class_names_a_detection_and_its_id_where_there_is_none(type_name, value):
    adapter = adapter_for(type_name)
    message, others = adapter.to_message(value), adapter.to_message(value).detections
    for other, score in zip(others, (0.2, 0.1), strict=True):
        other.results[0].hypothesis.class_id, other.results[0].hypothesis.score = 'r1', score
    first, second = message.detections
    first.results = [*others[0].results, *first.results, *others[1].results]
    second.results, second.id = [], 'track 9'
    assert adapter.from_message(message).target_ids == (value.target_ids[0], 'track 9')
    first.results[0].hypothesis.score = NAN
    with pytest.raises(ValueError, match='NaN is no score'):
        adapter.from_message(message)


@pytest.mark.usefixtures('third_party_messages')
def test_rays_in_an_optical_frame_are_turned_to_look_along_x():
    adapter = adapter_for(DETECTIONS_3D)
    message = adapter.to_message(replace(RAYS, rays_xyz=np.array([[1.0, 2.0, 3.0]] * 2)))
    message.header.frame_id = 'cam_optical_frame'
    reading = adapter.from_message(message)
    # Optical: x right, y down, z forward.
    np.testing.assert_array_equal(reading.rays_xyz, [[3.0, -1.0, -2.0]] * 2)
    # Distances of cameras are left out.
    assert np.isnan(reading.ranges_m).all()


CAMERA = CameraReading(0.0, 'c', (400.0, 500.0), (320.0, 240.0))


@pytest.mark.parametrize(
    ('pixel', 'ray'),
    [
        ((320.0, 240.0), (1.0, 0.0, 0.0)),
        # To the right in the image is to the right of the robot, which is -y; down is -z.
        ((720.0, 240.0), (1.0, -1.0, 0.0)),
        ((320.0, 740.0), (1.0, 0.0, -1.0)),
    ],
)
def test_pixel_is_a_ray_of_the_camera(pixel, ray):
    reading = PixelReading(2.0, ('a',), np.array([pixel]), 'c').seen_by(CAMERA)
    np.testing.assert_allclose(reading.rays_xyz, [ray], atol=1e-15)
    assert (reading.stamp_s, reading.target_ids, reading.observer_id) == (2.0, ('a',), '')
    assert np.isnan(reading.ranges_m).all()


K = [400.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]
P = [300.0, 0.0, 310.0, -9.0, 0.0, 350.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0]
camera_from = adapter_for(CAMERA_INFO).from_message


def test_matrix_of_the_rectified_image_comes_first():
    rectified = camera_from(CameraInfo(p=P, k=K))
    assert (rectified.focal_px, rectified.center_px) == ((300.0, 350.0), (310.0, 230.0))
    assert replace(camera_from(CameraInfo(k=K)), frame_id='c') == CAMERA


def test_binned_and_cropped_images_see_the_same_rays():
    roi = RegionOfInterest(x_offset=100, y_offset=40)
    full = camera_from(CameraInfo(p=P))
    part = camera_from(CameraInfo(p=P, binning_x=2, binning_y=2, roi=roi))
    pixels = np.array([[310.0, 230.0], [500.0, 100.0]])
    assert part.rays((pixels - [100.0, 40.0]) / 2.0) == pytest.approx(full.rays(pixels))


@pytest.mark.parametrize('focal', [0.0, -1.0, np.nan, np.inf])
def test_camera_that_is_not_calibrated_is_refused(focal):
    with pytest.raises(ValueError, match='are not calibrated: they must be finite'):
        camera_from(CameraInfo(k=[focal, *K[1:]]))


def test_ranges_and_rays_must_be_as_many_as_ids():
    with pytest.raises(ValueError, match='2 ids need as many ranges and rays'):
        IdentifiedReading(0.0, '', ('a', 'b'), np.zeros(3))


@pytest.mark.usefixtures('third_party_messages')
@pytest.mark.parametrize('type_name', [RANGE_STAMPED, SENSOR_UWB])
def test_range_message_of_several_targets_is_refused(type_name):
    with pytest.raises(ValueError, match='longer'):
        adapter_for(type_name).to_message(RANGES)
