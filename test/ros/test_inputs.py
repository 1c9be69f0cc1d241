# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The subscriptions of the node: it asks them for messages, and no executor looks at them."""

from collections import Counter
import time
from types import SimpleNamespace

from processes import Listener
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Range

from dg_localization.fleet import LinkKind
from dg_localization.ros.interface.discovery import Template
from dg_localization.ros.interface.links import parse_link
from dg_localization.ros.node.inputs import SENSOR_DATA, Inputs
from dg_localization.ros.spinning import BATCH_S

POINTS = ('a', 'b', 'c')
TOPICS = [f'/{one}/range/{other}' for one in POINTS for other in POINTS if one != other]
SETTINGS = SimpleNamespace(
    templates=(Template('/{observer}/range/{target}', LinkKind.RANGE),),
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


def test_every_message_of_every_topic_is_taken_once(node):
    taken = Counter()
    inputs, publishers = connected(node, lambda link, *_: taken.update([link.topic]))
    for _ in range(SENSOR_DATA.depth):
        for publisher in publishers:
            publisher.publish(Range())
    Listener(node, {}).spin_until(lambda: taken.total() >= SENSOR_DATA.depth * len(TOPICS))
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
    listener = Listener(node, {})
    assert listener.spin_until(lambda: taken)
    # Another camera on the topic that keeps nothing is heard, too.
    other = node.create_publisher(CameraInfo, '/a/info', SENSOR_DATA)
    node.create_timer(0.05, lambda: other.publish(CameraInfo(width=7)))
    assert listener.spin_until(lambda: len(taken) > 1)
    inputs.destroy()


def test_where_more_arrives_than_can_be_taken_all_topics_have_their_turn(node):
    taken = Counter()

    def take_slowly(link, *_):
        taken.update([link.topic])
        time.sleep(2.0 * BATCH_S)
        if link.topic == TOPICS[0]:
            raise ValueError('wrong')

    inputs, publishers = connected(node, take_slowly)
    for _ in range(SENSOR_DATA.depth):
        for publisher in publishers:
            publisher.publish(Range())
    time.sleep(0.5)
    # Nor does one that raises keep the others from their turn.
    with pytest.raises(ValueError, match='wrong'):
        inputs._poll()
    assert taken == dict.fromkeys(TOPICS, 1)
    inputs.destroy()
