# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Messages serialized without being made: the middleware reads what was written."""

from dataclasses import replace
import math

from message_stand_ins import assert_same
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from rclpy.serialization import serialize_message  # noqa: E402

from msg_adapters import (  # noqa: E402
    Diagnostics,
    Level,
    Marker,
    MarkerScene,
    PoseList,
    Shape,
    Status,
    UncertainPose,
    adapter_for,
)
from msg_adapters.diagnostics import diagnostics_to_cdr  # noqa: E402
from msg_adapters.headers import decoded  # noqa: E402
from msg_adapters.markers import marker_scene_to_cdr  # noqa: E402
from msg_adapters.poses import pose_array_to_cdr, uncertain_pose_to_cdr  # noqa: E402

POSE_ARRAY = 'geometry_msgs/msg/PoseArray'
POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
MARKERS = 'visualization_msgs/msg/MarkerArray'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
# Names of every length, so that every alignment comes up.
FRAMES = ['', 'a', 'ab', 'abc', 'abcd', 'abcde', 'abcdef', 'abcdefg', 'Halle Süd']


def assert_holds(type_name, data, value):
    """Check what the middleware reads from the bytes, and that it reads all of them."""
    message = decoded(type_name, lambda _: data)(value)
    assert_same(adapter_for(type_name).from_message(message), value)
    assert len(serialize_message(message)) == len(data)


@pytest.mark.parametrize('frame', FRAMES)
@pytest.mark.parametrize('count', [0, 1, 5])
def test_pose_array(frame, count):
    numbers = np.random.default_rng(count).normal(size=(count, 7))
    poses = PoseList(1_700_000_000.0, frame, numbers[:, :3], numbers[:, 3:])
    assert_holds(POSE_ARRAY, pose_array_to_cdr(poses), poses)


@pytest.mark.parametrize('frame', FRAMES)
def test_pose_with_covariance(frame):
    numbers = np.random.default_rng(0).normal(size=43)
    pose = UncertainPose(-1.5, frame, numbers[:3], numbers[3:7], numbers[7:].reshape(6, 6))
    assert_holds(POSE, uncertain_pose_to_cdr(pose), pose)


@pytest.mark.parametrize('frame', FRAMES)
@pytest.mark.parametrize('text', FRAMES)
def test_markers(frame, text):
    points, colors = np.arange(18.0).reshape(6, 3), np.arange(24.0).reshape(6, 4) / 32
    scene = MarkerScene(
        3.5,
        frame,
        (
            Marker(text, 7, Shape.LINE_LIST, points, colors, 0.1),
            Marker('names', 8, Shape.TEXT, points[:1], colors[:1], 0.3, text),
            Marker('none', 9, Shape.SPHERE_LIST, points[:0], colors[:0], 0.3),
        ),
        lifetime_s=1.5,
    )
    for shown in (scene, replace(scene, markers=(), lifetime_s=0.0)):
        assert_holds(MARKERS, marker_scene_to_cdr(shown), shown)


@pytest.mark.parametrize('text', FRAMES)
def test_diagnostics(text):
    statuses = (
        Status(Level.ERROR, text, 'message', text, {'a': text, text: 'value'}),
        Status(Level.OK, 'name', text),
    )
    for diagnostics in (Diagnostics(2.5, statuses), Diagnostics(2.5, ())):
        assert_holds(DIAGNOSTICS, diagnostics_to_cdr(diagnostics), diagnostics)


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
