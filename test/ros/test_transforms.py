# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Transforms: when they are published, between which frames, and their values."""

from dataclasses import replace
from importlib.util import find_spec
import math
import sys
from types import ModuleType

from estimates import placement_at
import numpy as np
import pytest
from std_msgs.msg import ByteMultiArray

from dg_localization.fleet import Estimate, FixedFrame, FleetConfig, FrameKind, OdometryErrorModel
from dg_localization.fleet.motion import Motion
from dg_localization.fleet.rotations import quaternion_of_yaw, rotation_of_quaternion
from dg_localization.fleet.vocabulary import OdometrySample as Pose
from dg_localization.ros.interface.parameters.spec import WrongParameterError
from dg_localization.ros.interface.poses import transforms
from msg_adapters import Level
from msg_adapters.headers import xyzw_from_message

STAMP_S = 100.0
ANCHORED = FixedFrame(FrameKind.ANCHORS, ('p', 'q', 'r'))


def odometry_of(*poses, frame='a/odom', xyzw=None, z=0.0):
    """Return odometry with poses of (stamp, x, y, yaw)."""
    return tuple(
        Pose(
            stamp_s,
            np.array([x, y, z]),
            rotation_of_quaternion(quaternion_of_yaw(yaw_rad) if xyzw is None else xyzw),
            frame,
        )
        for stamp_s, x, y, yaw_rad in poses
    )


def at_rest(**frames):
    return odometry_of((99.9, 0.0, 0.0, 0.0), (100.1, 0.0, 0.0, 0.0), **frames)


def estimate(frame=ANCHORED, n_hypotheses=1, yaws_rad=(0.5 * math.pi, 0.0), known=(True, True)):
    """Return an estimate of robot a at (3, 4), robot b at (1, 0)."""
    placed = placement_at(
        [[3.0, 4.0], [1.0, 0.0]],
        orientations_xyzw=np.array([quaternion_of_yaw(yaw) for yaw in yaws_rad]),
        heading_known=np.array(known),
        heading_half_width_rad=np.array([0.1, 0.1]),
    )
    placements = (placed,) * n_hypotheses
    return Estimate(STAMP_S, ('a', 'b'), None, '', placements, n_hypotheses, frame=frame)


def children(found):
    return {entry.child_frame_id for entry in found}


def found_of(made, odometry=(), body='a/base_link', **others):
    """Return the transforms of an estimate with odometry of robot a."""
    tracks = {'a': odometry, **others} if odometry else others
    config = FleetConfig(('a', 'b'), odometry_error=OdometryErrorModel(max_gap_s=0.5))
    return transforms(made, 'map', Motion(config, tracks), {'a': body})


def test_a_chain_of_transforms_ends_at_the_body():
    """Between the poses of odometry, and a little beyond them."""
    rng = np.random.default_rng(1)
    for fraction in (0.0, 0.25, 0.5, 1.0, 1.5):
        x, y, yaw, turned = rng.uniform(-3.0, 3.0, 4)
        start_s = STAMP_S - 0.2 * fraction
        poses = (start_s, x, y, yaw), (start_s + 0.2, x + 0.1, y, yaw + 0.2)
        (found, _) = found_of(estimate(yaws_rad=(turned, 0.0)), odometry_of(*poses))
        assert found.child_frame_id == 'a/odom'
        rotation = rotation_of_quaternion(found.rotation_xyzw)
        body_m = found.translation_m + rotation @ [x + 0.1 * fraction, y, 0.0]
        assert body_m == pytest.approx([3.0, 4.0, 0.0])
        body = rotation @ rotation_of_quaternion(quaternion_of_yaw(yaw + 0.2 * fraction))
        assert body == pytest.approx(rotation_of_quaternion(quaternion_of_yaw(turned)))


def at(*stamps_s):
    return odometry_of(*((stamp_s, 0.0, 0.0, 0.0) for stamp_s in stamps_s))


SHARED = at_rest(frame='odom')
B = 'b/base_link'


