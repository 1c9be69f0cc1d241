# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `simulate_fleet`: the fleet of the paper on real topics, with the truth beside it.

It publishes, at `rate` and in its namespace:

- `{observer}/range/{target}` (sensor_msgs/Range), the nine measured pairs;
- `{observer}/bearing/{target}` (geometry_msgs/Vector3Stamped), both ways, when `cameras` is true;
- when `peers` is true, in the place of all these `{observer}/peers` (sensor_msgs/PointCloud2);
- `{robot}/odom` (nav_msgs/Odometry), when `odometry` is true;
- `~/ground_truth` (geometry_msgs/PoseArray) in the order robot_1 ... robot_6.
"""

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import PoseArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from dg_localization.ros.interface.outputs import LATCHED
from dg_localization.ros.interface.parameters.spec import (
    BOOL,
    DOUBLE,
    INTEGER,
    Spec,
    declare,
    given_values,
)
from dg_localization.ros.simulation.messages import SimulatedFleet
from dg_localization.ros.spinning import spin
from dg_localization.simulation import moving_fleet as simulation

PARAMETERS = (
    Spec('cameras', BOOL, True, 'whether the robots see each other'),
    Spec('odometry', BOOL, False, 'whether the robots publish odometry'),
    Spec('peers', BOOL, False, 'whether each robot sends all ranges and bearings in one message'),
    Spec('rate', DOUBLE, 10.0, 'how often every sensor measures', 'Hz', 0.1, 1000.0),
    Spec('speed', DOUBLE, 0.1, 'no robot is faster', 'm/s', 0.0, 10.0),
    Spec('error', DOUBLE, 0.03, 'bound of the relative error of a range', '', 0.0, 0.5),
    Spec('bearing_error', DOUBLE, 0.02, 'bound of the error of a bearing', 'rad', 0.0, 1.5),
    Spec('seed', INTEGER, 0, 'seed of the motion and of the errors', '', 0, 2**31 - 1),
)


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
        If a parameter has a value that is not allowed.

    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('simulate_fleet', **kwargs)
        given = given_values(self)
        values = {spec.name: spec.check(given.get(spec.name, spec.default)) for spec in PARAMETERS}
        declare(self, PARAMETERS, values)
        self._fleet = SimulatedFleet(
            simulation.FleetMotion(values['speed'], values['seed']),
            simulation.FleetSensors(values['error'], values['bearing_error'], values['seed']),
            cameras=values['cameras'],
            odometry=values['odometry'],
            peers=values['peers'],
        )
        self._start_s = self._now_s()
        self._measurement_publishers = {
            topic: self.create_publisher(type(message), topic, qos_profile_sensor_data)
            for topic, message in self._fleet.measurements(0.0, self._start_s)
        }
        self._truth_publisher = self.create_publisher(PoseArray, '~/ground_truth', LATCHED)
        self.create_timer(1.0 / values['rate'], self.publish_all)
        self.get_logger().info(
            f'{len(simulation.ROBOTS)} robots, {len(self._measurement_publishers)} measurement '
            f'topics at {values["rate"]:g} Hz'
        )

    def _now_s(self) -> float:
        return self.get_clock().now().nanoseconds * 1e-9

    def publish_all(self) -> None:
        """Publish one reading of every sensor, and the truth, at the present time."""
        stamp_s = self._now_s()
        time_s = stamp_s - self._start_s
        for topic, message in self._fleet.measurements(time_s, stamp_s):
            self._measurement_publishers[topic].publish(message)
        self._truth_publisher.publish(self._fleet.ground_truth(time_s, stamp_s))


def main(args: Sequence[str]) -> int:
    """
    Run the node until SIGINT or SIGTERM.

    Parameters
    ----------
    args : sequence of str
        Command line.

    Returns
    -------
    int
        The exit code, 0.

    Raises
    ------
    UsageError
        If an argument or a parameter is wrong.

    """
    spin(FleetSimulator, args)
    return 0
