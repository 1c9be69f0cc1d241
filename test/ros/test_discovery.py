# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which topics are inputs, by their names."""

import pytest

from dg_localization.fleet import LinkKey, LinkKind
from dg_localization.ros.interface.discovery import Template, TopicFinder
from dg_localization.ros.interface.links import STRANGERS, parse_link

RANGE, RAY = 'sensor_msgs/msg/Range', 'geometry_msgs/msg/Vector3Stamped'
ODOMETRY = 'nav_msgs/msg/Odometry'
PEERS = 'sensor_msgs/msg/PointCloud2'
TEMPLATES = (
    Template('/{observer}/range/{target}', LinkKind.RANGE),
    Template('/{observer}/bearing/{target}', LinkKind.BEARING),
    Template('/{robot}/odom', LinkKind.ODOMETRY),
    Template('/{observer}/peers', LinkKind.PEERS),
)
POINTS = ('a', 'b', 'a_b')


def found(*topics, templates=TEMPLATES):
    finder = TopicFinder(templates, (), POINTS)
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
        ('/a/range/b', RAY, None),
        ('/a/range/a', RANGE, None),
        ('/y/range/z', RANGE, None),
        ('/z/odom', ODOMETRY, None),
        ('/a/range/b/c', RANGE, None),
        ('/ns/a/range/b', RANGE, None),
    ],
)
def test_topic_is_understood_or_none_of_ours(topic, type_name, key):
    assert found((topic, type_name)) == ({topic: key} if key else {})


def test_known_names_decide_where_a_name_ends():
    joined = (Template('/uwb/{observer}_{target}', LinkKind.RANGE),)
    assert found(('/uwb/a_b_b', RANGE), templates=joined) == {
        '/uwb/a_b_b': LinkKey(LinkKind.RANGE, 'a_b', 'b')
    }


def test_a_topic_that_a_link_replaces_is_told_once():
    camera = parse_link('/cam/seen sensor_msgs/msg/PointCloud2 a')
    finder = TopicFinder(TEMPLATES, [camera], POINTS)
    topics = [('/cam/seen', [PEERS]), ('/a/peers', [PEERS]), ('/b/peers', [PEERS])]
    assert [link.topic for link in finder.find(topics)] == ['/b/peers']
    assert [link.topic for link in finder.passed_over] == ['/a/peers']
    assert list(finder.find(topics)) == [] and finder.passed_over == []


def test_only_a_few_strangers_are_listened_to():
    topics = [(f'/a/range/z{number}', RANGE) for number in range(2 * STRANGERS)]
    assert len(found(*topics, ('/a/range/b', RANGE))) == STRANGERS + 1
