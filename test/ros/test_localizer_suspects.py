# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Wrong and stuck sensors, over DDS: whom the diagnostics of the node name."""

from functools import partial

import numpy as np

from msg_adapters import Level, adapter_for

odometry_to_message = adapter_for('nav_msgs/msg/Odometry').to_message


def send_square(bench, off_m):
    """Send the ranges of a square of 4 m with its diagonals; robot_1's may be off."""
    places = {'robot_1': (0, 0), 'robot_2': (4, 0), 'robot_3': (4, 4), 'robot_4': (0, 4)}
    stamp_s = bench.now_s()
    for observer, here in places.items():
        for target, there in places.items():
            if observer != target:
                range_m = float(np.hypot(there[0] - here[0], there[1] - here[1]))
                wrong = off_m if observer == 'robot_1' else 0.0
                bench.send_range(observer, target, range_m + wrong, stamp_s=stamp_s)


def test_a_sensor_that_lies_is_named_and_counted(bench, make_node):
    robots = [f'robot_{i}' for i in range(1, 5)]
    make_node(
        robots=robots,
        max_outliers=1,
        outlier_unit='sensor',
        max_speed=0.01,
        conflicts__max_seconds=20.0,
    )
    bench.sending = [partial(send_square, bench, 2.0)]
    text = "robot_1's ranging was among the suspects in"
    status = bench.until_status('fleet', Level.WARN, text, deadline_s=60.0)
    assert status.values['suspects'] == "robot_1's ranging"
    assert status.values['offender_0'].startswith(text)
    assert status.values['offender_0'].endswith('contradictions of the last 60 s')
