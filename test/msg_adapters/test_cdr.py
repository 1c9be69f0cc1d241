# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Messages serialized without being made: the bytes hold what `to_message` would."""

from dataclasses import replace
import math

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from msg_adapters import (  # noqa: E402
    Diagnostics,
    Level,
    Marker,
    MarkerScene,
    PoseList,
    Shape,
    Status,
    UncertainPose,
)
from msg_adapters.diagnostics import (  # noqa: E402
    diagnostics_to_cdr,
    diagnostics_to_message,
)
from msg_adapters.markers import marker_scene_to_cdr, marker_scene_to_message  # noqa: E402
from msg_adapters.poses import (  # noqa: E402
    pose_array_to_cdr,
    pose_array_to_message,
    uncertain_pose_to_cdr,
    uncertain_pose_to_message,
)

# Names of every length, so that every alignment comes up.
FRAMES = ['', 'a', 'ab', 'abc', 'abcd', 'abcde', 'abcdef', 'abcdefg', 'Halle Süd']


@pytest.mark.parametrize('frame', FRAMES)
@pytest.mark.parametrize('count', [0, 1, 5])
def test_pose_array(frame, count):
    numbers = np.random.default_rng(count).normal(size=(count, 7))
    poses = PoseList(1_700_000_000.25, frame, numbers[:, :3], numbers[:, 3:])
    assert deserialize_message(pose_array_to_cdr(poses), PoseArray) == pose_array_to_message(poses)


@pytest.mark.parametrize('frame', FRAMES)
def test_pose_with_covariance(frame):
    numbers = np.random.default_rng(0).normal(size=43)
    pose = UncertainPose(-1.5, frame, numbers[:3], numbers[3:7], numbers[7:].reshape(6, 6))
    found = deserialize_message(uncertain_pose_to_cdr(pose), PoseWithCovarianceStamped)
    assert found == uncertain_pose_to_message(pose)


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
    for shown in (scene, replace(scene, markers=())):
        found = deserialize_message(marker_scene_to_cdr(shown), MarkerArray)
        assert found == marker_scene_to_message(shown)


@pytest.mark.parametrize('text', FRAMES)
def test_diagnostics(text):
    statuses = (
        Status(Level.ERROR, text, 'message', text, {'a': text, text: 'value'}),
        Status(Level.OK, 'name', text),
    )
    for diagnostics in (Diagnostics(2.5, statuses), Diagnostics(2.5, ())):
        found = deserialize_message(diagnostics_to_cdr(diagnostics), DiagnosticArray)
        assert found == diagnostics_to_message(diagnostics)


def test_equal_values_give_equal_bytes():
    poses = PoseList(1.0, 'm', np.ones((2, 3)), np.ones((2, 4)))
    assert pose_array_to_cdr(poses) == pose_array_to_cdr(poses)


def test_unknown_position_survives():
    poses = PoseList(1.0, 'm', np.full((1, 3), math.nan), np.zeros((1, 4)))
    (pose,) = deserialize_message(pose_array_to_cdr(poses), PoseArray).poses
    assert math.isnan(pose.position.x)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError):
        pose_array_to_cdr(PoseList(1.0, 'm', np.ones((2, 3)), np.ones((1, 4))))
    with pytest.raises(ValueError, match=r'covariance has shape \(3, 3\)'):
        uncertain_pose_to_cdr(UncertainPose(1.0, 'm', np.ones(3), np.ones(4), np.ones((3, 3))))
    marker = Marker('robots', 4, Shape.SPHERE_LIST, np.ones((2, 3)), np.ones((1, 4)), 0.1)
    with pytest.raises(ValueError, match='robots/4 has 2 points and 1 colors'):
        marker_scene_to_cdr(MarkerScene(1.0, 'm', (marker,)))
    with pytest.raises(ValueError, match='stamp nan s is not finite'):
        pose_array_to_cdr(PoseList(math.nan, 'm', np.ones((1, 3)), np.ones((1, 4))))
