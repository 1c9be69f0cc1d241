# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The real ultra-wideband recording replayed over DDS into the node: its config file, no code."""

from itertools import pairwise
import os
import subprocess
import sys

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')
pytest.importorskip('rosbags', reason='rosbags is not installed')

from uwb_recording import CONFIG  # noqa: E402

from msg_adapters import Level, adapter_for  # noqa: E402

REPLAY_RATE = '3'

scene_from_message = adapter_for('visualization_msgs/msg/MarkerArray').from_message


def test_true_placement_is_in_every_answer(bench, start_localizer, uwb_recording):
    process = start_localizer('--params-file', CONFIG, '-p', 'use_sim_time:=true')
    bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock', deadline_s=60.0)
    bag = str(uwb_recording.path)
    replay = subprocess.Popen(
        [sys.executable, '-m', 'dg_localization.ros', 'replay', bag, '--rate', REPLAY_RATE],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ,
    )
    bench.clear()
    bench.until(lambda: replay.poll() is not None, 'the end of the replay', deadline_s=60.0)
    assert replay.returncode == 0
    code, output = process.stop()
    assert code == 0, output
    scenes = [scene_from_message(message) for message in bench.heard.markers]
    assert all(earlier.stamp_s <= later.stamp_s for earlier, later in pairwise(scenes))
    assert uwb_recording.check(scenes) >= 20
