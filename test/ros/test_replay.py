# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `replay`: small bags written here, and the real UWB recording."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest

rclpy = pytest.importorskip('rclpy', reason='ROS 2 is not installed')
rosbags = pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")

from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from rosbags.interfaces import (  # noqa: E402  # noqa: E402
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Range  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from dg_localization.ros import executables  # noqa: E402
from dg_localization.ros.bags import replay  # noqa: E402
from dg_localization.ros.bags.bag import Bag  # noqa: E402
from dg_localization.ros.bags.reading import Reading  # noqa: E402

REPOSITORY = Path(__file__).parents[2]
START_NS = 1_700_000_000_000_000_000
STEP_NS = 50_000_000
COUNT = 20
FOREVER = QosTime(2**31 - 1, 2**32 - 1)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    FOREVER,
    FOREVER,
    QosLiveliness.AUTOMATIC,
    FOREVER,
    False,
)


def write_bag(path, plugin):
    """Write COUNT ranges, one latched string, a type nobody knows and a topic without messages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg('float64 x', 'strange_msgs/msg/Odd'))
    types = store.types
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        distance = writer.add_connection('/a/range/b', 'sensor_msgs/msg/Range', typestore=store)
        latched = writer.add_connection(
            '/name', 'std_msgs/msg/String', typestore=store, offered_qos_profiles=[LATCHED]
        )
        odd = writer.add_connection('/odd', 'strange_msgs/msg/Odd', typestore=store)
        writer.add_connection('/silent', 'std_msgs/msg/String', typestore=store)
        text = types['std_msgs/msg/String']('latched')
        writer.write(latched, START_NS, store.serialize_cdr(text, 'std_msgs/msg/String'))
        for k in range(COUNT):
            time_ns = START_NS + k * STEP_NS
            stamp = types['builtin_interfaces/msg/Time'](*divmod(time_ns, 10**9))
            header = types['std_msgs/msg/Header'](stamp, 'a')
            message = types['sensor_msgs/msg/Range'](header, 0, 0.0, 0.1, 30.0, 1.0 + k, 0.0)
            writer.write(distance, time_ns, store.serialize_cdr(message, distance.msgtype))
            value = types['strange_msgs/msg/Odd'](float(k))
            writer.write(odd, time_ns, store.serialize_cdr(value, odd.msgtype))
    return path


@pytest.fixture(scope='module', params=[StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def bag_path(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp('bags') / request.param.name.lower()
    return write_bag(folder, request.param)


@pytest.fixture
def small_bag(tmp_path):
    return write_bag(tmp_path / 'bag', StoragePlugin.SQLITE3)


class Listener:
    """Records what a replay in another process publishes."""

    def __init__(self, topics):
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node('listener', context=self.context)
        self.received = []
        for topic, message_class in topics.items():
            self.node.create_subscription(
                message_class,
                topic,
                lambda message, topic=topic: self.received.append((topic, message)),
                QoSProfile(depth=1000),
            )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def on(self, topic):
        return [message for name, message in self.received if name == topic]

    def spin_while(self, condition, timeout_s=30.0):
        deadline = time.monotonic() + timeout_s
        while condition() and time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.05)

    def close(self):
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def listener():
    made = Listener({'/a/range/b': Range, '/clock': Clock})
    yield made
    made.close()


def start(*arguments, **environment):
    return subprocess.Popen(
        [sys.executable, '-m', 'dg_localization.ros', 'replay', *map(str, arguments)],
        cwd=REPOSITORY,
        env={**os.environ, 'PYTHONUNBUFFERED': '1', **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def time_ns(clock):
    return clock.clock.sec * 10**9 + clock.clock.nanosec


def test_every_message_arrives_after_its_time(bag_path, listener):
    process = start(bag_path)
    listener.spin_while(lambda: process.poll() is None)
    listener.spin_while(lambda: len(listener.on('/a/range/b')) < COUNT, 2.0)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 0, told
    ranges = listener.on('/a/range/b')
    assert [message.range for message in ranges] == [1.0 + k for k in range(COUNT)]
    clocks = [time_ns(clock) for clock in listener.on('/clock')]
    assert clocks == sorted(clocks)
    assert clocks[0] == START_NS and clocks[-1] == START_NS + (COUNT - 1) * STEP_NS
    # Two topics may overtake each other on the way, but the time of each message was published.
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in ranges]
    assert set(stamps) <= set(clocks)
    assert '/odd is passed over: the type strange_msgs/msg/Odd is not installed' in told
    assert '/silent is passed over: no message' in told
    assert f'{COUNT + 1} messages published' in told


def test_bytes_of_an_older_definition_are_brought_up_to_date(tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)  # its Range has no variance
    types, name = store.types, 'sensor_msgs/msg/Range'
    stamp = types['builtin_interfaces/msg/Time'](1, 2)
    message = types[name](types['std_msgs/msg/Header'](stamp, 'a'), 0, 0.0, 0.1, 30.0, 2.5)
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/a/range/b', name, typestore=store)
        writer.write(connection, START_NS, store.serialize_cdr(message, name))
    bag = Bag(tmp_path / 'bag')
    (published,) = Reading(bag).messages()
    bag.close()
    message = deserialize_message(published.data, Range)
    assert (message.range, message.variance, message.header.frame_id) == (2.5, 0.0, 'a')


def test_rate_and_gaps_of_the_clock(small_bag, listener):
    process = start(small_bag, '--rate', '0.25', '--duration', '0.3', '--topics', '/a/range/b')
    listener.spin_while(lambda: len(listener.on('/a/range/b')) < 1)
    began = time.monotonic()
    listener.spin_while(lambda: len(listener.on('/a/range/b')) < 6)
    took_s = time.monotonic() - began
    process.communicate(timeout=60)
    assert took_s >= 0.8  # 0.25 s of the bag at a quarter of its pace
    assert len(listener.on('/clock')) >= 15


def test_a_recorded_clock_is_not_played(tmp_path, listener):
    path, store = tmp_path / 'bag', get_typestore(Stores.ROS2_JAZZY)
    types, name = store.types, 'rosgraph_msgs/msg/Clock'
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        clock = writer.add_connection('/clock', name, typestore=store)
        other = writer.add_connection('/name', 'std_msgs/msg/String', typestore=store)
        text = types['std_msgs/msg/String']('here')
        for k in range(10):
            stamp = types['builtin_interfaces/msg/Time'](5 + k, 0)
            data = store.serialize_cdr(types[name](stamp), name)
            writer.write(clock, START_NS + k * STEP_NS, data)
            data = store.serialize_cdr(text, other.msgtype)
            writer.write(other, START_NS + k * STEP_NS, data)
    process = start(path, '--wait', '5')
    listener.spin_while(lambda: process.poll() is None)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 0 and '10 messages published' in told
    assert '/clock is passed over' in told
    assert min(time_ns(clock) for clock in listener.on('/clock')) == START_NS


def test_loop_goes_on_until_interrupted(small_bag, listener):
    process = start(small_bag, '--loop', '--rate', '10')
    listener.spin_while(lambda: len(listener.on('/a/range/b')) < 3 * COUNT)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 0
    assert 'Traceback' not in told and 'interrupted' in told
    clocks = [time_ns(clock) for clock in listener.on('/clock')]
    assert sum(later < earlier for earlier, later in zip(clocks, clocks[1:], strict=False)) >= 2


def test_without_subscribers_it_plays_after_the_timeout(small_bag):
    process = start(small_bag, '--wait', '0.2', '--rate', '10')
    _, told = process.communicate(timeout=60)
    assert process.returncode == 0
    assert 'nobody subscribed within 0.2 s' in told


def test_a_latched_topic_reaches_a_late_subscriber(small_bag):
    process = start(small_bag, '--wait', '0', '--loop', '--rate', '0.2')
    while 'playing all the same' not in process.stderr.readline():
        pass
    time.sleep(1.0)
    listener = Listener({})
    listener.node.create_subscription(
        String,
        '/name',
        lambda message: listener.received.append(('/name', message)),
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    )
    listener.spin_while(lambda: not listener.received, 10.0)
    process.terminate()
    process.communicate(timeout=60)
    assert [message.data for message in listener.on('/name')] == ['latched']
    listener.close()


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (['/no/such/bag'], 'there is no such bag'),
        ([str(REPOSITORY / 'test')], 'is no rosbag2'),
        ([str(REPOSITORY / 'setup.py')], 'is no rosbag2'),
    ],
)
def test_what_is_no_bag_is_refused_with_a_sentence(arguments, reason, capsys):
    assert executables.replay(arguments) == 1
    assert reason in capsys.readouterr().err


def test_a_topic_that_is_not_there_is_refused(small_bag, capsys):
    assert executables.replay([str(small_bag), '--topics', '/nope']) == 1
    assert 'no topic /nope in the bag; it has /a/range/b, /name' in capsys.readouterr().err


@pytest.mark.parametrize('text', ['0', '-1', 'nan', 'inf', 'quick'])
def test_a_rate_that_is_no_pace_is_refused(text, capsys):
    with pytest.raises(SystemExit):
        replay.make_parser().parse_args(['bag', '--rate', text])
    assert f"'{text}' is not a number above 0" in capsys.readouterr().err
