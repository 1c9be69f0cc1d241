# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `simulate_fleet`, over real topics and as a process."""

from pathlib import Path
import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from geometry_msgs.msg import PoseArray, Vector3Stamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.clock import ClockType  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import Range  # noqa: E402

from dg_localization.ros.interface.parameters.spec import WrongParameterError  # noqa: E402
from dg_localization.ros.simulation.simulate_fleet import (  # noqa: E402
    PARAMETERS,
    FleetSimulator,
    SimulatedFleet,
)
from dg_localization.simulation import moving_fleet as simulation  # noqa: E402
from msg_adapters.peers import peers_from_message  # noqa: E402

REPOSITORY = Path(__file__).parents[2]
DEFAULTS = {name: spec.default for name, spec in PARAMETERS.items()}
EDGES = [(simulation.ROBOTS[a], simulation.ROBOTS[b]) for a, b in simulation.EDGES]


@pytest.fixture
def context():
    context = Context()
    rclpy.init(context=context)
    yield context
    rclpy.shutdown(context=context)


def listen(context, simulator, topics, enough, timeout_s=20.0):
    """Spin the simulator and a listener on {topic: class} until `enough(received)`."""
    listener = Node('listener', context=context)
    received = {topic: [] for topic in topics}
    for topic, message_class in topics.items():
        listener.create_subscription(
            message_class, topic, received[topic].append, qos_profile_sensor_data
        )
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(simulator)
    executor.add_node(listener)
    deadline = time.monotonic() + timeout_s
    while not enough(received) and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    listener.destroy_node()
    simulator.destroy_node()
    assert enough(received), {topic: len(messages) for topic, messages in received.items()}
    return received


