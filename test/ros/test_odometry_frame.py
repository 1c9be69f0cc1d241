# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Over DDS: the frame of the answers is that of the odometry of the reference robot."""

import math

from nav_msgs.msg import Odometry
import numpy as np

from msg_adapters import Level, OdometryReading, adapter_for

PLACE_M, YAW_RAD = np.array([12.0, -5.0]), 1.1
"""Of the reference robot in its odometry frame, as its odometry states it."""

odometry_to_message = adapter_for('nav_msgs/msg/Odometry').to_message
poses_from_message = adapter_for('geometry_msgs/msg/PoseArray').from_message


def truth_in_odometry_frame(fleet):
    places, yaws = fleet.in_frame_of(0)
    c, s = math.cos(YAW_RAD), math.sin(YAW_RAD)
    return places @ np.array([[c, s], [-s, c]]) + PLACE_M, yaws + YAW_RAD


def test_bearings_stop_and_no_robot_jumps_under_the_same_name(bench, make_node, paper_fleet):
    make_node(robots=paper_fleet.robots, max_speed=0.1, max_turn_rate=0.1, memory__seconds=0.0)

    def send_odometry():
        orientation = np.array([0.0, 0.0, math.sin(YAW_RAD / 2.0), math.cos(YAW_RAD / 2.0)])
        reading = OdometryReading(bench.now_s(), np.array([*PLACE_M, 0.0]), orientation, 'odom')
        bench.publisher(Odometry, '/robot_1/odom').publish(odometry_to_message(reading))

    bench.play(paper_fleet, cameras=True)
    bench.sending.append(send_odometry)

    def answers_in(name):
        return [m for m in bench.heard.fleet if m.header.frame_id == name and m.poses]

    bench.until(lambda: answers_in('odom'), 'an answer in the odometry frame')
    places, yaws = truth_in_odometry_frame(paper_fleet)
    poses = poses_from_message(answers_in('odom')[-1])
    assert np.abs(poses.positions_m[:, :2] - places).max() < 0.7
    z, w = poses.orientations_xyzw[0, 2:]
    assert abs(math.remainder(2.0 * math.atan2(z, w) - yaws[0], 2.0 * math.pi)) < 0.05
    frame = 'odometry frame odom of robot_1'
    bench.until(lambda: dict(bench.status('fleet').values).get('frame') == frame, 'the name')

    bench.play(paper_fleet, cameras=False)
    bench.sending.append(send_odometry)
    bench.until_status('fleet', Level.WARN, f'the frame has changed: {frame} before')
    bench.until(lambda: answers_in('fleet'), 'an answer that is a shape only')
    for message in answers_in('odom'):
        positions = poses_from_message(message).positions_m[:, :2].reshape(-1, 6, 2)
        # For the two seconds that the frame is kept, the mirror image is a hypothesis, too.
        assert np.abs(positions - places).max(axis=(1, 2)).min() < 0.7
