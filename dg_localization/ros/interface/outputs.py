"""The outputs: an estimate as messages, and the publishers of the node."""

from collections.abc import Iterator
import re
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from visualization_msgs.msg import MarkerArray

from dg_localization.fleet import Estimate
from dg_localization.ros.interface.frames import frame_id
from dg_localization.ros.interface.markers import scene
from dg_localization.ros.interface.poses import feasible_poses, unique_pose
from msg_adapters import Diagnostics, adapter_for

RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

# Longest wait for subscribers, at the end of the node.
ACKNOWLEDGE_S = 1.0

DECIMAL = re.compile(r'\d+\.\d+')

_pose_array = adapter_for('geometry_msgs/msg/PoseArray').to_message
_pose = adapter_for('geometry_msgs/msg/PoseWithCovarianceStamped').to_message
_marker_array = adapter_for('visualization_msgs/msg/MarkerArray').to_message
_diagnostic_array = adapter_for('diagnostic_msgs/msg/DiagnosticArray').to_message


class Output(NamedTuple):
    """An output topic: its name as the node knows it, its type, and how it is offered."""

    name: str
    message_class: type
    qos: QoSProfile


DIAGNOSTICS = Output('/diagnostics', DiagnosticArray, RELIABLE)


def estimate_outputs(robots: tuple[str, ...]) -> tuple[Output, ...]:
    """Return every topic that `estimate_messages` has messages for."""
    return (
        Output('~/feasible_poses', PoseArray, LATCHED),
        Output('~/markers', MarkerArray, LATCHED),
        *(Output(f'~/{robot}/feasible_poses', PoseArray, LATCHED) for robot in robots),
        *(Output(f'~/{robot}/pose', PoseWithCovarianceStamped, RELIABLE) for robot in robots),
    )


def estimate_messages(
    estimate: Estimate, fixed_frame: str, lifetime_s: float
) -> Iterator[tuple[str, Any]]:
    """
    Yield the messages of an estimate, each with the name of its topic.

    One without placements empties the pose arrays and the view, so that no old answer looks new.

    Parameters
    ----------
    estimate : Estimate
    fixed_frame : str
        Name of the frame of the anchors.
    lifetime_s : float
        How long viewers show the markers.

    """
    name = frame_id(estimate.frame, fixed_frame)
    fleet = _pose_array(feasible_poses(estimate, name))
    yield '~/feasible_poses', fleet
    n_robots = len(estimate.robots)
    for row, robot in enumerate(estimate.robots):
        poses = PoseArray(header=fleet.header, poses=fleet.poses[row::n_robots])
        yield f'~/{robot}/feasible_poses', poses
    for row, robot in enumerate(estimate.robots):
        pose = unique_pose(estimate, row, name)
        if pose is not None:
            yield f'~/{robot}/pose', _pose(pose)
    yield '~/markers', _marker_array(scene(estimate, name, lifetime_s))


def diagnostics_message(diagnostics: Diagnostics) -> Any:
    """Return what is published on /diagnostics."""
    return _diagnostic_array(diagnostics)


def _publisher(node: LifecycleNode, output: Output) -> Publisher:
    return node.create_publisher(output.message_class, output.name, output.qos)


class EstimatePublishers:
    """
    The publishers of estimates.

    Parameters
    ----------
    node : LifecycleNode
        The node they belong to.
    robots : tuple of str
        The fleet; every estimate must have these, in this order.
    fixed_frame : str
        Name of the frame of the anchors.
    lifetime_s : float
        How long viewers show the markers.

    """

    def __init__(
        self, node: LifecycleNode, robots: tuple[str, ...], fixed_frame: str, lifetime_s: float
    ) -> None:
        self._node = node
        self._fixed_frame = fixed_frame
        self._lifetime_s = lifetime_s
        self._publishers = {
            output.name: _publisher(node, output) for output in estimate_outputs(robots)
        }

    def publish(self, estimate: Estimate) -> None:
        """Publish an estimate on every topic."""
        for name, message in estimate_messages(estimate, self._fixed_frame, self._lifetime_s):
            self._publishers[name].publish(message)

    def destroy(self) -> None:
        """Take the topics off the graph, after what was published last has arrived."""
        deadline_s = time.monotonic() + ACKNOWLEDGE_S
        for publisher in self._publishers.values():
            left_s = max(0.0, deadline_s - time.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=left_s))
            self._node.destroy_publisher(publisher)


class DiagnosticsPublisher:
    """The publisher on /diagnostics."""

    def __init__(self, node: LifecycleNode) -> None:
        self._publisher = _publisher(node, DIAGNOSTICS)
        self._last_seen: Any = None

    def publish(self, diagnostics: Diagnostics) -> None:
        """Publish."""
        self._last_seen = outline(diagnostics)
        self._publisher.publish(diagnostics_message(diagnostics))

    def publish_change(self, diagnostics: Diagnostics) -> None:
        """Publish if a level or a message differs from what was published last."""
        if outline(diagnostics) != self._last_seen:
            self.publish(diagnostics)


def outline(diagnostics: Diagnostics) -> tuple[tuple[str, int, str], ...]:
    """Return names, levels and messages without decimals: ages change all the time."""
    return tuple(
        (status.name, status.level, DECIMAL.sub('#', status.message))
        for status in diagnostics.statuses
    )
