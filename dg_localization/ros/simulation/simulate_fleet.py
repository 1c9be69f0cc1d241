# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `simulate_fleet`: the fleet of the paper on real topics, with the truth beside it.

It publishes, at `rate` and in its namespace:

- `{observer}/range/{target}` (sensor_msgs/Range), the nine measured pairs, and every robot to the
  three landmarks where `landmarks` is true, when `ranges` is true;
- `{observer}/bearing/{target}` (geometry_msgs/Vector3Stamped), both ways, when `cameras` is true;
- when `peers` is true, in the place of all these `{observer}/peers` (sensor_msgs/PointCloud2);
- `~/ground_truth` (geometry_msgs/PoseArray) in the order robot_1 ... robot_6;

and, at `odometry_rate` and when `odometry` is true, `{robot}/odom` (nav_msgs/Odometry), which
drifts within the bounds given. When `publish_tf` is true, `/tf` has where all these frames truly
are, so that answers in any of them can be compared with the truth.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from geometry_msgs.msg import PoseArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from dg_localization.ros.interface.outputs import LATCHED
from dg_localization.ros.interface.parameters.spec import (
    Spec,
    WrongParameterError,
    declare,
    given_values,
    refuse_unknown,
)
from dg_localization.ros.node.transforms import make_transform_publisher
from dg_localization.ros.simulation.messages import SimulatedFleet
from dg_localization.ros.spinning import STEADY, spin
from dg_localization.simulation import moving_fleet as simulation
from dg_localization.simulation.odometry import FleetOdometry, OdometryErrors
from msg_adapters.transforms import transforms_to_cdr

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
    'publish_tf': Spec(False, 'whether /tf has the true places of the frames (tf2_msgs)'),
    'seed': Spec(0, 'seed of the motion and of the errors', '', 0, 2**31 - 1),
}


def simulated_fleet(values: Mapping[str, Any]) -> SimulatedFleet:
    """Return the fleet that parameters stand for."""
    if not (values['ranges'] or values['cameras']):
        raise WrongParameterError(
            "parameters 'ranges' and 'cameras' are both false; one of them must be true"
        )
    path, seed = simulation.Path(values['path']), values['seed']
    motion = simulation.FleetMotion(values['speed'], seed, path)
    errors = OdometryErrors(
        translation_per_m=values['translation_per_m'],
        translation_per_rad=values['translation_per_rad'],
        rotation_per_m=values['rotation_per_m'],
        rotation_per_rad=values['rotation_per_rad'],
        latency_s=values['odometry_latency'],
    )
    sensors = simulation.FleetSensors(
        values['error'],
        values['bearing_error'],
        seed,
        simulation.LANDMARKS_M if values['landmarks'] else {},
    )
    return SimulatedFleet(
        motion,
        sensors,
        cameras=values['cameras'],
        ranges=values['ranges'],
        peers=values['peers'],
        odometry=FleetOdometry(motion, errors, seed) if values['odometry'] else None,
    )


def usage() -> str:
    """Return how the executable is used, with its parameters."""
    rows = '\n'.join(
        f'  {name:19} {spec.description}, {spec.allowed()} (default {spec.default})'
        for name, spec in PARAMETERS.items()
    )
    return f'usage: simulate_fleet --ros-args [-p NAME:=VALUE] [-r FROM:=TO]\n{rows}'


class FleetSimulator(Node):
    """
    Publishes the measurements and the truth of a simulated fleet.

    Parameters
    ----------
    **kwargs
        Passed on to `rclpy.node.Node`.

    Raises
    ------
    WrongParameterError
        If a parameter is unknown or has a value that is not allowed.

    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('simulate_fleet', **kwargs)
        given = given_values(self)
        values = {
            name: spec.check(name, given.get(name, spec.default))
            for name, spec in PARAMETERS.items()
        }
        refuse_unknown(given, values)
        declare(self, PARAMETERS, values)
        self._fleet = simulated_fleet(values)
        self._start_s = self._stamp_s = self._now_s()
        first = [
            *self._fleet.measurements(0.0, self._start_s),
            *self._fleet.odometry_messages(0.0, self._start_s),
        ]
        self._measurement_publishers = {
            topic: self.create_publisher(type(message), topic, qos_profile_sensor_data)
            for topic, message in first
        }
        self._truth_publisher = self.create_publisher(PoseArray, '~/ground_truth', LATCHED)
        self._transform_publisher = (
            make_transform_publisher(self) if values['publish_tf'] else None
        )
        # Timers of the clock of a machine are silent where it is set back.
        is_simulated = self.get_parameter('use_sim_time').value
        clock = None if is_simulated else STEADY
        self.create_timer(1.0 / values['rate'], self.publish_measurements, clock=clock)
        if values['odometry']:
            period_s = 1.0 / values['odometry_rate']
            self.create_timer(period_s, self.publish_odometry, clock=clock)
        self.get_logger().info(
            f'{len(simulation.ROBOTS)} robots, {len(self._measurement_publishers)} measurement '
            f'topics at {values["rate"]:g} Hz'
        )

    def _now_s(self) -> float:
        return self.get_clock().now().nanoseconds * 1e-9

    def _times_s(self) -> tuple[float, float]:
        """Return the time since the start, which no clock that is set back turns back, and now."""
        stamp_s = self._now_s()
        self._start_s -= max(0.0, self._stamp_s - stamp_s)
        self._stamp_s = stamp_s
        return stamp_s - self._start_s, stamp_s

    def publish_measurements(self) -> None:
        """Publish one reading of every sensor, and the truth, at the present time."""
        time_s, stamp_s = self._times_s()
        self._publish(self._fleet.measurements(time_s, stamp_s))
        if self._fleet.odometry is None:
            self._publish_transforms(time_s, stamp_s)
        self._truth_publisher.publish(self._fleet.ground_truth(time_s, stamp_s))

    def publish_odometry(self) -> None:
        """Publish one sample of the odometry of every robot, at the present time."""
        time_s, stamp_s = self._times_s()
        self._publish(self._fleet.odometry_messages(time_s, stamp_s))
        self._publish_transforms(time_s, stamp_s)

    def _publish_transforms(self, time_s: float, stamp_s: float) -> None:
        if self._transform_publisher is not None:
            found = list(self._fleet.true_transforms(time_s, stamp_s))
            self._transform_publisher.publish(transforms_to_cdr(found))

    def _publish(self, messages: Iterable[tuple[str, Any]]) -> None:
        for topic, message in messages:
            self._measurement_publishers[topic].publish(message)


def main(args: Sequence[str]) -> int:
    """Run the node until a signal."""
    spin(FleetSimulator, args, usage())
    return 0
