# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The time of a node: jumps, and standing still."""

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from dg_localization.ros.node.clock import NodeTime  # noqa: E402


def test_jump_back_is_seen_once_and_standing_still_is_measured_on_another_clock():
    clock, steady = {'s': 100.0}, {'s': 0.0}
    node_time = NodeTime(lambda: clock['s'], lambda: steady['s'])
    assert node_time.now() == (100.0, 0.0)
    clock['s'], steady['s'] = 101.0, 1.0
    assert node_time.now() == (101.0, 0.0)
    steady['s'] = 5.0
    assert node_time.now() == (101.0, 0.0)
    assert node_time.stands_still_s() == 4.0
    clock['s'] = 90.0
    assert node_time.now() == (90.0, 11.0)
    assert node_time.now() == (90.0, 0.0)
    assert node_time.stands_still_s() == 0.0