@pytest.mark.parametrize(
    ('changes', 'odometry', 'others', 'expected'),
    [
        # Silence, unless one hypothesis is left in the frame of the anchors.
        ({'frame': FixedFrame(FrameKind.HEADING, ('a',))}, (), {}, set()),
        ({'frame': None}, (), {}, set()),
        ({'n_hypotheses': 0}, (), {}, set()),
        ({'n_hypotheses': 2}, (), {}, set()),
        ({'known': (False, True)}, (), {}, {B}),
        # Odometry that does not reach the estimate gives silence, not another child.
        ({}, at(10.0, 10.1), {}, {B}),
        ({}, at(100.1, 100.2), {}, {B}),
        ({}, at(STAMP_S), {}, {B}),
        ({}, at(99.7, 100.3), {}, {B}),
        # Nor does odometry from before a restart, whose frame may have another name since.
        ({}, (*at_rest(), replace(at(100.2)[0], frame='new', restarted_s=100.2)), {}, {B}),
        # Odometry without a frame names the body alone; no frame is placed in itself.
        ({}, at_rest(frame=''), {'body': 'a_body'}, {'a_body', B}),
        ({}, at_rest(frame=''), {'body': ''}, {'a/base_link', B}),
        ({}, at_rest(frame='map'), {'body': 'a_body'}, {B}),
        ({}, at_rest(frame=''), {'body': 'map'}, {B}),
        # A frame that two robots call their own is that of neither, wherever one of them is.
        ({}, SHARED, {'b': SHARED}, set()),
        ({'known': (True, False)}, SHARED, {'b': SHARED}, set()),
    ],
)
def test_only_what_is_known_is_placed(changes, odometry, others, expected):
    assert children(found_of(estimate(**changes), odometry, **others)) == expected


def test_a_robot_whose_odometry_is_awaited_has_no_transform():
    motion = Motion(FleetConfig(('a', 'b')), {})
    assert children(transforms(estimate(), 'map', motion, {}, awaited={'a'})) == {B}


def test_in_the_plane_a_ramp_does_not_tilt_the_odometry_frame():
    tilted = np.array([0.0, math.sin(0.1), 0.0, math.cos(0.1)])
    poses = (99.9, 10.0, 0.0, 0.0), (100.1, 10.0, 0.0, 0.0)
    found = found_of(estimate(yaws_rad=(0.0, 0.0)), odometry_of(*poses, xyzw=tilted, z=1.0))
    assert found[0].translation_m == pytest.approx([-7.0, 4.0, 0.0])
    assert np.abs(found[0].rotation_xyzw) == pytest.approx([0.0, 0.0, 0.0, 1.0])


@pytest.mark.skipif(find_spec('tf2_msgs') is not None, reason='tf2_msgs is installed')
def test_a_package_that_is_missing_is_named(make_node):
    with pytest.raises(WrongParameterError, match='publish_tf.*tf2_msgs.*apt install'):
        make_node(publish_tf=True)


@pytest.fixture
def heard(bench, monkeypatch):
    """
    Return the transforms on /tf, message by message, newest last.

    Without tf2_msgs the same bytes are sent with another class.
    """
    if find_spec('tf2_msgs') is None:
        for name in ('tf2_msgs', 'tf2_msgs.msg'):
            monkeypatch.setitem(sys.modules, name, ModuleType(name))
        messages = sys.modules['tf2_msgs.msg']
        monkeypatch.setattr(messages, 'TFMessage', ByteMultiArray, raising=False)
    transform_class = sys.modules['tf2_msgs.msg'].TFMessage
    typesys = pytest.importorskip('rosbags.typesys', reason='rosbags is not installed')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    found = []

    def take(data):
        message = store.deserialize_cdr(bytes(data), 'tf2_msgs/msg/TFMessage')
        found.append(message.transforms)

    subscription = bench.node.create_subscription(transform_class, '/tf', take, 10, raw=True)
    yield found
    bench.node.destroy_subscription(subscription)


