# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The configurations of RViz and Foxglove against the outputs of the node; and the markers."""

import json

from estimates import AS_MAP
import numpy as np
from processes import REPOSITORY
import pytest
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import MarkerArray
import yaml

from dg_localization.fleet import Localizer
from dg_localization.ros.interface.outputs import DIAGNOSTICS, estimate_messages, estimate_outputs
from dg_localization.ros.interface.parameters.settings import check_values, settings_from

RVIZ = yaml.safe_load((REPOSITORY / 'config/localizer.rviz').read_text(encoding='utf-8'))
FOXGLOVE = json.loads((REPOSITORY / 'config/foxglove_layout.json').read_text(encoding='utf-8'))
PAPER_FLEET = REPOSITORY / 'config/paper_fleet.yaml'


@pytest.fixture(scope='module')
def outputs():
    """Return the outputs of the node by the full names of their topics."""
    found = (*estimate_outputs(('robot_1',)), DIAGNOSTICS)
    return {output.name.replace('~', '/localizer'): output for output in found}


@pytest.fixture(scope='module')
def displays():
    displays = RVIZ['Visualization Manager']['Displays']
    # A grid needs no topic.
    return [one for one in displays if one['Class'] != 'rviz_default_plugins/Grid']


def panels(kind):
    return [value for name, value in FOXGLOVE['configById'].items() if name.split('!')[0] == kind]


def estimate_of(paper_fleet, cameras):
    """Return what the localizer makes of one exact reading of everything."""
    given = {'robots': paper_fleet.robots, 'reference_robot': 'robot_2', 'max_turn_rate': 0.5}
    localizer = Localizer(settings_from(check_values(given)).fleet)
    names = paper_fleet.robots
    for a, b in paper_fleet.edges:
        localizer.add_range(names[a], names[b], paper_fleet.range_m(a, b), 10.0, 10.0)
        for observer, target in ((a, b), (b, a)) if cameras else ():
            ray = paper_fleet.ray(observer, target)
            localizer.add_bearing(names[observer], names[target], ray, 10.0, 10.0)
    return localizer.step(10.0)


def markers_of(estimate):
    messages = dict(estimate_messages(estimate, AS_MAP))
    return deserialize_message(messages['~/markers'], MarkerArray)


def test_rviz_shows_topics_of_the_node_with_their_type_and_qos(outputs, displays):
    assert displays
    for display in displays:
        topic = display['Topic']
        output = outputs[topic['Value']]
        qos = output.qos
        assert display['Class'] == f'rviz_default_plugins/{output.message_class.__name__}'
        assert topic['Reliability Policy'] == qos.reliability.name.capitalize()
        assert topic['Durability Policy'] == qos.durability.name.replace('_', ' ').title()
        assert topic['Depth'] == qos.depth


def test_foxglove_shows_topics_of_the_node_in_panels_for_their_type(outputs):
    (view,) = panels('3D')
    assert {outputs[topic].message_class.__name__ for topic in view['topics']} == {'MarkerArray'}
    others = panels('DiagnosticSummary') + panels('DiagnosticStatusPanel')
    for panel in others:
        assert outputs[panel['topicToRender']] is DIAGNOSTICS


@pytest.mark.parametrize('cameras', [False, True])
def test_both_viewers_switch_the_namespaces_that_there_are(paper_fleet, displays, cameras):
    namespaces = {marker.ns for marker in markers_of(estimate_of(paper_fleet, cameras)).markers}
    namespaces.discard('')  # that of "delete all"
    (rviz,) = displays
    (view,) = panels('3D')
    (foxglove,) = view['topics'].values()
    known = set(rviz['Namespaces'])
    assert known == set(foxglove['namespaces'])
    assert namespaces == (known if cameras else known - {'headings'})


def test_the_simulation_is_shown_in_the_frame_of_its_markers(paper_fleet):
    launch_file = (REPOSITORY / 'launch/simulation.launch.py').read_text(encoding='utf-8')
    frames = {m.header.frame_id for m in markers_of(estimate_of(paper_fleet, True)).markers}
    (frame,) = frames
    assert f"default_value='{frame}'" in launch_file
    parameters = yaml.safe_load(PAPER_FLEET.read_text(encoding='utf-8'))['/**']['ros__parameters']
    assert frame.startswith(parameters['reference_robot'] + '/')


def test_a_name_is_not_drawn_over_its_robot_nor_twice_at_the_same_place(paper_fleet):
    array = markers_of(estimate_of(paper_fleet, False))
    (robots,) = [marker for marker in array.markers if marker.ns == 'robots']
    names = [marker for marker in array.markers if marker.ns == 'names']
    places = [marker.pose.position for marker in names]
    points, places = (np.array([[p.x, p.y] for p in found]) for found in (robots.points, places))
    to_points, apart = (
        np.linalg.norm(places[:, None] - others, axis=-1) for others in (points, places)
    )
    assert to_points.min() > robots.scale.x / 2.0
    same = [[one is not other and one.text == other.text for other in names] for one in names]
    assert apart[same].min(initial=1.0) > names[0].scale.z
    assert len(names) < len(robots.points) / 3


def test_the_example_of_a_filter_fuses_positions_of_the_localizer_and_velocities(outputs):
    text = (REPOSITORY / 'config/ekf_example.yaml').read_text(encoding='utf-8')
    values = yaml.safe_load(text)['ekf_filter_node']['ros__parameters']
    settings = settings_from(check_values({'robots': ['robot_1']}))
    assert outputs[values['pose0']].message_class.__name__ == 'PoseWithCovarianceStamped'
    assert values['world_frame'] == values['map_frame'] == settings.fixed_frame
    (odometry,) = [template for template in settings.templates if 'robot' in template.fields]
    assert values['odom0'] == odometry.text.format(robot='robot_1')
    # In the order x y z, roll pitch yaw, then their rates, then accelerations.
    for source, wanted in (('pose0', [0, 1]), ('odom0', [6, 7, 11])):
        fused = values[f'{source}_config']
        assert len(fused) == 15 and [i for i, one in enumerate(fused) if one] == wanted
