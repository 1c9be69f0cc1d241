# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A fleet on real topics for the tests of the node, and what the node says about it."""

from dataclasses import replace
from functools import partial
import gc
import json
import math
import signal
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from processes import DEADLINE_S, LATCHED, LocalizerProcess  # noqa: E402
import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from benchmarks.problems import FLEET_SQUARED_M2, fleet_placements  # noqa: E402
from dg_localization.fleet import Localizer, warm_up  # noqa: E402
from dg_localization.ros.node.localizer import LocalizerNode  # noqa: E402
from msg_adapters import (  # noqa: E402
    BearingReading,
    Level,
    OdometryReading,
    RangeReading,
    adapter_for,
    register,
    registry,
)

TRIANGLE = {('robot_1', 'robot_2'): 3.0, ('robot_1', 'robot_3'): 4.0, ('robot_2', 'robot_3'): 5.0}
SEND_PERIOD_S = 0.1

diagnostics_from_message = adapter_for('diagnostic_msgs/msg/DiagnosticArray').from_message
poses_from_message = adapter_for('geometry_msgs/msg/PoseArray').from_message


class PaperFleet:
    """The paper's fleet at rest: its placement, any headings, and the pairs that measure."""

    robots = tuple(f'robot_{i}' for i in range(1, 7))
    positions_m, edges = fleet_placements()[0], tuple(FLEET_SQUARED_M2)
    yaws_rad = np.array([0.4, -0.7, 1.9, 3.0, -2.2, 0.0])

    def range_m(self, observer, target):
        return float(np.linalg.norm(self.positions_m[target] - self.positions_m[observer]))

    def ray(self, observer, target):
        """Return the unit vector to `target` in the body frame of `observer`."""
        gap = self.positions_m[target] - self.positions_m[observer]
        angle = math.atan2(gap[1], gap[0]) - self.yaws_rad[observer]
        return np.array([math.cos(angle), math.sin(angle), 0.0])

    def in_frame_of(self, reference):
        """Return the true positions and headings in the body frame of a robot."""
        yaw = self.yaws_rad[reference]
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        return (self.positions_m - self.positions_m[reference]) @ turn.T, self.yaws_rad - yaw


@pytest.fixture(scope='session')
def paper_fleet():
    return PaperFleet()


@pytest.fixture(scope='session', autouse=True)
def _compiled_kernels():
    """Compile the kernels into the cache, which takes longer than a test waits for an answer."""
    warm_up()


@pytest.fixture(scope='module', autouse=True)
def _nothing_lives_on():
    """
    Free what rclpy has left in cycles of references, participants of DDS among it.

    Where two participants of one process meet while one is destroyed, Fast DDS may wait forever
    (its issue 6193).
    """
    yield
    gc.collect()


@pytest.fixture(autouse=True)
def _hang_up_is_heard():
    """Have SIGHUP end what tests start, also where nohup started the tests."""
    former = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, former)


@pytest.fixture
def recorder(tmp_path):
    from small_bags import Recorder

    return Recorder(tmp_path / 'bag')


@pytest.fixture
def localize(tmp_path):
    from small_bags import Localize

    return Localize(tmp_path)


@pytest.fixture
def triangle_bag(tmp_path):
    from small_bags import write_triangles

    return write_triangles(tmp_path / 'bag', [range(21)])


