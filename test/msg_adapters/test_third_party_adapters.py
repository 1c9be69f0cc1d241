# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Messages of packages that are not installed here, by stand-ins with the same fields."""

import math
from pathlib import Path
from types import SimpleNamespace

from message_stand_ins import assert_same
import numpy as np
import pytest

from msg_adapters import (
    CameraReading,
    IdentifiedReading,
    PixelReading,
    UnknownTypeError,
    adapter_for,
)

RANGE_STAMPED = 'uwb_ros/msg/RangeStamped'
SENSOR_UWB = 'px4_msgs/msg/SensorUwb'
APRILTAGS = 'apriltag_msgs/msg/AprilTagDetectionArray'
DETECTIONS_2D = 'vision_msgs/msg/Detection2DArray'
DETECTIONS_3D = 'vision_msgs/msg/Detection3DArray'
FRAMES_2 = [
    f'{package}/msg/LinktrackNodeframe2'
    for package in ('nlink_parser', 'nlink_parser_ros2_interfaces')
]
FRAMES_WITHOUT_HEADER = [
    name.replace('frame2', f'frame{number}') for name in FRAMES_2 for number in (3, 5)
]
NO_RAYS = np.full((2, 3), np.nan)
RANGES = IdentifiedReading(2.5, '1:0', ('1:3', '2:0'), np.array([4.25, 6.5]), NO_RAYS, 'uwb')
PIXELS = PixelReading(7.5, ('tag36h11:4', 'tag36h11:12'), np.array([[1.5, 2.5], [3.5, 4.5]]), 'c')
RAYS = np.array([[4.0, -1.0, 0.5], [8.0, 2.0, 1.0]])
NO_RANGES = np.full(2, np.nan)
VALUES = [
    (
        RANGE_STAMPED,
        IdentifiedReading(1.5, '10', ('21',), np.array([3.25]), np.full((1, 3), np.nan), 'uwb'),
    ),
    (SENSOR_UWB, IdentifiedReading(1.5, '4660', ('21',), np.array([3.25]))),
    *((name, RANGES) for name in FRAMES_2),
    *(
        (name, IdentifiedReading(0.0, '1:0', ('1:3', '2:0'), np.array([4.25, 6.5])))
        for name in FRAMES_WITHOUT_HEADER
    ),
    (APRILTAGS, PIXELS),
    (DETECTIONS_2D, PIXELS),
    (DETECTIONS_3D, IdentifiedReading(3.0, '', ('r2', 'r3'), NO_RANGES, RAYS, 'base_link')),
    (DETECTIONS_3D, IdentifiedReading(3.0, '', ('r2', 'r3'), NO_RANGES, RAYS, 'x_optical_frame')),
]
CAMERA = CameraReading(0.0, 'c', (400.0, 500.0), (320.0, 240.0))


@pytest.mark.usefixtures('third_party_messages')
@pytest.mark.parametrize('type_name, value', VALUES, ids=[name for name, _ in VALUES])
def test_value_survives_the_message(type_name, value):
    pytest.importorskip('geometry_msgs', reason='the ROS messages are not installed')
    adapter = adapter_for(type_name)
    message = adapter.to_message(value)
    assert isinstance(message, adapter.message_class())
    assert isinstance(value, adapter.value_class)
    assert_same(adapter.from_message(message), value)


@pytest.mark.parametrize('type_name', dict(VALUES))
def test_package_that_is_missing_is_named(type_name):
    with pytest.raises(UnknownTypeError, match=f'install the ROS package {type_name[:7]}'):
        adapter_for(type_name).message_class()


def test_every_type_is_in_the_documentation():
    page = (Path(__file__).parents[2] / 'docs/sensors.md').read_text(encoding='utf-8')
    for type_name in dict(VALUES):
        package, _, name = type_name.split('/')
        assert package in page and name.rstrip('0123456789') in page


