# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which topics are inputs, by their names."""

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from dg_localization.fleet import LinkKey, LinkKind  # noqa: E402
from dg_localization.ros.interface.discovery import MOST_UNKNOWN, TopicFinder  # noqa: E402
from dg_localization.ros.interface.links import Template, parse_link  # noqa: E402

RANGE, RAY = 'sensor_msgs/msg/Range', 'geometry_msgs/msg/Vector3Stamped'
ODOMETRY = 'nav_msgs/msg/Odometry'
PEERS = 'sensor_msgs/msg/PointCloud2'
TEMPLATES = (
    Template('/{observer}/range/{target}', RANGE),
    Template('/{observer}/bearing/{target}', RAY),
    Template('/{robot}/odom', ODOMETRY),
    Template('/{observer}/peers', PEERS),
)
POINTS = ('a', 'b', 'a_b')


def found(*topics, templates=TEMPLATES, explicit=()):
    finder = TopicFinder(templates, explicit, POINTS)
    return {link.topic: link.key for link in finder.find([(t, [kind]) for t, kind in topics])}


@pytest.mark.parametrize(
    'topic, type_name, key',
    [
        ('/a/range/b', RANGE, LinkKey(LinkKind.RANGE, 'a', 'b')),
        ('/b/bearing/a', RAY, LinkKey(LinkKind.BEARING, 'b', 'a')),
        ('/a/odom', ODOMETRY, LinkKey(LinkKind.ODOMETRY, 'a', '')),
        ('/a_b/peers', PEERS, LinkKey(LinkKind.PEERS, 'a_b', '')),
        ('/a/range/z', RANGE, LinkKey(LinkKind.RANGE, 'a', 'z')),
        ('/z/range/a', RANGE, LinkKey(LinkKind.RANGE, 'z', 'a')),
    ],
)
def test_topic_is_understood(topic, type_name, key):
    assert found((topic, type_name)) == {topic: key}


@pytest.mark.parametrize(
    'topic, type_name',
    [
        ('/a/range/b', RAY),
        ('/a/range/a', RANGE),
        ('/y/range/z', RANGE),
        ('/z/odom', ODOMETRY),
        ('/z/peers', PEERS),
        ('/a/range/b/c', RANGE),
        ('/ns/a/range/b', RANGE),
        ('/rosout', 'rcl_interfaces/msg/Log'),
    ],
)
def test_topic_is_none_of_ours(topic, type_name):
    assert found((topic, type_name)) == {}


def test_odometry_is_no_range_to_a_stranger():
    short = (Template('/{observer}/{target}', RANGE), Template('/{robot}/odom', ODOMETRY))
    assert found(('/a/odom', ODOMETRY), ('/a/b', RANGE), ('/a/z', RANGE), templates=short) == {
        '/a/odom': LinkKey(LinkKind.ODOMETRY, 'a', ''),
        '/a/b': LinkKey(LinkKind.RANGE, 'a', 'b'),
        '/a/z': LinkKey(LinkKind.RANGE, 'a', 'z'),
    }


def test_known_names_decide_where_a_name_ends():
    joined = (Template('/uwb/{observer}_{target}', RANGE),)
    assert found(('/uwb/a_b_b', RANGE), templates=joined) == {
        '/uwb/a_b_b': LinkKey(LinkKind.RANGE, 'a_b', 'b')
    }


def test_explicit_link_replaces_the_topic_of_the_template():
    explicit = [parse_link(f'/uwb/ab {RANGE} a b')]
    topics = [('/a/range/b', RANGE), ('/b/range/a', RANGE), ('/uwb/ab', RANGE)]
    assert list(found(*topics, explicit=explicit)) == ['/b/range/a']


def test_a_topic_that_a_link_replaces_is_told_once():
    camera = parse_link('/cam/seen sensor_msgs/msg/PointCloud2 a')
    finder = TopicFinder(TEMPLATES, [camera], POINTS)
    topics = [('/cam/seen', [PEERS]), ('/a/peers', [PEERS]), ('/b/peers', [PEERS])]
    assert [link.topic for link in finder.find(topics)] == ['/b/peers']
    assert [link.topic for link in finder.passed_over] == ['/a/peers']
    assert list(finder.find(topics)) == [] and finder.passed_over == []


def test_wrong_type_is_reported_while_it_is_there_and_does_not_silence_the_input():
    finder = TopicFinder(TEMPLATES, (), POINTS)
    assert list(finder.find([('/a/range/b', [RAY])])) == []
    (link,) = finder.wrong_types
    assert (link.topic, link.type_name) == ('/a/range/b', RANGE)
    assert finder.wrong_types[link] == (RAY,)
    assert list(finder.find([('/a/range/b', [RAY, RANGE])])) == [link]
    assert finder.wrong_types == {link: (RAY,)}
    assert list(finder.find([('/a/range/b', [RANGE])])) == []
    assert finder.wrong_types == {}


def test_wrong_types_of_strangers_are_not_reported():
    finder = TopicFinder(TEMPLATES, (), POINTS)
    assert list(finder.find([(f'/a/range/z{number}', [RAY]) for number in range(99)])) == []
    assert finder.wrong_types == {}


def test_only_a_few_strangers_are_listened_to():
    topics = [(f'/a/range/z{number}', RANGE) for number in range(2 * MOST_UNKNOWN)]
    assert len(found(*topics, ('/a/range/b', RANGE))) == MOST_UNKNOWN + 1
