"""
The executable `simulate_fleet`: the fleet of the paper on real topics, with the truth beside it.

It publishes, at `rate`:

- `/{observer}/range/{target}` (sensor_msgs/Range), the nine measured pairs;
- `/{observer}/bearing/{target}` (geometry_msgs/Vector3Stamped), both ways, when `cameras` is true;
- when `peers` is true, in the place of all these `/{observer}/peers` (sensor_msgs/PointCloud2);
- `/{robot}/odom` (nav_msgs/Odometry), when `odometry` is true;
- `~/ground_truth` (geometry_msgs/PoseArray) in the order robot_1 ... robot_6.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import PoseArray
import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data

from dg_localization.ros.node.parameters import BOOL, DOUBLE, INTEGER, Spec
from dg_localization.ros.process import run_node
from dg_localization.simulation import moving_fleet as simulation
from msg_adapters.bearings import BearingReading, bearing_to_message
from msg_adapters.odometry import OdometryReading, odometry_to_message
from msg_adapters.peers import PeersReading, peers_to_message
from msg_adapters.poses import PoseList, pose_array_to_message
from msg_adapters.ranges import RangeReading, range_to_message

MAP_FRAME = 'map'
MIN_RANGE_M = 0.1
MAX_RANGE_M = 30.0
NO_RAY = (np.nan, np.nan, np.nan)

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


def declare(node: Node, spec: Spec) -> Any:
    """
    Declare a parameter on a node and return its value.

    Raises
    ------
    WrongParameterError
        If the value is not allowed.

    """
    descriptor = ParameterDescriptor(
        description=spec.description,
        additional_constraints=spec.allowed(),
        read_only=True,
        # A value of another type must come as far as the check, which names what is right.
        dynamic_typing=True,
    )
    return spec.check(node.declare_parameter(spec.name, spec.default, descriptor).value)


@dataclass(frozen=True)
class SimulatedFleet:
    """
    A moving fleet and its sensors, as messages.

    Attributes
    ----------
    motion : FleetMotion
        Where the robots are at a time.
    sensors : FleetSensors
        What they measure there.
    cameras, odometry : bool
        Whether they see each other and count their wheels.
    peers : bool
        Whether each robot sends all its ranges and bearings in one message.

    """

    motion: simulation.FleetMotion
    sensors: simulation.FleetSensors
    cameras: bool = True
    odometry: bool = False
    peers: bool = False

    def measurements(self, time_s: float, stamp_s: float) -> Iterator[tuple[str, Any]]:
        """
        Measure everything once.

        Parameters
        ----------
        time_s : float
            Time since the start of the motion.
        stamp_s : float
            Stamp of the messages.

        Yields
        ------
        tuple of str and message
            Topic, and what to publish on it.

        """
        state = self.motion.state(time_s)
        ranges = list(self.sensors.ranges(state))
        bearings = list(self.sensors.bearings(state)) if self.cameras else []
        if self.peers:
            yield from _peers_messages(ranges, bearings, stamp_s)
        else:
            yield from _pair_messages(ranges, bearings, stamp_s)
        start = self.motion.state(0.0)
        for travelled in simulation.odometry(start, state) if self.odometry else ():
            yield (
                f'/{travelled.robot}/odom',
                odometry_to_message(
                    OdometryReading(
                        stamp_s,
                        np.array([*travelled.position_m, 0.0]),
                        quaternions([travelled.yaw_rad])[0],
                        frame_id=f'{travelled.robot}/odom',
                        child_frame_id=travelled.robot,
                    )
                ),
            )

    def ground_truth(self, time_s: float, stamp_s: float) -> PoseArray:
        """
        Return the true poses in the order of the robots.

        Parameters
        ----------
        time_s, stamp_s : float
            As for `measurements`.

        """
        state = self.motion.state(time_s)
        positions_m = np.column_stack([state.positions_m, np.zeros(len(simulation.ROBOTS))])
        message: PoseArray = pose_array_to_message(
            PoseList(stamp_s, MAP_FRAME, positions_m, quaternions(state.yaws_rad))
        )
        return message


def _pair_messages(
    ranges: Iterable[simulation.RangeReading],
    bearings: Iterable[simulation.BearingReading],
    stamp_s: float,
) -> Iterator[tuple[str, Any]]:
    """Yield a topic and a message for each pair."""
    for distance in ranges:
        yield (
            f'/{distance.observer}/range/{distance.target}',
            range_to_message(
                RangeReading(
                    stamp_s,
                    distance.range_m,
                    min_range_m=MIN_RANGE_M,
                    max_range_m=MAX_RANGE_M,
                    frame_id=distance.observer,
                )
            ),
        )
    for bearing in bearings:
        yield (
            f'/{bearing.observer}/bearing/{bearing.target}',
            bearing_to_message(BearingReading(stamp_s, np.array(bearing.ray), bearing.observer)),
        )


def _peers_messages(
    ranges: Iterable[simulation.RangeReading],
    bearings: Iterable[simulation.BearingReading],
    stamp_s: float,
) -> Iterator[tuple[str, Any]]:
    """Yield a topic and a message for each robot, even for one that measured nobody."""
    ranges_m = {(r.observer, r.target): r.range_m for r in ranges}
    rays = {(b.observer, b.target): b.ray for b in bearings}
    for observer in simulation.ROBOTS:
        pairs = [(observer, target) for target in simulation.ROBOTS]
        measured = [pair for pair in pairs if pair in ranges_m or pair in rays]
        reading = PeersReading(
            stamp_s,
            peers=np.array([simulation.ROBOTS.index(target) for _, target in measured]),
            ranges_m=np.array([ranges_m.get(pair, np.nan) for pair in measured]),
            rays_xyz=np.array([rays.get(pair, NO_RAY) for pair in measured]).reshape(-1, 3),
            frame_id=observer,
        )
        yield f'/{observer}/peers', peers_to_message(reading)


def quaternions(yaws_rad: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """
    Return turns about z as quaternions, scalar last.

    Parameters
    ----------
    yaws_rad : sequence of float, length n
        Angles of the turns.

    Returns
    -------
    ndarray, shape (n, 4)
        The quaternions x, y, z, w.

    """
    half_rad = np.asarray(yaws_rad) / 2.0
    zeros = np.zeros_like(half_rad)
    return np.column_stack([zeros, zeros, np.sin(half_rad), np.cos(half_rad)])


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
        values = {spec.name: declare(self, spec) for spec in PARAMETERS}
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
        self._truth_publisher = self.create_publisher(
            PoseArray,
            '~/ground_truth',
            QoSProfile(
                depth=1,
                reliability=ReliabilityPolicy.RELIABLE,
                durability=DurabilityPolicy.TRANSIENT_LOCAL,
            ),
        )
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


def main(args: list[str] | None = None) -> int:
    """
    Run the node until SIGINT or SIGTERM.

    Parameters
    ----------
    args : list of str, optional
        Command line; that of the process by default.

    Returns
    -------
    int
        Exit code: 0, or 1 when a parameter is wrong.

    """
    return run_node(FleetSimulator, args)


if __name__ == '__main__':
    raise SystemExit(main())
