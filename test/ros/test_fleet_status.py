# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The screen of `fleet_status`: one localizer among the diagnostics of others."""

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402

from dg_localization.ros.fleet_status import FleetStatusNode, screen  # noqa: E402
from msg_adapters import Diagnostics, Level, Status, adapter_for  # noqa: E402

to_message = adapter_for('diagnostic_msgs/msg/DiagnosticArray').to_message

FLEET = (
    Status(
        Level.WARN,
        'localizer: fleet',
        'ambiguous: 2 hypotheses',
        values={
            'hypotheses': '2',
            'frame': 'fleet',
            'inputs': '4',
            'inputs_in_use': '3',
            'rate_hz': '5.00',
            'would_fix': 'range a - d would fix the hinge at b; drive c',
        },
    ),
    Status(Level.OK, 'localizer: robot a', 'localized', values={'hypothesis_3': 'at 1 2 m'}),
    Status(Level.ERROR, 'localizer: robot long_name', 'its measurements contradict each other'),
    Status(Level.OK, 'localizer: input range a->b', 'in use'),
    Status(Level.WARN, 'localizer: input range b->c', 'stale'),
)


def test_the_screen_has_the_fleet_each_robot_bad_inputs_and_what_to_do():
    lines = list(screen('localizer', FLEET, 0.5))
    assert lines[0] == 'localizer: WARN: ambiguous: 2 hypotheses'
    assert lines[1] == ('2 hypotheses in frame fleet, 3 of 4 inputs in use, 5.00 answers a second')
    assert 'a          ok     localized' in lines
    assert 'long_name  ERROR  its measurements contradict each other' in lines
    assert any(line.strip() == 'at 1 2 m' for line in lines)
    assert 'input range b->c: stale' in lines
    assert not any('a->b' in line for line in lines)
    assert max(map(len, screen('localizer', FLEET, 0.5, 40))) <= 40
    assert 'SILENT for 7 s' in next(screen('localizer', FLEET, 7.0))
    (line,) = screen('localizer', (), 60.0)
    assert line.startswith('localizer: no diagnostics received; is it running')
    assert lines[-2:] == ['next: range a - d would fix the hinge at b', 'next: drive c']


def test_the_node_shows_its_localizer_and_no_other():
    context = Context()
    rclpy.init(context=context)
    shown: list[str] = []
    try:
        node = FleetStatusNode(shown.append, context=context)
        sender = Node('sender', context=context)
        publisher = sender.create_publisher(DiagnosticArray, '/diagnostics', 10)
        other = Status(Level.ERROR, 'other: fleet', 'not mine')

        def send():
            publisher.publish(to_message(Diagnostics(1.0, FLEET)))
            publisher.publish(to_message(Diagnostics(1.0, (other,))))

        sender.create_timer(0.1, send)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        executor.add_node(sender)
        for _ in range(600):
            executor.spin_once(timeout_sec=0.1)
            if any('ambiguous' in text for text in shown):
                break
        assert 'localizer: WARN: ambiguous: 2 hypotheses' in shown[-1]
        assert not any('not mine' in text for text in shown)
    finally:
        rclpy.try_shutdown(context=context)
