# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The subscriptions of the node: it asks them for messages, and no executor looks at them."""

from collections import Counter
import time
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import CameraInfo, Range  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from dg_localization.ros.interface.links import Template, parse_link  # noqa: E402
from dg_localization.ros.node.inputs import (  # noqa: E402
    POLL_PERIOD_S,
    SENSOR_DATA,
    Inputs,
)

POINTS = ('a', 'b', 'c')
TOPICS = [f'/{one}/range/{other}' for one in POINTS for other in POINTS if one != other]
SETTINGS = SimpleNamespace(
    templates=(Template('/{observer}/range/{target}', 'sensor_msgs/msg/Range'),),
    links=(),
    fleet=SimpleNamespace(points=POINTS, robots=POINTS),
)
TIMEOUT_S = 20.0


def connected(node, take):
    """Return inputs that have found a publisher for every topic, and the publishers."""
    publishers = [node.create_publisher(Range, topic, SENSOR_DATA) for topic in TOPICS]
    inputs = Inputs(node, SETTINGS, take)
    began_s = time.monotonic()
    while not all(publisher.get_subscription_count() for publisher in publishers):
        assert time.monotonic() - began_s < TIMEOUT_S, 'the inputs are not found'
        inputs.search()
        time.sleep(0.01)
    return inputs, publishers


def spin_until(node, condition):
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    began_s = time.monotonic()
    while not condition() and time.monotonic() - began_s < TIMEOUT_S:
        executor.spin_once(timeout_sec=1.0)
    executor.shutdown()
    assert condition()


def test_every_message_of_every_topic_is_taken_once(node):
    taken = Counter()
    inputs, publishers = connected(node, lambda link, *_: taken.update([link.topic]))
    for _ in range(SENSOR_DATA.depth):
        for publisher in publishers:
            publisher.publish(Range())
    spin_until(node, lambda: taken.total() >= SENSOR_DATA.depth * len(TOPICS))
    assert taken == dict.fromkeys(TOPICS, SENSOR_DATA.depth)
    inputs.destroy()


def test_the_matrix_that_a_camera_published_before_the_start_is_taken(node):
    latched = QoSProfile(
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )
    node.create_publisher(CameraInfo, '/a/info', latched).publish(CameraInfo())
    taken = []
    links = (parse_link('/a/info sensor_msgs/msg/CameraInfo a'),)
    settings = SimpleNamespace(**{**vars(SETTINGS), 'links': links})
    inputs = Inputs(node, settings, lambda *message: taken.append(message))
    node.create_timer(0.05, inputs.search)
    spin_until(node, lambda: taken)
    # Another camera on the topic that keeps nothing is heard, too.
    other = node.create_publisher(CameraInfo, '/a/info', SENSOR_DATA)
    node.create_timer(0.05, lambda: other.publish(CameraInfo(width=7)))
    spin_until(node, lambda: len(taken) > 1)
    inputs.destroy()


def test_where_more_arrives_than_can_be_taken_all_topics_have_their_turn(node):
    taken = Counter()

    def take_slowly(link, *_):
        taken.update([link.topic])
        time.sleep(2.0 * POLL_PERIOD_S)

    inputs, publishers = connected(node, take_slowly)
    for _ in range(SENSOR_DATA.depth):
        for publisher in publishers:
            publisher.publish(Range())
    time.sleep(0.5)
    inputs._poll()
    assert taken == dict.fromkeys(TOPICS, 1)
    inputs.destroy()


def test_a_message_says_how_long_it_has_waited(node):
    waited = []
    inputs, (publisher, *_) = connected(node, lambda *each: waited.append(each[-1]))
    publisher.publish(Range())
    time.sleep(0.5)
    spin_until(node, lambda: waited)
    publisher.publish(Range())
    spin_until(node, lambda: len(waited) == 2)
    assert 0.4 < waited[0] < TIMEOUT_S
    assert 0.0 <= waited[1] < waited[0]
    inputs.destroy()


def test_a_topic_that_raises_does_not_keep_the_others_from_their_turn(node):
    taken = Counter()

    def take(link, *_):
        if link.topic == TOPICS[0]:
            raise ValueError('wrong')
        taken.update([link.topic])

    inputs, publishers = connected(node, take)
    for publisher in publishers:
        publisher.publish(Range())
    time.sleep(0.5)
    with pytest.raises(ValueError, match='wrong'):
        inputs._poll()
    assert taken == dict.fromkeys(TOPICS[1:], 1)
    inputs.destroy()


def test_nothing_is_asked_after_the_end(node):
    taken = []
    inputs, publishers = connected(node, lambda *each: taken.append(each))
    for publisher in publishers:
        publisher.publish(Range())
    inputs.destroy()
    assert inputs.links == ()
    assert not [each for each in node.subscriptions if each.topic_name in TOPICS]
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    for _ in range(3):
        executor.spin_once(timeout_sec=2.0 * POLL_PERIOD_S)
    executor.shutdown()
    assert taken == []


def test_a_topic_of_a_wrong_type_is_logged_once(node, monkeypatch):
    logged = []
    monkeypatch.setattr(node.get_logger(), 'warning', lambda text, **_: logged.append(text))
    publisher = node.create_publisher(String, '/a/range/b', SENSOR_DATA)
    inputs = Inputs(node, SETTINGS, lambda *_: None)
    began_s = time.monotonic()
    while not logged:
        assert time.monotonic() - began_s < TIMEOUT_S, 'nothing is logged'
        inputs.search()
        time.sleep(0.01)
    inputs.search()
    assert logged == [
        '/a/range/b: wrong type: the topic has std_msgs/msg/String, this input is '
        'sensor_msgs/msg/Range'
    ]
    inputs.destroy()
    node.destroy_publisher(publisher)
