# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A node among faults and strangers: it stays up, and what it says stays true."""

from functools import partial
import os
import signal
import sys
from threading import Event
import time
from types import ModuleType
from unittest.mock import Mock

from builtin_interfaces.msg import Time
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from dg_localization.fleet import Localizer
from dg_localization.ros import spinning
from dg_localization.ros.node import worker
from msg_adapters import Level

DEADLINE_S = 60.0


@pytest.fixture
def little_patience(monkeypatch):
    # Long enough for several diagnostics that say that the answer is late.
    monkeypatch.setattr(worker, 'PATIENCE_S', 1.0)


def test_solver_that_hangs_is_reported_and_comes_back(bench, make_node, little_patience):
    release, hanging = Event(), Event()

    class Hanging(Localizer):
        hangs = False

        def estimate(self, snapshot, cancel=None):
            if Hanging.hangs:
                Hanging.hangs = False
                hanging.set()
                assert release.wait(DEADLINE_S)
            return super().estimate(snapshot, cancel)

    make_node(make_localizer=Hanging)
    bench.play_triangle()
    bench.until_placements(2)
    Hanging.hangs = True
    bench.until(hanging.is_set, 'an estimate that hangs')
    bench.clear()
    bench.until_status('fleet', Level.WARN, 'late: the last answer is')
    bench.until_status('robot robot_1', Level.WARN, 'late: the last answer is')
    bench.until_status('fleet', Level.ERROR, 'no answer for')
    assert not bench.heard.fleet[0].poses, 'the last answer is taken back'
    release.set()
    bench.until_placements(2)
    bench.until_status('fleet', Level.WARN, 'ambiguous')


def test_after_a_backlog_what_is_taken_is_young_enough(bench, make_node):
    node = make_node(robots=['robot_1', 'robot_2'], max_age=1.6)
    bench.repeat(partial(bench.send_range, 'robot_1', 'robot_2', 3.0))
    bench.until_count('input range robot_1->robot_2', 'accepted')
    bench.forget()
    bench.executor.remove_node(node)
    # The executor of the node gets no processor for three seconds, at 10 Hz.
    for _ in range(30):
        bench.send_range('robot_1', 'robot_2', 3.0)
        time.sleep(0.1)
    bench.executor.add_node(node)
    bench.clear()
    values = dict(bench.until_count('input range robot_1->robot_2', 'accepted'))
    assert not int(values.get('rejected_too_old', '0')), values


def test_negative_time_on_the_clock_does_not_end_the_node(bench, start_localizer):
    bench.clear()
    process = start_localizer('-p', "robots:=['robot_1', 'robot_2']", '-p', 'use_sim_time:=true')
    clock = bench.publisher(Clock, '/clock')
    bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock')
    bench.repeat(partial(clock.publish, Clock(clock=Time(sec=-1))))
    bench.until(lambda: 'must not be negative' in process.output(), 'a word about it')
    bench.repeat(partial(bench.send_clock, 100.0))
    bench.until_status('fleet', Level.WARN, 'time has stood still')
    bench.sending = []
    assert process.process.poll() is None
    code, output = process.stop()
    assert code == 0 and output.count('a callback failed') == 1


def test_callback_that_raises_is_reported_and_the_node_goes_on():
    calls = []

    class Failing(Node):
        def __init__(self):
            super().__init__('failing')
            self.create_timer(0.01, self.fail)

        def fail(self):
            calls.append(self)
            if len(calls) == 3:
                os.kill(os.getpid(), signal.SIGINT)
            raise ArithmeticError('no idea')

    spinning.spin(Failing, [], '')
    assert len(calls) >= 3


def test_stranger_of_another_type_does_not_silence_an_input(bench, make_node):
    context = Context()
    rclpy.init(context=context)
    stranger = Node('stranger', context=context)
    stranger.create_publisher(String, '/robot_1/range/robot_2', 10)
    make_node()
    name = 'input range robot_1->robot_2'
    status = bench.until_status(name, Level.WARN, 'wrong type')
    assert 'std_msgs/msg/String' in status.message and 'sensor_msgs/msg/Range' in status.message
    stranger.destroy_node()
    rclpy.shutdown(context=context)
    bench.repeat(partial(bench.send_range, 'robot_1', 'robot_2', 3.0))
    bench.until_status(name, Level.OK, 'in use')


def test_huge_cloud_is_counted_and_the_node_answers(bench, make_node):
    make_node()
    cloud = PointCloud2(height=1, width=100_000, data=bytes(1_000_000))

    def send():
        bench.publisher(PointCloud2, '/robot_1/peers').publish(cloud)
        bench.send_triangle()

    bench.repeat(send)
    bench.until_status('input peers robot_1', Level.WARN, 'the message has 10000')
    bench.until_placements(2)


def test_many_resets_do_not_flood_the_log(bench, make_node, capfd):
    make_node()
    capfd.readouterr()
    for _ in range(10):
        assert bench.call('/localizer/reset', Trigger).success
    assert capfd.readouterr().err.count('reset: all measurements are forgotten') in range(1, 5)


def test_second_node_of_the_same_name_is_reported(bench, make_node):
    make_node()
    namesake = rclpy.create_node('localizer', context=bench.context)
    bench.until_status('fleet', Level.WARN, 'another node has the same name')
    namesake.destroy_node()


def test_bond_with_the_manager_is_formed_while_active(bench, make_node, monkeypatch):
    bond = Mock()
    for name in ('bondpy', 'bondpy.bondpy'):
        module = ModuleType(name)
        module.__spec__, module.__path__, module.Bond = object(), [], bond
        monkeypatch.setitem(sys.modules, name, module)
    make_node(autostart=False)
    assert bench.transition('configure') and not bond.called
    assert bench.transition('activate')
    assert bond.call_args.args[:2] == ('bond', 'localizer')
    assert bench.transition('deactivate')
    calls = [name for name, *_ in bond.return_value.method_calls]
    assert calls == ['start', 'break_bond', 'shutdown']


def test_managed_node_without_bondpy_names_the_setting(bench, make_node, monkeypatch):
    logged = []
    node = make_node(autostart=False)
    monkeypatch.setattr(node.get_logger(), 'info', lambda text, **_: logged.append(text))
    assert bench.transition('configure') and bench.transition('activate')
    assert any('bond_timeout: 0.0' in text for text in logged)
