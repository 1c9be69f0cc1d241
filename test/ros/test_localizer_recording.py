# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Recordings replayed over DDS into the node: a real one, and one under load, as offline."""

from contextlib import ExitStack
from itertools import groupby, pairwise
import subprocess
import sys

import pytest

pytest.importorskip('rosbags', reason='rosbags is not installed')

from processes import start  # noqa: E402
from small_bags import SIMULATION, START_NS, read, record_simulation, write_parameters  # noqa: E402
from uwb_recording import CONFIG  # noqa: E402

from dg_localization.ros.executables import localize_bag  # noqa: E402
from msg_adapters import Level, adapter_for  # noqa: E402

REPLAY_RATE = '3'

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
    bag = record_simulation(tmp_path / 'bag', 12.0, one_after_the_other, **simulated)
    given = {
        'robots': [f'robot_{i}' for i in range(1, 7)],
        'max_speed': 0.35,
        'max_turn_rate': 0.5,
        'bearing': {'half_width': 0.03},
    }
    params = write_parameters(tmp_path, **given)
    assert localize_bag([str(bag), '-o', str(output), '--params', str(params)]) == 0
    offline = frames_of(read(output, '/localizer/feasible_poses')[1])
    assert offline == ['robot_1/base_link', 'robot_1/odom']
    with ExitStack() as stack:
        for _ in range(BUSY):
            process = subprocess.Popen([sys.executable, '-c', 'while True: pass'])
            stack.enter_context(process)
            stack.callback(process.kill)
        process = start_localizer('--params-file', str(params), '-p', 'use_sim_time:=true')
        bench.clear()
        bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock', deadline_s=120.0)
        bench.clear()
        replay = start('replay', bag, stderr=subprocess.DEVNULL)
        bench.until(lambda: replay.poll() is not None, 'the end of the replay', deadline_s=120.0)
        states = dict(bench.heard.statuses)
        assert process.stop()[0] == 0
    assert frames_of(map(poses_from_message, bench.heard.fleet)) == offline
    assert not [name for name, one in states.items() if 'ahead' in one.message]


def test_true_placement_is_in_every_answer(bench, start_localizer, uwb_recording):
    process = start_localizer('--params-file', CONFIG, '-p', 'use_sim_time:=true')
    bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock', deadline_s=60.0)
    paced = uwb_recording.path, '--rate', REPLAY_RATE
    replay = start('replay', *paced, stderr=subprocess.DEVNULL)
    bench.clear()
    bench.until(lambda: replay.poll() is not None, 'the end of the replay', deadline_s=60.0)
    assert replay.returncode == 0
    code, output = process.stop()
    assert code == 0, output
    scenes = [scene_from_message(message) for message in bench.heard.markers]
    assert all(earlier.stamp_s <= later.stamp_s for earlier, later in pairwise(scenes))
    assert uwb_recording.check(scenes) >= 20