def detection(*classes, own_id=''):
    """Return a detection of these (class, score), at pixel (1, 2)."""
    results = [
        SimpleNamespace(hypothesis=SimpleNamespace(class_id=name, score=score))
        for name, score in classes
    ]
    center = SimpleNamespace(position=SimpleNamespace(x=1.0, y=2.0, z=3.0))
    return SimpleNamespace(results=results, bbox=SimpleNamespace(center=center), id=own_id)


def detections(frame_id, *found):
    stamp = SimpleNamespace(sec=1, nanosec=0)
    header = SimpleNamespace(stamp=stamp, frame_id=frame_id)
    return SimpleNamespace(header=header, detections=list(found))


@pytest.mark.parametrize('type_name', [DETECTIONS_2D, DETECTIONS_3D])
def test_the_likeliest_class_names_a_detection_and_its_own_id_where_there_is_none(type_name):
    message = detections(
        'camera', detection(('r1', 0.2), ('r2', 0.7), ('r3', 0.1)), detection(own_id='track 9')
    )
    assert adapter_for(type_name).from_message(message).target_ids == ('r2', 'track 9')
    message = detections('camera', detection(('cone', math.nan), ('r2', 0.95)))
    with pytest.raises(ValueError, match='NaN is no score'):
        adapter_for(type_name).from_message(message)


def test_rays_in_an_optical_frame_are_turned_to_look_along_x():
    # Optical: x right, y down, z forward.
    from_message = adapter_for(DETECTIONS_3D).from_message
    optical = from_message(detections('cam_optical_frame', detection(('r1', 1.0))))
    body = from_message(detections('cam_link', detection(('r1', 1.0))))
    np.testing.assert_array_equal(optical.rays_xyz, [[3.0, -1.0, -2.0]])
    np.testing.assert_array_equal(body.rays_xyz, [[1.0, 2.0, 3.0]])
    # Distances of cameras are left out.
    assert np.isnan(body.ranges_m).all()


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


def camera_info(p, k, binning=0, offset=(0, 0)):
    stamp = SimpleNamespace(sec=0, nanosec=0)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id='c'),
        p=p,
        k=k,
        binning_x=binning,
        binning_y=binning,
        roi=SimpleNamespace(x_offset=offset[0], y_offset=offset[1]),
    )


K = [400.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]
P = [300.0, 0.0, 310.0, -9.0, 0.0, 350.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0]


def test_matrix_of_the_rectified_image_comes_first():
    from_message = adapter_for('sensor_msgs/msg/CameraInfo').from_message
    rectified = from_message(camera_info(P, K))
    assert (rectified.focal_px, rectified.center_px) == ((300.0, 350.0), (310.0, 230.0))
    assert from_message(camera_info([0.0] * 12, K)) == CAMERA


def test_binned_and_cropped_images_see_the_same_rays():
    from_message = adapter_for('sensor_msgs/msg/CameraInfo').from_message
    full, part = from_message(camera_info(P, K)), from_message(camera_info(P, K, 2, (100, 40)))
    pixels = np.array([[310.0, 230.0], [500.0, 100.0]])
    assert part.rays((pixels - [100.0, 40.0]) / 2.0) == pytest.approx(full.rays(pixels))


@pytest.mark.parametrize('focal', [0.0, -1.0, np.nan, np.inf])
def test_camera_that_is_not_calibrated_is_refused(focal):
    message = camera_info([0.0] * 12, [focal, *K[1:]])
    with pytest.raises(ValueError, match='are not calibrated: they must be finite'):
        adapter_for('sensor_msgs/msg/CameraInfo').from_message(message)


def test_ranges_and_rays_must_be_as_many_as_ids():
    with pytest.raises(ValueError, match='2 ids need as many ranges and rays'):
        IdentifiedReading(0.0, '', ('a', 'b'), np.zeros(3))


@pytest.mark.usefixtures('third_party_messages')
@pytest.mark.parametrize('type_name', [RANGE_STAMPED, SENSOR_UWB])
def test_range_message_of_several_targets_is_refused(type_name):
    with pytest.raises(ValueError, match='longer'):
        adapter_for(type_name).to_message(RANGES)
