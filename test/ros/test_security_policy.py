# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The SROS 2 policy of the node, against what the node has on the graph."""

from pathlib import Path
import subprocess
import sys
from xml.etree import ElementTree

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import Range  # noqa: E402

from dg_localization.ros.interface import discovery  # noqa: E402
from dg_localization.ros.interface.access import BOND_TOPIC, CLOCK, access_of  # noqa: E402
from dg_localization.ros.interface.diagnostics import MOST_CHARACTERS  # noqa: E402
from dg_localization.ros.interface.identities import MOST_STRANGERS  # noqa: E402
from dg_localization.ros.interface.intake import (  # noqa: E402
    MOST_BYTES,
    MOST_BYTES_PER_ROW,
    ROWS_PER_POINT,
)
from dg_localization.ros.node.inputs import SENSOR_DATA  # noqa: E402

REPOSITORY = Path(__file__).parents[2]
PAPER_FLEET = REPOSITORY / 'config/paper_fleet.yaml'


def on_the_graph(bench, node):
    """Return the names that a node has on the graph, as the fields of an Access."""
    name = (node.get_name(), node.get_namespace())
    return {
        'publishes': {t for t, _ in bench.node.get_publisher_names_and_types_by_node(*name)},
        'subscribes': {t for t, _ in bench.node.get_subscriber_names_and_types_by_node(*name)},
        'serves': {s for s, _ in bench.node.get_service_names_and_types_by_node(*name)},
    }


def is_allowed(bench, node):
    """Return whether the graph shows what the policy allows, apart from inputs."""
    graph, access = on_the_graph(bench, node), access_of(node, node.settings)
    return graph['publishes'] == set(access.publishes) and graph['serves'] == set(access.serves)


# Nodes of this process that share a name share their entries on the graph.
@pytest.mark.usefixtures('transform_class')
@pytest.mark.parametrize(
    ('arguments', 'parameters'),
    [
        (('-r', '__node:=plain'), {}),
        (('-r', '__ns:=/left', '-r', '__node:=finder'), {}),
        (
            ('-r', '__node:=remapped', '-r', '~/markers:=/seen', '-r', '~/reset:=/start_again'),
            {},
        ),
        (('-r', '__node:=placer'), {'publish_tf': True}),
        (('-r', '__node:=simulated'), {'use_sim_time': True}),
    ],
    ids=['plain', 'namespace', 'remapped', 'transforms', 'simulated time'],
)
def test_the_node_has_the_topics_and_services_of_its_policy(
    bench, make_node, arguments, parameters
):
    node = make_node(*arguments, robots=['a', 'b'], **parameters)
    bench.until(lambda: is_allowed(bench, node), 'the topics and services of the policy')
    subscribes = on_the_graph(bench, node)['subscribes']
    assert subscribes <= set(access_of(node, node.settings).subscribes)
    assert (CLOCK in subscribes) == ('use_sim_time' in parameters)


def test_every_input_is_in_the_policy_and_no_other_topic_is(bench, make_node):
    links = ['/uwb sensor_msgs/msg/Range a p', '/tags sensor_msgs/msg/PointCloud2 b']
    node = make_node(
        '-r',
        '__node:=listener',
        robots=['a', 'b'],
        anchors__names=['p'],
        anchors__p__position=[0.0, 0.0],
        links=links,
        odometry__topic='',
    )
    pairs = [('a', 'b'), ('a', 'p'), ('b', 'a'), ('b', 'p'), ('p', 'a'), ('p', 'b')]
    expected = {'/uwb', '/tags', '/a/peers', '/p/peers'}
    expected |= {f'/{a}/{kind}/{b}' for kind in ('range', 'bearing') for a, b in pairs}
    # That of the link replaces it, as `/tags` does the peers of b.
    expected -= {'/a/range/p'}
    assert set(access_of(node, node.settings).subscribes) == expected
    for a, b in pairs:
        bench.node.create_publisher(Range, f'/{a}/range/{b}', 10)
    ranges = {f'/{a}/range/{b}' for a, b in pairs} - {'/a/range/p'}
    bench.until(
        lambda: on_the_graph(bench, node)['subscribes'] == ranges | {'/uwb', '/tags'},
        'subscriptions to every range',
    )


def test_a_managed_node_may_have_a_bond(make_node):
    node = make_node(autostart=False)
    access = access_of(node, node.settings)
    assert f'/{BOND_TOPIC}' in access.publishes and f'/{BOND_TOPIC}' in access.subscribes


def run(*arguments):
    return subprocess.run(
        [sys.executable, '-m', 'dg_localization.ros', 'security_policy', *arguments],
        capture_output=True,
        text=True,
        timeout=60.0,
        cwd=REPOSITORY,
    )


def test_the_executable_prints_the_policy_as_xml(make_node):
    done = run('--params', str(PAPER_FLEET), '--ros-args', '-r', '__ns:=/left')
    assert (done.returncode, done.stderr) == (0, '')
    policy = ElementTree.fromstring(done.stdout)
    assert (policy.tag, policy.get('version')) == ('policy', '0.2.0')
    (enclave,) = policy.findall('enclaves/enclave')
    (profile,) = enclave.findall('profiles/profile')
    assert enclave.get('path') == '/left/localizer'
    assert (profile.get('ns'), profile.get('node')) == ('/left', 'localizer')
    allowed = {
        (group.tag, *attribute): [entry.text for entry in group]
        for group in profile
        for attribute in group.attrib.items()
    }
    node = make_node('-r', '__ns:=/left', robots=[f'robot_{number}' for number in range(1, 7)])
    access = access_of(node, node.settings)
    assert allowed == {
        ('services', 'reply', 'ALLOW'): list(access.serves),
        ('topics', 'publish', 'ALLOW'): list(access.publishes),
        ('topics', 'subscribe', 'ALLOW'): list(access.subscribes),
    }
    assert '/left/localizer/robot_1/pose' in access.publishes
    assert '/left/robot_1/range/robot_2' in access.subscribes
    assert '*' not in done.stdout


def test_the_enclave_can_be_named():
    done = run('--params', str(PAPER_FLEET), '--enclave', '/fleet/solver')
    assert '<enclave path="/fleet/solver">' in done.stdout


def test_a_wrong_parameter_is_named(tmp_path):
    path = tmp_path / 'wrong.yaml'
    path.write_text("/**: {ros__parameters: {robots: ['a'], rate: -1.0}}")
    done = run('--params', str(path))
    assert done.returncode == 2 and "'rate': -1.0 is not allowed" in done.stderr


def test_parameters_of_the_running_node_cannot_be_set(make_node):
    """The policy lets the node serve `set_parameters`: nothing comes of a call."""
    node = make_node()
    for name in ('max_speed', 'use_sim_time', 'robots'):
        value = node.get_parameter(name).value
        (result,) = node.set_parameters([Parameter(name, value=value)])
        assert not result.successful, name


def test_numbers_of_the_page():
    page = (REPOSITORY / 'docs/install.md').read_text(encoding='utf-8')
    per_point = ROWS_PER_POINT * MOST_BYTES_PER_ROW
    assert f'{MOST_BYTES // 1024} kB + {per_point} bytes for each robot' in page
    assert MOST_STRANGERS == discovery.MOST_STRANGERS and f'{MOST_STRANGERS} strangers' in page
    assert f'cut to {MOST_CHARACTERS} characters' in page
    assert f'queues of {SENSOR_DATA.depth} messages' in page
