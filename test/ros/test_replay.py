# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `replay`: small bags written here."""

import signal
import time

import processes
from processes import REPOSITORY, Listener
import pytest
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Range
from small_bags import LATCHED, ODD, ODD_MESSAGE, Recorder, StoragePlugin, time_ns_of
from std_msgs.msg import String

from dg_localization.ros import executables

COUNT = 10
STRING, CLOCK = 'std_msgs/msg/String', 'rosgraph_msgs/msg/Clock'


def write_bag(path, plugin):
    """Write ranges, a latched string, an unknown type, a recorded clock, and a silent topic."""
    recorder = Recorder(path, plugin)
    recorder.add('/name', STRING, [LATCHED])
    recorder.add('/silent', STRING)
    recorder.write('/name', 0, serialize_message(String(data='latched')), STRING)
    for step in range(COUNT):
        recorder.write_range('/a/range/b', step, 1.0 + step)
        recorder.write('/odd', step, ODD_MESSAGE, ODD)
        clock = Clock()
        clock.clock.sec = 5 + step
        recorder.write('/clock', step, serialize_message(clock), CLOCK)
    return recorder.close()


@pytest.fixture
def small_bag(tmp_path):
    return write_bag(tmp_path / 'bag', StoragePlugin.SQLITE3)


@pytest.fixture
def listener(node):
    return Listener(node, {'/a/range/b': (Range, QoSProfile(depth=1000)), '/clock': (Clock, 1000)})


def start(*arguments):
    return processes.start('replay', *arguments, **processes.PIPES)


def time_ns(clock):
    return clock.clock.sec * 10**9 + clock.clock.nanosec


@pytest.mark.parametrize('plugin', list(StoragePlugin))
def test_every_message_arrives_after_its_time(tmp_path, plugin, listener):
    process = start(write_bag(tmp_path / 'bag', plugin))
    listener.spin_until(lambda: process.poll() is not None)
    listener.spin_until(lambda: len(listener.on('/a/range/b')) == COUNT, 2.0)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 0, told
    ranges = listener.on('/a/range/b')
    assert [message.range for message in ranges] == [1.0 + k for k in range(COUNT)]
    clocks = [time_ns(clock) for clock in listener.on('/clock')]
    # That of the recording, which begins at 5 s, is not played.
    assert clocks == sorted(clocks) and '/clock is passed over' in told
    assert clocks[0] == time_ns_of(0) and clocks[-1] == time_ns_of(COUNT - 1)
    # Two topics may overtake each other on the way, but the time of each message was published.
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in ranges]
    assert set(stamps) <= set(clocks)
    over = '/odd: the type strange_msgs/msg/Odd is not installed, /silent: no message'
    assert f'topics passed over: 2 ({over})' in told


def test_rate_and_gaps_of_the_clock(small_bag, listener):
    process = start(small_bag, '--rate', '0.5', '--duration', '0.6', '--topics', '/a/range/b')
    listener.spin_until(lambda: listener.on('/a/range/b'))
    began = time.monotonic()
    listener.spin_until(lambda: len(listener.on('/a/range/b')) >= 6)
    took_s = time.monotonic() - began
    process.communicate(timeout=60)
    assert took_s >= 0.8  # 0.5 s of the bag at half of its pace
    assert len(listener.on('/clock')) >= 15


def test_a_gap_of_minutes_is_announced(tmp_path):
    recorder = Recorder(tmp_path / 'bag')
    for second in (0, 59, 180):
        recorder.write_range('/a/range/b', 10 * second, 3.0)
    _, told = start(recorder.close(), '--rate', '200', '--wait', '0').communicate(timeout=60)
    assert told.count('no message for') == 1 and 'no message for 0:02:01 of the' in told


def test_loop_goes_on_until_interrupted(small_bag, listener):
    process = start(small_bag, '--loop', '--rate', '10')
    listener.spin_until(lambda: len(listener.on('/a/range/b')) >= 3 * COUNT)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 0
    assert 'Traceback' not in told and 'interrupted' in told
    clocks = [time_ns(clock) for clock in listener.on('/clock')]
    assert sum(later < earlier for earlier, later in zip(clocks, clocks[1:], strict=False)) >= 2


def test_a_latched_topic_reaches_a_late_subscriber(small_bag, node):
    process = start(small_bag, '--wait', '0.2', '--loop', '--rate', '0.2')
    while (line := process.stderr.readline()) and 'playing without one' not in line:
        pass
    assert 'no subscriber within 0.2 s' in line
    time.sleep(1.0)
    listener = Listener(node, {'/name': (String, processes.LATCHED)})
    listener.spin_until(lambda: listener.received)
    process.terminate()
    process.communicate(timeout=60)
    assert [message.data for message in listener.on('/name')] == ['latched']


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (['/no/such/bag'], 'there is no such bag'),
        ([str(REPOSITORY / 'test')], 'is no rosbag2'),
        ([str(REPOSITORY / 'setup.py')], 'is no rosbag2'),
        (['BAG', '--topics', '/nope'], 'no topic /nope in the bag; it has /a/range/b, /clock'),
        *((['BAG', '--rate', text], f"'{text}' is not a number") for text in ('0', 'nan', 'inf')),
    ],
)
def test_wrong_usage_is_a_sentence(small_bag, arguments, reason, capsys):
    given = [str(small_bag) if text == 'BAG' else text for text in arguments]
    try:
        assert executables.replay(given) == 1
    except SystemExit as ended:
        assert ended.code == 2
    assert reason in capsys.readouterr().err
