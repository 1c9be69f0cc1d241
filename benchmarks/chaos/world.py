# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A fleet on the move with its sensors and its clock, and what the node says about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped
from lifecycle_msgs.srv import ChangeState
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from msg_adapters import OdometryReading, PeersReading, RangeReading, adapter_for

ROBOTS = ('r1', 'r2', 'r3', 'r4')
ANCHORS_M = {'a1': (0.0, 0.0), 'a2': (20.0, 0.0), 'a3': (5.0, 18.0)}
POINTS = (*ROBOTS, *ANCHORS_M)
OFFSETS_M = np.array([[0.0, 0.0], [4.0, 0.5], [1.0, 4.0], [5.0, 5.0]])
CENTER_M = np.array([8.0, 6.0])
RADIUS_M = 4.0
SPEED_M_S = 1.0
ROUNDING_M = 1e-3
SENSOR_PERIOD_S = 0.1
CLOCK_PERIOD_S = 0.02
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RANGE, CLOUD = 'sensor_msgs/msg/Range', 'sensor_msgs/msg/PointCloud2'
ODOMETRY = 'nav_msgs/msg/Odometry'


def parameters() -> list[str]:
    """Return the ROS arguments of a node for this fleet."""
    given = {
        'use_sim_time': 'true',
        'robots': str(list(ROBOTS)),
        'covariance': 'enclosure',
        'anchors.names': str(list(ANCHORS_M)),
        'range.min_error_relative': '-0.01',
        'range.max_error_relative': '0.01',
        'max_speed': '1.1',
        **{f'anchors.{name}.position': str(list(place)) for name, place in ANCHORS_M.items()},
    }
    return ['--ros-args', *(word for item in given.items() for word in ('-p', ':='.join(item)))]


@dataclass(frozen=True)
class Seen:
    """What an operator sees at one moment, by the clock of the wall and that of the fleet."""

    wall_s: float
    now_s: float
    stamp_s: float | None
    """Of the answer on the screen; None while it is empty."""
    level: int
    message: str