ANCHORS = {'p': (0.0, 0.0), 'q': (8.0, 0.0), 'r': (0.0, 8.0)}
PLACE, YAW_RAD = np.array([3.0, 4.0]), 0.7


def send_anchored_robot(bench):
    """Send what robot_1 at PLACE measures of the anchors."""
    for name, anchor in ANCHORS.items():
        gap = np.array(anchor) - PLACE
        angle = math.atan2(gap[1], gap[0]) - YAW_RAD
        bench.send_range('robot_1', name, float(np.linalg.norm(gap)))
        bench.send_bearing('robot_1', name, np.array([math.cos(angle), math.sin(angle), 0.0]))


def make_anchored_node(make_node, **parameters):
    places = {f'anchors__{name}__position': list(place) for name, place in ANCHORS.items()}
    return make_node(
        robots=['robot_1'],
        anchors__names=list(ANCHORS),
        max_speed=0.1,
        max_turn_rate=0.1,
        **places,
        **parameters,
    )


def place_of(entry):
    """Return where the origin of a transform is, in the plane."""
    return np.array([entry.transform.translation.x, entry.transform.translation.y])


def test_the_node_places_the_body_and_falls_silent_with_its_sensors(bench, make_node, heard):
    make_anchored_node(make_node, publish_tf=True)
    bench.sending = [lambda: send_anchored_robot(bench)]
    bench.until(lambda: heard, 'a transform')
    ((entry,), *_) = heard
    assert (entry.header.frame_id, entry.child_frame_id) == ('map', 'robot_1/base_link')
    assert place_of(entry) == pytest.approx(PLACE, abs=0.4)
    turned = xyzw_from_message(entry.transform.rotation)
    assert abs(turned @ quaternion_of_yaw(YAW_RAD)) > math.cos(0.1)
    bench.sending = []
    bench.until_status('fleet', Level.WARN, 'stale')
    del heard[:]
    bench.clear()
    bench.until_status('fleet', Level.WARN, 'stale')
    assert not heard


def test_no_time_has_two_transforms(bench, make_node, heard):
    """Answers that come more often than the odometry are for the same time."""
    make_anchored_node(make_node, publish_tf=True, rate=25.0)
    sent_s = []

    def send():
        send_anchored_robot(bench)
        if not sent_s or bench.now_s() - sent_s[-1] >= 0.1:
            sent_s.append(bench.now_s())
            bench.send_odometry('robot_1', (0.0, 0.0))

    bench.sending = [send]
    bench.until(lambda: len(heard) > 10, 'transforms')
    stamps = {(entry.header.stamp.sec, entry.header.stamp.nanosec) for (entry,) in heard}
    assert len(stamps) == len(heard)


def test_nothing_lies_between_poses_before_and_after_a_restart(bench, make_node, heard):
    """A driver that starts anew counts from another place, under the same name of the frame."""
    # Without memory answers are for now, and so between two poses, or beyond the last one.
    make_anchored_node(make_node, publish_tf=True, rate=50.0, memory__seconds=0.0)
    n_sent = [0]

    def send():
        send_anchored_robot(bench)
        n_sent[0] += 1
        # The robot stands still; every half second its odometry starts anew.
        bench.send_odometry('robot_1', (50.0 if n_sent[0] // 5 % 2 else 1.0, 2.0))

    bench.sending = [send]
    bench.until(lambda: n_sent[0] > 40 and len(heard) > 40, 'transforms')
    # Where frames are in which the robot is at these places.
    axes = rotation_of_quaternion(quaternion_of_yaw(YAW_RAD))[:2, :2]
    true_places = [PLACE - axes @ [x, 2.0] for x in (1.0, 50.0)]
    for (entry,) in heard:
        off_m = min(np.linalg.norm(place_of(entry) - true) for true in true_places)
        # A heading error of 0.1 rad is 5 m at the end of 50 m.
        assert off_m < 6.0, entry
