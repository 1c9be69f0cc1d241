# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Ranges and odometry only, over DDS: they end with one hypothesis and headings."""

from itertools import combinations
import math
import time

from heard_poses import assert_holds, half_widths_of, pose_from_message
from nav_msgs.msg import Odometry
import numpy as np

from msg_adapters import Level, OdometryReading, adapter_for

ROBOTS = ('robot_1', 'robot_2', 'robot_3')
CENTERS = np.array([[0.0, 0.0], [4.0, 0.5], [1.5, 3.5]])
RADII_M = np.array([0.8, 0.7, 1.0])
RATES = np.array([0.5, -0.8, 0.6])
STEP_S = 0.2
DEADLINE_S = 200.0
PATIENCE_S = 0.5

RANGE_ERROR = 0.03
ODOMETRY_ERROR = 0.05
DRIFT = 1.0 + 0.8 * ODOMETRY_ERROR
"""Robots go and turn this much farther than their odometry says."""

odometry_to_message = adapter_for('nav_msgs/msg/Odometry').to_message


class Circling:
    """Robots that drive in circles in the time of a simulation."""

    def __init__(self, bench):
        self.bench = bench
        self.now_s = 1000.0
        self.sent_at_s = -math.inf
        self.rng = np.random.default_rng(4)

    def poses(self, time_s):
        """Return positions (n, 2) and yaws (n,)."""
        angles = RATES * time_s + np.arange(len(ROBOTS))
        around = RADII_M[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return CENTERS + around, angles + np.sign(RATES) * 0.5 * math.pi

    def send(self):
        """Drive on for a moment, and measure, unless the node is still at what was before."""
        heard = self.bench.heard.fleet
        stamp = heard[-1].header.stamp if heard else None
        answered = stamp and self.now_s - stamp.sec - stamp.nanosec * 1e-9 < 2.0 * STEP_S
        if not answered and time.monotonic() < self.sent_at_s + PATIENCE_S:
            return
        self.sent_at_s = time.monotonic()
        self.now_s += STEP_S
        self.bench.send_clock(self.now_s)
        for robot, place, yaw in zip(ROBOTS, *self.poses(self.now_s / DRIFT), strict=True):
            orientation = np.array([0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)])
            reading = OdometryReading(self.now_s, np.array([*place, 0.0]), orientation)
            publisher = self.bench.publisher(Odometry, f'/{robot}/odom')
            publisher.publish(odometry_to_message(reading))
        places, _ = self.poses(self.now_s)
        for i, j in combinations(range(len(ROBOTS)), 2):
            error = self.rng.uniform(-RANGE_ERROR, RANGE_ERROR)
            range_m = float(np.linalg.norm(places[j] - places[i])) / (1.0 + error)
            self.bench.send_range(ROBOTS[i], ROBOTS[j], range_m, stamp_s=self.now_s)

    def in_fleet_frame(self, time_s):
        """Return positions and yaws with the first robot at the origin and the second on x."""
        places, yaws = self.poses(time_s)
        local = places - places[0]
        angle = math.atan2(local[1, 1], local[1, 0])
        c, s = math.cos(angle), math.sin(angle)
        return local @ np.array([[c, -s], [s, c]]), yaws - angle


def test_robots_that_move_end_with_one_hypothesis_and_headings(bench, make_node):
    make_node(
        covariance='enclosure',
        robots=list(ROBOTS),
        use_sim_time=True,
        max_future=0.5,
        max_age=0.3,
        max_turn_rate=2.0,
        memory__max_seconds=0.5,
        range__min_error_relative=-RANGE_ERROR,
        range__max_error_relative=RANGE_ERROR,
        odometry__translation_per_m=ODOMETRY_ERROR,
        odometry__rotation_per_m=0.0,
        odometry__rotation_per_rad=ODOMETRY_ERROR,
        odometry__constant_translation=0.0,
        odometry__constant_rotation=0.0,
    )
    bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock', DEADLINE_S)
    fleet = Circling(bench)
    bench.sending = [fleet.send]

    def localized():
        # A busy machine is slower than the rate, which is worth a warning of its own.
        status = bench.status('fleet')
        if status is None or 'one hypothesis' not in status.message:
            return None
        return status.values.get('ruled_out')

    ruled_out = bench.until(localized, 'one hypothesis, others ruled out', DEADLINE_S)
    assert 'mirror image ruled out by' in ruled_out

    def headed():
        heard = [bench.heard.poses[robot] for robot in ROBOTS]
        if not all(heard):
            return None
        poses = [pose_from_message(messages[-1]) for messages in heard]
        half_widths = [half_widths_of(pose)[5] for pose in poses]
        same_time = len({pose.stamp_s for pose in poses}) == 1
        return poses if same_time and max(half_widths) < 1.0 else None

    poses = bench.until(headed, 'headings of all robots', DEADLINE_S)
    positions, yaws = fleet.in_fleet_frame(poses[0].stamp_s)
    for row, pose in enumerate(poses):
        assert_holds(pose, positions[row], yaws[row])
