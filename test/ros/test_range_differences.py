# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Range differences of anchors and odometry only, over DDS: they place a robot on the map."""

import math

from estimates import assert_holds, half_widths_of, pose_from_message
import numpy as np

from msg_adapters import Level, PeersReading

ANCHORS_M = {'a': [-4.0, -3.0], 'b': [4.0, -4.0], 'c': [3.0, 4.0], 'd': [-3.0, 3.0]}
TAG_M = [0.4, 0.1]
ERROR_M = 0.05
DEADLINE_S = 200.0


class Circling:
    """A robot with a tag that circles among anchors, in the time of a simulation."""

    def __init__(self, bench):
        self.bench, self.now_s = bench, 1000.0
        self.rng = np.random.default_rng(5)

    def pose(self, time_s):
        """Return the place (2,) and the yaw."""
        angle = 0.5 * time_s
        return np.array([math.cos(angle), math.sin(angle)]), angle + 0.5 * math.pi

    def send(self):
        """Drive on for a moment, and measure."""
        self.now_s += 0.1
        self.bench.send_clock(self.now_s)
        place_m, yaw = self.pose(self.now_s)
        self.bench.send_odometry('robot_1', place_m, yaw, self.now_s)
        c, s = math.cos(yaw), math.sin(yaw)
        tag_m = place_m + np.array([[c, -s], [s, c]]) @ TAG_M
        far_m = [math.dist(tag_m, place) for place in ANCHORS_M.values()]
        # The points are the robot, the anchors and the tag.
        seconds, unknown = np.array([2, 3, 4]), np.full((3, 3), math.nan)
        errors_m = self.rng.uniform(-ERROR_M, ERROR_M, 3)
        differences_m = np.array([far_m[second - 1] - far_m[0] for second in seconds]) + errors_m
        heard = PeersReading(
            self.now_s,
            seconds,
            unknown[:, 0],
            unknown,
            references=np.ones(3, int),
            differences_m=differences_m,
        )
        self.bench.send('sensor_msgs/msg/PointCloud2', '/robot_1/tag/peers', heard)


def test_a_tag_that_hears_anchors_places_its_robot(bench, make_node):
    make_node(
        covariance='enclosure',
        robots=['robot_1'],
        use_sim_time=True,
        max_future=0.5,
        memory__max_seconds=0.5,
        range_difference__min_error=-ERROR_M,
        range_difference__max_error=ERROR_M,
        mounts__names=['robot_1/tag'],
        mounts__robot_1__tag__position=TAG_M,
        anchors__names=list(ANCHORS_M),
        **{f'anchors__{name}__position': place for name, place in ANCHORS_M.items()},
    )
    bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock', DEADLINE_S)
    robot = Circling(bench)
    bench.sending = [robot.send]

    def placed():
        heard = bench.heard.poses['robot_1']
        pose = pose_from_message(heard[-1]) if heard else None
        return pose if pose and half_widths_of(pose)[:2].max() < 0.5 else None

    pose = bench.until(placed, 'the robot on the map', DEADLINE_S)
    assert pose.frame_id == 'map'
    assert_holds(pose, *robot.pose(pose.stamp_s))
    status = bench.until(
        lambda: bench.status('input range_difference robot_1/tag->c-a'), 'an input'
    )
    assert status.values['topic'] == '/robot_1/tag/peers' and int(status.values['accepted']) > 0