def stamp(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


def test_every_sensor_measures_the_truth_of_its_stamp(context):
    simulator = FleetSimulator(
        context=context,
        parameter_overrides=[Parameter('rate', value=20), Parameter('odometry', value=True)],
    )
    ranges = {f'/{a}/range/{b}': (a, b) for a, b in EDGES}
    bearings = {f'/{a}/bearing/{b}': (a, b) for edge in EDGES for a, b in (edge, edge[::-1])}
    truth_topic = '/simulate_fleet/ground_truth'
    topics = {
        **dict.fromkeys(ranges, Range),
        **dict.fromkeys(bearings, Vector3Stamped),
        **{f'/{robot}/odom': Odometry for robot in simulation.ROBOTS},
        truth_topic: PoseArray,
    }
    received = listen(
        context, simulator, topics, lambda got: min(len(heard) for heard in got.values()) >= 5
    )
    truth = {
        stamp(message): np.array([[p.position.x, p.position.y] for p in message.poses])
        for message in received[truth_topic]
    }
    compared = 0
    for topic, (observer, target) in ranges.items():
        for message in received[topic]:
            if stamp(message) not in truth:
                continue
            positions = truth[stamp(message)]
            a, b = simulation.ROBOTS.index(observer), simulation.ROBOTS.index(target)
            distance = np.linalg.norm(positions[a] - positions[b])
            assert abs(message.range - distance) <= 0.03 * distance
            assert message.header.frame_id == observer
            assert message.min_range < message.range < message.max_range
            compared += 1
    assert compared >= 9
    for topic in bearings:
        for message in received[topic]:
            ray = message.vector
            assert np.linalg.norm([ray.x, ray.y, ray.z]) == pytest.approx(1.0)


@pytest.mark.parametrize('cameras', [True, False])
def test_peers_hold_what_the_single_topics_would(context, cameras):
    node = FleetSimulator(
        context=context,
        parameter_overrides=[Parameter('peers', value=True), Parameter('cameras', value=cameras)],
    )
    names = {name for name, _ in node.get_topic_names_and_types()}
    assert not [name for name in names if 'range' in name or 'bearing' in name]
    assert {f'/{robot}/peers' for robot in simulation.ROBOTS} <= names
    node.destroy_node()
    given = {**DEFAULTS, 'cameras': cameras}
    single, together = (
        dict(SimulatedFleet({**given, 'peers': peers}).measurements(1.0, 2.0))
        for peers in (False, True)
    )
    found = {}
    for topic, message in together.items():
        observer = topic.split('/')[0]
        reading = peers_from_message(message)
        assert reading.stamp_s == 2.0
        for peer, range_m, ray in zip(
            reading.peers, reading.ranges_m, reading.rays_xyz, strict=True
        ):
            target = simulation.ROBOTS[peer]
            if not np.isnan(range_m):
                found[f'{observer}/range/{target}'] = [range_m]
            if not np.isnan(ray).any():
                found[f'{observer}/bearing/{target}'] = ray
    assert found.keys() == single.keys()
    for topic, message in single.items():
        vector = getattr(message, 'vector', None)
        expected = [vector.x, vector.y, vector.z] if vector else [message.range]
        np.testing.assert_allclose(found[topic], expected, rtol=1e-6)


def test_no_clock_that_is_set_back_stops_the_robots_or_turns_them_back(context, monkeypatch):
    simulator = FleetSimulator(context=context)
    assert {timer.clock.clock_type for timer in simulator.timers} == {ClockType.STEADY_TIME}
    started_s = simulator._start_s
    for now_s, time_s in ((2.0, 2.0), (-3600.0, 2.0), (-3599.0, 3.0)):
        monkeypatch.setattr(simulator, '_now_s', lambda now_s=now_s: started_s + now_s)
        assert simulator._times_s() == pytest.approx((time_s, started_s + now_s))
    simulator.destroy_node()


@pytest.mark.parametrize(
    ('name', 'value', 'allowed'),
    [
        ('rate', 0.0, '>= 0.1'),
        ('error', 0.9, '<= 0.5'),
        ('speed', 'fast', 'a number'),
        ('cameras', 1, 'true or false'),
        ('seed', -1, '>= 0'),
        ('ranges', False, "and 'cameras' are both false; one of them must be true"),
        ('camera', False, "is unknown; did you mean 'cameras'"),
    ],
)
def test_a_wrong_parameter_is_refused_with_the_allowed_values(context, name, value, allowed):
    given = [Parameter(name, value=value)]
    if name == 'ranges':
        given.append(Parameter('cameras', value=False))
    with pytest.raises(WrongParameterError, match=f'{name}.*{allowed}'):
        FleetSimulator(context=context, parameter_overrides=given)


def simulated(**values):
    """Return the topics of one round, by what they end in before the target."""
    fleet = SimulatedFleet({**DEFAULTS, **values})
    return {*dict(fleet.measurements(1.0, 2.0)), *dict(fleet.odometry_messages(1.0, 2.0))}


def test_parameters_choose_what_is_measured():
    both_ways = {f'{a}/bearing/{b}' for edge in EDGES for a, b in (edge, edge[::-1])}
    ranges = {f'{a}/range/{b}' for a, b in EDGES}
    odometry = {f'{robot}/odom' for robot in simulation.ROBOTS}
    assert simulated() == ranges | both_ways
    assert simulated(cameras=False, odometry=True) == ranges | odometry
    assert simulated(ranges=False) == both_ways
    of_landmarks = {
        f'{robot}/{kind}/{landmark}'
        for robot in simulation.ROBOTS
        for kind in ('range', 'bearing')
        for landmark in simulation.LANDMARKS_M
    }
    assert simulated(landmarks=True) == ranges | both_ways | of_landmarks


def test_the_file_of_landmarks_is_that_of_the_simulation():
    yaml = pytest.importorskip('yaml')
    text = (REPOSITORY / 'config/paper_fleet_landmarks.yaml').read_text()
    anchors = yaml.safe_load(text)['/**']['ros__parameters']['anchors']
    assert anchors.pop('names') == list(simulation.LANDMARKS_M)
    assert anchors == {
        name: {'position': list(place)} for name, place in simulation.LANDMARKS_M.items()
    }