class Bench:
    """A node beside the localizer: it plays the sensors and listens to every output."""

    def __init__(self, robots):
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node('bench', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        # What is sent again and again: sensor data is best effort, and the first may be lost.
        self.sending = []
        self._next_send_s = 0.0
        self._publishers = {}
        self._clients = {}
        # What the node has said, newest last.
        self.heard = heard = SimpleNamespace(
            fleet=[], markers=[], diagnostics=[], statuses={}, robots={}, poses={}
        )
        listen = self.node.create_subscription
        listen(PoseArray, '/localizer/feasible_poses', heard.fleet.append, LATCHED)
        listen(MarkerArray, '/localizer/markers', heard.markers.append, LATCHED)
        listen(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        for robot in robots:
            arrays, poses = heard.robots[robot], heard.poses[robot] = [], []
            listen(PoseArray, f'/localizer/{robot}/feasible_poses', arrays.append, LATCHED)
            listen(PoseWithCovarianceStamped, f'/localizer/{robot}/pose', poses.append, 10)

    def _on_diagnostics(self, message):
        self.heard.diagnostics.append(message)
        for status in diagnostics_from_message(message).statuses:
            self.heard.statuses[status.name] = status

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def forget(self):
        """Stop sending, and reset the localizer until nothing that was on its way is left."""
        self.sending = []
        self.until(self._is_forgotten, 'a localizer that remembers nothing')

    def _is_forgotten(self):
        self.call('/localizer/reset', Trigger)
        self.clear()
        status = self.until(
            lambda: s if (s := self.status('fleet')) and s.message != 'reset' else None,
            'diagnostics after the reset',
        )
        return 'no usable measurement' in status.message

    def clear(self):
        heard = self.heard
        of_robots = *heard.robots.values(), *heard.poses.values()
        for said in (heard.fleet, heard.markers, heard.diagnostics, heard.statuses, *of_robots):
            said.clear()

    def now_s(self):
        return self.node.get_clock().now().nanoseconds * 1e-9

    def publisher(self, message_class, topic, qos=qos_profile_sensor_data):
        if topic not in self._publishers:
            publisher = self.node.create_publisher(message_class, topic, qos)
            self._publishers[topic] = publisher
            self.until(lambda: publisher.get_subscription_count(), f'a subscription to {topic}')
        return self._publishers[topic]

    def send(self, type_name, topic, value):
        """Send the message of a plain value."""
        adapter = adapter_for(type_name)
        self.publisher(adapter.message_class(), topic).publish(adapter.to_message(value))

    def send_range(self, observer, target, range_m, stamp_s=None):
        reading = RangeReading(stamp_s or self.now_s(), range_m)
        self.send('sensor_msgs/msg/Range', f'/{observer}/range/{target}', reading)

    def send_bearing(self, observer, target, ray, stamp_s=None):
        reading = BearingReading(stamp_s or self.now_s(), ray)
        self.send('geometry_msgs/msg/Vector3Stamped', f'/{observer}/bearing/{target}', reading)

    def send_odometry(self, robot, place_m):
        """Send a pose that looks along the x axis."""
        pose = np.array([*place_m, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])
        reading = OdometryReading(self.now_s(), *pose, f'{robot}/odom', f'{robot}/base')
        self.send('nav_msgs/msg/Odometry', f'/{robot}/odom', reading)

    def send_clock(self, time_s):
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(round(time_s * 1e9), 1_000_000_000)
        self.publisher(Clock, '/clock').publish(clock)

    def play(self, fleet, cameras, stretch=None):
        """Keep sending all ranges, and bearings both ways; `stretch` scales ranges by pair."""

        def send():
            for a, b in fleet.edges:
                scale = (stretch or {}).get((a, b), 1.0)
                self.send_range(fleet.robots[a], fleet.robots[b], fleet.range_m(a, b) * scale)
                for observer, target in ((a, b), (b, a)) if cameras else ():
                    ray = fleet.ray(observer, target)
                    self.send_bearing(fleet.robots[observer], fleet.robots[target], ray)

        self.sending = [send]

    def send_triangle(self, **stamp):
        for (observer, target), range_m in TRIANGLE.items():
            self.send_range(observer, target, range_m, **stamp)

    def play_triangle(self, **stamp):
        """Keep sending the ranges of three robots."""
        self.sending = [partial(self.send_triangle, **stamp)]

    def until_placements(self, number, robots=3):
        """Wait for an answer with a number of placements of some robots."""
        heard, count = self.heard.fleet, number * robots
        self.until(lambda: heard and len(heard[-1].poses) == count, f'{number} placements')

    def until(self, condition, what, deadline_s=DEADLINE_S):
        """Spin, and send what is being played, until `condition()` is true; return its value."""
        end_s = time.monotonic() + deadline_s
        while time.monotonic() < end_s:
            if time.monotonic() >= self._next_send_s:
                self._next_send_s = time.monotonic() + SEND_PERIOD_S
                for send in self.sending:
                    send()
            self.executor.spin_once(timeout_sec=0.02)
            value = condition()
            if value:
                return value
        said = {name: (s.level.name, s.message) for name, s in self.heard.statuses.items()}
        pytest.fail(f'waited {deadline_s} s for {what}; diagnostics: {json.dumps(said, indent=1)}')

    def status(self, part):
        return self.heard.statuses.get(f'localizer: {part}')

    def until_status(self, part, level, text='', deadline_s=DEADLINE_S):
        def reached():
            status = self.status(part)
            return status if status and status.level == level and text in status.message else None

        what = f"'{part}' at {Level(level).name} with '{text}'"
        return self.until(reached, what, deadline_s)

    def until_count(self, part, name):
        """Wait until a count of a status is not zero, and return all its values."""

        def reached():
            values = dict(self.status(part).values) if self.status(part) else {}
            return values if int(values.get(name, '0')) else None

        return self.until(reached, f"'{part}' with a count of {name}")

    def call(self, name, service, request=None):
        if name not in self._clients:
            self._clients[name] = self.node.create_client(service, name)
        client = self._clients[name]
        self.until(client.service_is_ready, f'the service {name}')
        future = client.call_async(request or service.Request())
        self.until(future.done, f'an answer of {name}')
        return future.result()

    def transition(self, label):
        request = ChangeState.Request()
        request.transition.label = label
        return self.call('/localizer/change_state', ChangeState, request).success

    def state(self):
        return self.call('/localizer/get_state', GetState).current_state.label

    def last_poses(self):
        return poses_from_message(self.heard.fleet[-1])


@pytest.fixture
def start_localizer(tmp_path):
    """Start the executable with ROS arguments; it is stopped at the end of the test."""
    started = []

    def start(*ros_args):
        started.append(LocalizerProcess(tmp_path / f'localizer_{len(started)}.log', *ros_args))
        return started[-1]

    yield start
    for process in started:
        process.stop()


@pytest.fixture
def node():
    """Return a node of a context of its own, which nothing spins."""
    context = Context()
    rclpy.init(context=context)
    node = Node('tested', context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.fixture(scope='module')
def bench(paper_fleet):
    bench = Bench(paper_fleet.robots)
    yield bench
    bench.close()


@pytest.fixture
def make_node(bench):
    """Make a localizer that spins beside the bench."""
    made = []

    def make(*cli_args, make_localizer=Localizer, load=warm_up, **parameters):
        parameters.setdefault('robots', ['robot_1', 'robot_2', 'robot_3'])
        node = LocalizerNode(
            make_localizer=make_localizer,
            load=load,
            context=bench.context,
            cli_args=['--ros-args', *cli_args],
            parameter_overrides=[
                Parameter(name.replace('__', '.'), value=value)
                for name, value in parameters.items()
            ],
        )
        made.append(node)
        bench.executor.add_node(node)
        return node

    bench.sending = []
    bench.clear()
    yield make
    for node in made:
        bench.executor.remove_node(node)
        node.destroy_node()


@pytest.fixture
def adapt(monkeypatch):
    """Have messages of a type read by another function for the time of a test."""
    monkeypatch.setattr(registry, '_adapters', dict(registry._adapters))

    def adapt(type_name, from_message):
        register(replace(adapter_for(type_name), from_message=from_message))

    return adapt