@dataclass
class World:
    """
    The fleet, its sensors, and a screen on which the last answer stands.

    Disturbances change `silent` (points that neither measure nor are measured), `lag_s` (of all
    stamps), `speed` (of the clock, 0 to pause it), `now_s` and `extra` (called with each tick).
    """

    silent: set[str] = field(default_factory=set)
    lag_s: float = 0.0
    speed: float = 1.0
    now_s: float = 1000.0
    extra: list[Callable[[], None]] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    answers: int = 0
    complete_stamp_s: float = -math.inf

    def __post_init__(self) -> None:
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node('world', context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._publishers: dict[str, Publisher] = {}
        self._clock = self.node.create_publisher(Clock, '/clock', 10)
        listen = self.node.create_subscription
        listen(PoseArray, '/localizer/feasible_poses', self._on_answer, LATCHED)
        for robot in ROBOTS:
            topic = f'/localizer/{robot}/pose'
            listen(PoseWithCovarianceStamped, topic, partial(self._on_pose, robot), 10)
        listen(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self.begin_s = self._last_wall_s = time.monotonic()
        self._next_sensor_s = self._next_clock_s = self.begin_s
        self._stamp_s: float | None = None
        self._level, self._message = 2, 'nothing heard'
        self._diagnostics_wall_s = self.begin_s
        self.random = np.random.default_rng(1)

    def close(self) -> None:
        """Take everything off the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def positions_m(self, time_s: float) -> np.ndarray:
        """Return where all points are, shape (n, 2)."""
        angle = SPEED_M_S / RADIUS_M * time_s
        moved = CENTER_M + RADIUS_M * np.array([math.cos(angle), math.sin(angle)])
        return np.concatenate([moved + OFFSETS_M, list(ANCHORS_M.values())])

    def publisher(self, type_name: str, topic: str) -> Publisher:
        """Return the publisher of a topic."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(
                adapter_for(type_name).message_class(), topic, qos_profile_sensor_data
            )
        return self._publishers[topic]

    def forget_publishers(self, robot: str) -> None:
        """Take the sensors of a robot off the graph, as when it is switched off."""
        for topic in [topic for topic in self._publishers if topic.startswith(f'/{robot}/')]:
            self.node.destroy_publisher(self._publishers.pop(topic))

    def spin(self) -> None:
        """Let some ms pass: publish what is due, and take what has arrived."""
        wall_s = time.monotonic()
        self.now_s += self.speed * (wall_s - self._last_wall_s)
        self._last_wall_s = wall_s
        if wall_s >= self._next_clock_s:
            self._next_clock_s = wall_s + CLOCK_PERIOD_S
            self._send_clock()
        if wall_s >= self._next_sensor_s:
            self._next_sensor_s = wall_s + SENSOR_PERIOD_S
            self._send_sensors()
            for extra in self.extra:
                extra()
            self._look()
        self._executor.spin_once(timeout_sec=0.005)

    @property
    def wall_s(self) -> float:
        """The time since the start, on the clock of the wall."""
        return time.monotonic() - self.begin_s

    @property
    def screen_is_empty(self) -> bool:
        """Whether no answer stands on the screen."""
        return self._stamp_s is None

    def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Spin until a condition holds or the time is up; return whether it holds."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.spin()
            if condition():
                return True
        return False

    def send(self, type_name: str, topic: str, value: Any) -> None:
        """Publish a value."""
        self.publisher(type_name, topic).publish(adapter_for(type_name).to_message(value))

    def transition(self, label: str) -> None:
        """Ask for a transition of the node's state, and wait for it."""
        request = ChangeState.Request()
        request.transition.label = label
        self._call('/localizer/change_state', ChangeState, request)

    def reset(self) -> None:
        """Have the node forget everything."""
        self._call('/localizer/reset', Trigger, Trigger.Request())

    def _call(self, name: str, service: type, request: Any) -> None:
        client = self.node.create_client(service, name)
        if not self.until(client.service_is_ready, 20.0):
            raise TimeoutError(f'{name} is not there')
        future = client.call_async(request)
        if not self.until(future.done, 20.0):
            raise TimeoutError(f'{name} does not answer')
        self.node.destroy_client(client)

    def _send_clock(self) -> None:
        clock = Clock()
        sec, nanosec = divmod(round(self.now_s * 1e9), 1_000_000_000)
        clock.clock.sec, clock.clock.nanosec = sec, nanosec
        self._clock.publish(clock)

    def _send_sensors(self) -> None:
        """Publish all ranges among robots as clouds, those to anchors on topics of their own."""
        positions = self.positions_m(self.now_s)
        stamp_s = self.now_s - self.lag_s
        for row, robot in enumerate(ROBOTS):
            if robot in self.silent:
                continue
            others = [i for i, name in enumerate(ROBOTS) if i != row and name not in self.silent]
            gaps_m = np.linalg.norm(positions - positions[row], axis=1)
            gaps_m *= self.random.uniform(0.995, 1.005, len(POINTS))
            rays = np.column_stack([positions - positions[row], np.zeros(len(POINTS))])
            cloud = PeersReading(stamp_s, np.array(others, int), gaps_m[others], rays[others])
            self.send(CLOUD, f'/{robot}/peers', cloud)
            for anchor in ANCHORS_M:
                if anchor not in self.silent:
                    reading = RangeReading(stamp_s, float(gaps_m[POINTS.index(anchor)]))
                    self.send(RANGE, f'/{robot}/range/{anchor}', reading)
            position = np.append(positions[row], 0.0)
            odometry = OdometryReading(stamp_s, position, np.array([0.0, 0.0, 0.0, 1.0]))
            self.send(ODOMETRY, f'/{robot}/odom', odometry)

    def _on_answer(self, message: PoseArray) -> None:
        poses = adapter_for('geometry_msgs/msg/PoseArray').from_message(message)
        if not len(poses.positions_m):
            self._stamp_s = None
            return
        self.answers += 1
        self._stamp_s = poses.stamp_s
        if poses.stamp_s > self.now_s + 0.2:
            self.faults.append(f'{self.now_s:.2f}: an answer from the future, {poses.stamp_s:.2f}')
        if np.isfinite(poses.positions_m).all():
            self.complete_stamp_s = poses.stamp_s

    def _on_pose(self, robot: str, message: PoseWithCovarianceStamped) -> None:
        """Check that the truth at the stamp of a pose lies within its bounds."""
        pose = adapter_for('geometry_msgs/msg/PoseWithCovarianceStamped').from_message(message)
        truth_m = self.positions_m(pose.stamp_s)[ROBOTS.index(robot)]
        half_widths_m = np.sqrt(np.diag(pose.covariance)[:2])
        if (
            pose.frame_id == 'map'
            and (np.abs(pose.position_xyz[:2] - truth_m) > half_widths_m + ROUNDING_M).any()
        ):
            self.faults.append(f'{self.now_s:.2f}: {robot} was not there at {pose.stamp_s:.2f}')

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == 'localizer: fleet':
                self._level, self._message = status.level[0], status.message
                self._diagnostics_wall_s = time.monotonic()

    def _look(self) -> None:
        """Note what stands on the screen; diagnostics that have stopped are no OK."""
        wall_s = time.monotonic()
        silent = wall_s - self._diagnostics_wall_s > 3.0
        level, message = (2, 'no diagnostics') if silent else (self._level, self._message)
        wall_s -= self.begin_s
        self.seen.append(Seen(wall_s, self.now_s, self._stamp_s, level, message))
