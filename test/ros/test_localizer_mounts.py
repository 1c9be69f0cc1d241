# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A robot with two tags among beacons, over DDS: its heading follows from the tags alone."""

import math

from heard_poses import assert_holds, half_widths_of, pose_from_message
import numpy as np

from msg_adapters import Level

BEACONS = {'beacon_1': (0.0, 0.0), 'beacon_2': (6.0, 0.0), 'beacon_3': (1.0, 5.0)}
TAGS = {'left': (0.2, 0.8), 'right': (0.2, -0.8)}
PLACE_M, YAW_RAD = np.array([3.0, 2.0]), 0.7
ERROR_M = 0.02


def range_m(tag, beacon):
    c, s = math.cos(YAW_RAD), math.sin(YAW_RAD)
    place_m = PLACE_M + np.array([[c, -s], [s, c]]) @ TAGS[tag]
    return math.dist(place_m, BEACONS[beacon]) + ERROR_M / 2.0


def test_two_tags_give_a_pose_by_template_link_and_peers(bench, make_node):
    parameters = {
        f'anchors.{name}.position': [float(x) for x in place] for name, place in BEACONS.items()
    }
    parameters |= {
        f'mounts.robot_1.{tag}.position': [float(x) for x in place] for tag, place in TAGS.items()
    }
    make_node(
        covariance='enclosure',
        **parameters,
        **{
            'robots': ['robot_1'],
            'anchors.names': list(BEACONS),
            'mounts.names': [f'robot_1/{tag}' for tag in TAGS],
            'range.min_error': -ERROR_M,
            'range.max_error': ERROR_M,
            'range.min_error_relative': 0.0,
            'range.max_error_relative': 0.0,
            'links': ['/uwb/right_1 sensor_msgs/msg/Range robot_1/right beacon_1'],
        },
    )
    topic = '/uwb/right_1'
    # Peers are numbered: the robot, three beacons, the tags.
    rows = {1 + k: (range_m('right', f'beacon_{k + 1}'), np.full(3, math.nan)) for k in (1, 2)}
    bench.repeat(
        *(
            lambda name=name: bench.send_range('robot_1/left', name, range_m('left', name))
            for name in BEACONS
        ),
        lambda: bench.send_range('', '', range_m('right', 'beacon_1'), topic=topic),
        lambda: bench.send_peers('robot_1/right', rows),
    )
    bench.until_status('robot robot_1', Level.OK, 'localized')
    bench.clear()

    def poses():
        return [pose_from_message(message) for message in bench.heard.poses['robot_1']]

    # An answer of a busy machine may be coarser than the next one.
    bench.until(lambda: any(half_widths_of(pose)[5] < 0.3 for pose in poses()), 'a heading')
    for pose in poses():
        assert_holds(pose, PLACE_M, YAW_RAD)
