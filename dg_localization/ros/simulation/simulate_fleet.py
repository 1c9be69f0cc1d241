# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `simulate_fleet`: the fleet of the paper on real topics, with its ground truth.

It publishes, at `rate` and in its namespace:

- `{observer}/range/{target}` (sensor_msgs/Range), the nine measured pairs, and every robot to the
  three landmarks where `landmarks` is true, when `ranges` is true;
- `{observer}/bearing/{target}` (geometry_msgs/Vector3Stamped), both ways, when `cameras` is true;
- when `peers` is true, `{observer}/peers` (sensor_msgs/PointCloud2) instead of all these;
- `~/ground_truth` (geometry_msgs/PoseArray) in the order robot_1 ... robot_6, frame `world`;

and, at `odometry_rate` and when `odometry` is true, `{robot}/odom` (nav_msgs/Odometry), which
drifts within the bounds given.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from geometry_msgs.msg import PoseArray
import numpy as np
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from dg_localization.fleet.rotations import quaternion_of_yaw
from dg_localization.ros.interface.outputs import LATCHED, Output, Publishers
from dg_localization.ros.interface.parameters.spec import (
    Spec,
    WrongParameterError,
    checked,
    declare,
    given_values,
    refuse_unknown,
)
from dg_localization.ros.interface.poses import BODY_FRAME
from dg_localization.ros.spinning import STEADY, spin
from dg_localization.simulation import moving_fleet as simulation
from msg_adapters import BearingReading, OdometryReading, PeersReading, PoseList, RangeReading
from msg_adapters.peers import peers_to_message
from msg_adapters.poses import pose_array_to_message
from msg_adapters.readings import bearing_to_message, odometry_to_message, range_to_message

TRUTH = '~/ground_truth'
MIN_RANGE_M = 0.1
NO_RAY = (np.nan, np.nan, np.nan)

PARAMETERS = {
    'ranges': Spec(True, 'whether the robots measure ranges'),
    'cameras': Spec(True, 'whether the robots see each other'),
    'landmarks': Spec(False, 'whether there are three landmarks, ranged and seen by all'),
    'peers': Spec(False, 'whether each robot sends all ranges and bearings in one message'),
    'path': Spec(
        'formation',
        'whether the robots drive in formation or each in a loop of its own',
        choices=tuple(simulation.Path),
    ),
    'speed': Spec(0.1, 'no robot is faster', 'm/s', 0.0, 10.0),
    'rate': Spec(10.0, 'how often every sensor measures', 'Hz', 0.1, 1000.0),
    'error': Spec(0.03, 'bound of the relative error of a range', '', 0.0, 0.5),
    'bearing_error': Spec(0.02, 'bound of the error of a bearing', 'rad', 0.0, 1.5),
    'odometry': Spec(False, 'whether the robots publish odometry'),
    'odometry_rate': Spec(20.0, 'how often they do', 'Hz', 0.1, 1000.0),
    'odometry_latency': Spec(0.0, 'how late its stamps may be', 's', 0.0, 10.0),
    'translation_per_m': Spec(0.05, 'error of odometry per m travelled', 'm', 0.0, 1.0),
    'translation_per_rad': Spec(0.0, 'error of odometry per rad turned', 'm', 0.0, 1.0),
    'rotation_per_m': Spec(0.0, 'error of a turn per m travelled', 'rad', 0.0, 1.0),
    'rotation_per_rad': Spec(0.05, 'error of a turn per rad turned', 'rad', 0.0, 1.0),
    'seed': Spec(0, 'seed of the motion and of the errors', '', 0, 2**31 - 1),
}


