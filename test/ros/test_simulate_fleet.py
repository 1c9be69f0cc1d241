# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `simulate_fleet`, over real topics and as a process."""

from collections import Counter

from geometry_msgs.msg import PoseArray
from processes import REPOSITORY, Listener
import pytest
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
import yaml

from dg_localization.ros.interface.parameters.spec import WrongParameterError
from dg_localization.ros.simulation.simulate_fleet import (
    PARAMETERS,
    FleetSimulator,
    SimulatedFleet,
)
from dg_localization.simulation import moving_fleet as simulation

DEFAULTS = {name: spec.default for name, spec in PARAMETERS.items()}


def stamp(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


def simulated(**values):
    """Return one message of each topic."""
    fleet = SimulatedFleet({**DEFAULTS, **values})
    return {**dict(fleet.measurements(1.0, 2.0)), **dict(fleet.odometry_messages(1.0, 2.0))}


def test_every_topic_is_published_with_the_stamps_of_the_truth(node):
    given = [Parameter('rate', value=20), Parameter('odometry', value=True)]
    simulator = FleetSimulator(context=node.context, parameter_overrides=given)
    kinds = {f'/{topic}': type(message) for topic, message in simulated(odometry=True).items()}
    kinds['/simulate_fleet/ground_truth'] = PoseArray
    topics = {topic: (kind, qos_profile_sensor_data) for topic, kind in kinds.items()}
    listener = Listener(node, topics, simulator)
    assert listener.spin_until(lambda: all(len(listener.on(topic)) >= 5 for topic in topics))
    simulator.destroy_node()
    of_truth = set(map(stamp, listener.on('/simulate_fleet/ground_truth')))
    for observer, target in simulation.EDGES:
        topic = f'/{simulation.ROBOTS[observer]}/range/{simulation.ROBOTS[target]}'
        assert of_truth & set(map(stamp, listener.on(topic))), topic


@pytest.mark.parametrize(
    ('name', 'value', 'allowed'),
    [
        ('rate', 0.0, '>= 0.1'),
        ('cameras', 1, 'true or false'),
        ('ranges', False, "and 'cameras' are both false; one of them must be true"),
        ('camera', False, "is unknown; did you mean 'cameras'"),
    ],
)
def test_a_wrong_parameter_is_refused_with_the_allowed_values(node, name, value, allowed):
    given = [Parameter(name, value=value)]
    if name == 'ranges':
        given.append(Parameter('cameras', value=False))
    with pytest.raises(WrongParameterError, match=f'{name}.*{allowed}'):
        FleetSimulator(context=node.context, parameter_overrides=given)


@pytest.mark.parametrize(
    ('given', 'topics'),
    [
        ({}, {'range': 9, 'bearing': 18}),
        ({'cameras': False, 'odometry': True}, {'range': 9, 'odom': 6}),
        ({'ranges': False}, {'bearing': 18}),
        ({'peers': True}, {'peers': 6}),
        ({'landmarks': True}, {'range': 9 + 18, 'bearing': 18 + 18}),
    ],
)
def test_parameters_choose_what_is_measured(given, topics):
    assert Counter(topic.split('/')[1] for topic in simulated(**given)) == topics


def test_the_file_of_landmarks_is_that_of_the_simulation():
    text = (REPOSITORY / 'config/paper_fleet_landmarks.yaml').read_text()
    anchors = yaml.safe_load(text)['/**']['ros__parameters']['anchors']
    assert anchors.pop('names') == list(simulation.LANDMARKS_M)
    places = simulation.LANDMARKS_M.items()
    assert anchors == {name: {'position': list(place)} for name, place in places}
