"""The real ultra-wideband recording replayed over DDS into the node: its config file, no code."""

from itertools import pairwise
import os
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')
highlevel = pytest.importorskip('rosbags.highlevel', reason='rosbags is not installed')

from rosbags.typesys import Stores, get_typestore  # noqa: E402

from msg_adapters import Level, adapter_for  # noqa: E402

CONFIG = 'config/tiers_uwb.yaml'
# As in the file: the frame has its origin at the first and its x axis towards the second.
ROBOTS = (1, 3, 4, 5)
REPLAY_RATE = '3'
LAST_S = 15.0

scene_from_message = adapter_for('visualization_msgs/msg/MarkerArray').from_message


@pytest.fixture(scope='module')
def bag(shared):
    return shared / 'data/tiers_uwb/rosbag2_shortbag'


@pytest.fixture(scope='module')
def motion_capture(bag):
    """Return for each robot its times in s and its positions."""
    store = get_typestore(Stores.ROS2_FOXY)
    rows = {robot: [] for robot in ROBOTS}
    topics = {f'/vrpn_client_node/turtlebot{robot}_cap/pose': robot for robot in ROBOTS}
    with highlevel.AnyReader([bag], default_typestore=store) as reader:
        connections = [c for c in reader.connections if c.topic in topics]
        for connection, time_ns, raw in reader.messages(connections):
            position = reader.deserialize(raw, connection.msgtype).pose.position
            rows[topics[connection.topic]].append((time_ns * 1e-9, position.x, position.y))
    return {robot: np.array(track) for robot, track in rows.items()}


def truth_in_frame(motion_capture, stamp_s):
    """Return the positions at a time with the first robot at 0 and the second on the x axis."""
    tracks = [motion_capture[robot] for robot in ROBOTS]
    positions = np.array(
        [[np.interp(stamp_s, t[:, 0], t[:, axis]) for axis in (1, 2)] for t in tracks]
    )
    positions -= positions[0]
    x, y = positions[1] / np.linalg.norm(positions[1])
    return positions @ np.array([[x, -y], [y, x]])


def enclosures(scene):
    """Return the boxes that were drawn, shape (hypothesis, robot, 2, 2)."""
    drawn = [marker.points_m for marker in scene.markers if marker.namespace == 'enclosures']
    edges = np.reshape(drawn, (-1, len(ROBOTS), 8, 3))[..., :2]
    return np.stack([edges.min(axis=2), edges.max(axis=2)], axis=2)


def test_true_placement_is_in_every_answer(bench, start_localizer, bag, motion_capture):
    process = start_localizer('--params-file', CONFIG, '-p', 'use_sim_time:=true')
    bench.until_status('fleet', Level.WARN, '/clock', deadline_s=60.0)
    replay = subprocess.Popen(
        [sys.executable, '-m', 'dg_localization.ros.replay', str(bag), '--rate', REPLAY_RATE],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ,
    )
    bench.clear()
    bench.until(lambda: replay.poll() is not None, 'the end of the replay', deadline_s=60.0)
    assert replay.returncode == 0
    code, output = process.stop()
    assert code == 0, output
    end_s = min(track[-1, 0] for track in motion_capture.values())
    scenes = [scene_from_message(message) for message in bench.heard.markers]
    assert all(earlier.stamp_s <= later.stamp_s for earlier, later in pairwise(scenes))
    last = [scene for scene in scenes if end_s - LAST_S <= scene.stamp_s <= end_s]
    assert len(last) >= 20
    for scene in last:
        truth = truth_in_frame(motion_capture, scene.stamp_s)
        boxes = enclosures(scene)
        assert len(boxes) == 2, f'{len(boxes)} hypotheses at {scene.stamp_s}'
        inside = (boxes[:, :, 0] <= truth + 1e-9) & (truth <= boxes[:, :, 1] + 1e-9)
        assert inside.all(axis=(1, 2)).any(), f'the truth is in no hypothesis at {scene.stamp_s}'