class SimulatedFleet:
    """A moving fleet and its sensors as messages, by the values of the parameters."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        if not (values['ranges'] or values['cameras']):
            raise WrongParameterError(
                "parameters 'ranges' and 'cameras' are both false; one of them must be true"
            )
        self._values, seed = values, values['seed']
        self.motion = simulation.FleetMotion(
            values['speed'], seed, simulation.Path(values['path'])
        )
        landmarks_m = simulation.LANDMARKS_M if values['landmarks'] else {}
        self._sensors = simulation.FleetSensors(
            values['error'], values['bearing_error'], seed, landmarks_m
        )
        slopes = {name: values[name] for name in PARAMETERS if '_per_' in name}
        errors = simulation.OdometryErrors(latency_s=values['odometry_latency'], **slopes)
        self._odometry = simulation.FleetOdometry(self.motion, errors, seed)

    def measurements(self, time_s: float, stamp_s: float) -> Iterator[tuple[str, Any]]:
        """Measure once; yield a topic and a message for each pair or for each robot."""
        state, values = self.motion.state(time_s), self._values
        ranges_m = self._sensors.ranges(state) if values['ranges'] else {}
        rays = self._sensors.bearings(state) if values['cameras'] else {}
        points = (*simulation.ROBOTS, *self._sensors.landmarks_m)
        for observer in simulation.ROBOTS if values['peers'] else ():
            # A robot that measured no other sends a message without rows.
            pairs = [(observer, target) for target in points]
            measured = [pair for pair in pairs if pair in ranges_m or pair in rays]
            together = PeersReading(
                stamp_s,
                peers=np.array([points.index(target) for _, target in measured], dtype=int),
                ranges_m=np.array([ranges_m.get(pair, np.nan) for pair in measured]),
                rays_xyz=np.array([rays.get(pair, NO_RAY) for pair in measured]).reshape(-1, 3),
                frame_id=observer,
            )
            yield f'{observer}/peers', peers_to_message(together)
        if values['peers']:
            return
        limits_m = MIN_RANGE_M, simulation.REACH_M
        for (observer, target), range_m in ranges_m.items():
            reading = RangeReading(stamp_s, range_m, *limits_m, frame_id=observer)
            yield f'{observer}/range/{target}', range_to_message(reading)
        for (observer, target), ray in rays.items():
            seen = BearingReading(stamp_s, np.array(ray), observer)
            yield f'{observer}/bearing/{target}', bearing_to_message(seen)

    def odometry_messages(self, time_s: float, stamp_s: float) -> Iterator[tuple[str, Any]]:
        """Yield a sample of the odometry of every robot that has odometry."""
        for sample in self._odometry.samples(time_s) if self._values['odometry'] else ():
            reading = OdometryReading(
                stamp_s,
                np.array([*sample.position_m, 0.0]),
                quaternion_of_yaw(sample.yaw_rad),
                frame_id=f'{sample.robot}/odom',
                child_frame_id=f'{sample.robot}/{BODY_FRAME}',
            )
            yield f'{sample.robot}/odom', odometry_to_message(reading)

    def ground_truth(self, time_s: float, stamp_s: float) -> PoseArray:
        """Return the true poses in the order of the robots."""
        state = self.motion.state(time_s)
        positions_m = np.column_stack([state.positions_m, np.zeros(len(simulation.ROBOTS))])
        turns = np.array([quaternion_of_yaw(yaw_rad) for yaw_rad in state.yaws_rad])
        message: PoseArray = pose_array_to_message(PoseList(stamp_s, 'world', positions_m, turns))
        return message


def usage() -> str:
    """Return the usage of the executable, with its parameters."""
    rows = '\n'.join(
        f'  {name:19} {spec.description}, {spec.allowed()} (default {spec.default})'
        for name, spec in PARAMETERS.items()
    )
    return f'usage: simulate_fleet --ros-args [-p NAME:=VALUE] [-r FROM:=TO]\n{rows}'


class FleetSimulator(Node):
    """Publishes the measurements and the truth of a simulated fleet."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('simulate_fleet', **kwargs)
        given = given_values(self)
        values = checked(PARAMETERS, given)
        refuse_unknown(given, values)
        declare(self, PARAMETERS, values)
        self._fleet = SimulatedFleet(values)
        self._start_s = self._stamp_s = self._now_s()
        messages = [
            *self._fleet.measurements(0.0, self._start_s),
            *self._fleet.odometry_messages(0.0, self._start_s),
        ]
        outputs = [Output(topic, type(one), qos_profile_sensor_data) for topic, one in messages]
        self._outputs = Publishers(self, [*outputs, Output(TRUTH, PoseArray, LATCHED)])
        # Timers of the system clock are silent after it is set back.
        clock = None if self.get_parameter('use_sim_time').value else STEADY
        self.create_timer(1.0 / values['rate'], self.publish_measurements, clock=clock)
        if values['odometry']:
            self.create_timer(1.0 / values['odometry_rate'], self.publish_odometry, clock=clock)
        self.get_logger().info(f'{len(outputs)} measurement topics at {values["rate"]:g} Hz')

    def _now_s(self) -> float:
        return self.get_clock().now().nanoseconds * 1e-9

    def _times_s(self) -> tuple[float, float]:
        """Return the time since the start, which never goes back, and the present time."""
        stamp_s = self._now_s()
        self._start_s -= max(0.0, self._stamp_s - stamp_s)
        self._stamp_s = stamp_s
        return stamp_s - self._start_s, stamp_s

    def publish_measurements(self) -> None:
        """Publish one reading of every sensor and the truth."""
        times_s = self._times_s()
        self._outputs.publish(self._fleet.measurements(*times_s))
        self._outputs.publish([(TRUTH, self._fleet.ground_truth(*times_s))])

    def publish_odometry(self) -> None:
        """Publish one sample of the odometry of every robot."""
        self._outputs.publish(self._fleet.odometry_messages(*self._times_s()))


def main(args: Sequence[str]) -> int:
    """Run the node until a signal."""
    spin(FleetSimulator, args, usage())
    return 0
