# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Recordings replayed over DDS into the node: a real one, and one under load, as offline."""

from contextlib import ExitStack
from itertools import groupby, pairwise
import subprocess
import sys

import numpy as np
from processes import REPOSITORY, start
from small_bags import SIMULATION, START_NS, read, record_simulation, write_parameters

from dg_localization.ros.bags.bag import open_bag
from dg_localization.ros.bags.offline import read_task
from dg_localization.ros.bags.truth import read_truth
from dg_localization.ros.executables import localize_bag
from msg_adapters import Level, adapter_for

REPLAY_RATE, LAST_S = '3', 15.0
CONFIG = 'config/tiers_uwb.yaml'

poses_from_message = adapter_for('geometry_msgs/msg/PoseArray').from_message
scene_from_message = adapter_for('visualization_msgs/msg/MarkerArray').from_message

BUSY = 2
BEGIN_S = {'range': 1, 'odom': 4}
"""When sensors begin; cameras see from the start, so that the first answer has bearings."""


def one_after_the_other(topic, message):
    """Leave out what a sensor measured before it began."""
    begin_s = next((begin_s for kind, begin_s in BEGIN_S.items() if f'/{kind}' in topic), 0)
    return message if message.header.stamp.sec >= START_NS // 10**9 + begin_s else None


def frames_of(arrays):
    """Return the frames of answers with placements, in their order, each run of one once."""
    return [name for name, _ in groupby(one.frame_id for one in arrays if len(one.positions_m))]


def test_frames_on_a_busy_machine_are_those_of_the_bag(bench, start_localizer, tmp_path):
    output = tmp_path / 'answers'
    simulated = {'odometry': True, 'speed': 0.3, 'path': SIMULATION['path'].default}
    bag = record_simulation(tmp_path / 'bag', 10.0, one_after_the_other, **simulated)
    given = {
        'robots': [f'robot_{i}' for i in range(1, 7)],
        'max_speed': 0.35,
        'max_turn_rate': 0.5,
        'bearing': {'half_width': 0.03},
    }
    params = write_parameters(tmp_path, **given)
    process = start_localizer('--params-file', str(params), '-p', 'use_sim_time:=true')
    assert localize_bag([str(bag), '-o', str(output), '--params', str(params)]) == 0
    offline = frames_of(read(output, '/localizer/feasible_poses')[1])
    assert offline == ['robot_1/base_link', 'robot_1/odom']
    bench.clear()
    bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock')
    bench.clear()
    with ExitStack() as stack:
        for _ in range(BUSY):
            busy = subprocess.Popen([sys.executable, '-c', 'while True: pass'])
            stack.enter_context(busy)
            stack.callback(busy.kill)
        replay = start('replay', bag, stderr=subprocess.DEVNULL)
        bench.until(lambda: replay.poll() is not None, 'the end of the replay', deadline_s=120.0)
        states = dict(bench.heard.statuses)
        assert process.stop()[0] == 0
    assert frames_of(map(poses_from_message, bench.heard.fleet)) == offline
    assert not [name for name, one in states.items() if 'ahead' in one.message]


def true_places(bag):
    """Return a function of the stamp: true places with one at 0 and one on the x axis, complex."""
    settings = read_task(REPOSITORY / CONFIG, []).settings
    with open_bag(bag) as opened:
        poses = read_truth(['/vrpn_client_node/{robot}_cap/pose'], settings, opened).poses
    columns = [zip(*poses[robot], strict=True) for robot in settings.fleet.robots]
    tracks = [(stamps_s, np.array(places) @ [1.0, 1.0j, 0.0]) for stamps_s, places, _ in columns]

    def places_at(stamp_s):
        places = np.array([np.interp(stamp_s, *track) for track in tracks])
        places -= places[0]
        return places * abs(places[1]) / places[1]

    return places_at, min(stamps_s[-1] for stamps_s, _ in tracks)


def test_true_placement_is_in_every_answer(bench, start_localizer, shared):
    bag = shared / 'data/tiers_uwb/rosbag2_shortbag'
    process = start_localizer('--params-file', CONFIG, '-p', 'use_sim_time:=true')
    bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock', deadline_s=60.0)
    replay = start('replay', bag, '--rate', REPLAY_RATE, stderr=subprocess.DEVNULL)
    bench.clear()
    bench.until(lambda: replay.poll() is not None, 'the end of the replay', deadline_s=60.0)
    assert replay.returncode == 0
    code, output = process.stop()
    assert code == 0, output
    scenes = [scene_from_message(message) for message in bench.heard.markers]
    assert all(earlier.stamp_s <= later.stamp_s for earlier, later in pairwise(scenes))
    places_at, end_s = true_places(bag)
    last = [scene for scene in scenes if end_s - LAST_S <= scene.stamp_s <= end_s]
    assert len(last) >= 20
    for scene in last:
        drawn = [marker.points_m for marker in scene.markers if marker.namespace == 'enclosures']
        # By hypothesis and robot, the eight ends of the edges of a rectangle.
        ends = np.reshape(drawn, (-1, 4, 8, 3)) @ [1.0, 1.0j, 0.0]
        # Mirror images; while a robot may be on either side of a pair, each is in two parts.
        assert len(ends) in (2, 4), f'{len(ends)} hypotheses at {scene.stamp_s}'
        off = ends - places_at(scene.stamp_s)[:, None]
        axes = np.stack([off.real, off.imag])
        inside = (axes.min(-1) <= 1e-9) & (axes.max(-1) >= -1e-9)
        assert inside.all(axis=(0, 2)).any(), f'no hypothesis is true at {scene.stamp_s}'
