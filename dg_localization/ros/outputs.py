"""The topics of the node: every one made here, and all of them told the same thing at once."""

import re
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped
from rclpy.lifecycle import LifecycleNode
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from visualization_msgs.msg import MarkerArray

from dg_localization.fleet import Estimate
from dg_localization.ros.markers import scene
from dg_localization.ros.poses import feasible_poses, unique_pose
from msg_adapters import Diagnostics, adapter_for

RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

DECIMAL = re.compile(r'\d+\.\d+')

_pose_array = adapter_for('geometry_msgs/msg/PoseArray').to_message
_pose = adapter_for('geometry_msgs/msg/PoseWithCovarianceStamped').to_message
_marker_array = adapter_for('visualization_msgs/msg/MarkerArray').to_message
_diagnostic_array = adapter_for('diagnostic_msgs/msg/DiagnosticArray').to_message


class EstimatePublishers:
    """
    The publishers of estimates.

    Parameters
    ----------
    node : LifecycleNode
        The node they belong to.
    robots : tuple of str
        The fleet; every estimate must have these, in this order.
    frame_id : str
        Frame of everything published.

    """

    def __init__(self, node: LifecycleNode, robots: tuple[str, ...], frame_id: str) -> None:
        self._node = node
        self._frame_id = frame_id
        self._fleet = node.create_publisher(PoseArray, '~/feasible_poses', LATCHED)
        self._markers = node.create_publisher(MarkerArray, '~/markers', LATCHED)
        self._feasible = [
            node.create_publisher(PoseArray, f'~/{robot}/feasible_poses', LATCHED)
            for robot in robots
        ]
        self._unique = [
            node.create_publisher(PoseWithCovarianceStamped, f'~/{robot}/pose', RELIABLE)
            for robot in robots
        ]

    def publish(self, estimate: Estimate) -> None:
        """
        Publish an estimate on every topic.

        One without placements empties the pose arrays and the view, so that no old answer looks
        new.
        """
        fleet = _pose_array(feasible_poses(estimate, self._frame_id))
        self._fleet.publish(fleet)
        n_robots = len(estimate.robots)
        for robot, publisher in enumerate(self._feasible):
            publisher.publish(PoseArray(header=fleet.header, poses=fleet.poses[robot::n_robots]))
        for robot, publisher in enumerate(self._unique):
            pose = unique_pose(estimate, robot, self._frame_id)
            if pose is not None:
                publisher.publish(_pose(pose))
        self._markers.publish(_marker_array(scene(estimate, self._frame_id)))

    def destroy(self) -> None:
        """Take the topics off the graph."""
        for publisher in (self._fleet, self._markers, *self._feasible, *self._unique):
            self._node.destroy_publisher(publisher)


class DiagnosticsPublisher:
    """The publisher on /diagnostics."""

    def __init__(self, node: LifecycleNode) -> None:
        self._publisher: Publisher = node.create_publisher(
            DiagnosticArray, '/diagnostics', RELIABLE
        )
        self._last_seen: Any = None

    def publish(self, diagnostics: Diagnostics) -> None:
        """Publish."""
        self._last_seen = _outline(diagnostics)
        self._publisher.publish(_diagnostic_array(diagnostics))

    def publish_change(self, diagnostics: Diagnostics) -> None:
        """Publish if a level or a message differs from what was published last."""
        if _outline(diagnostics) != self._last_seen:
            self.publish(diagnostics)


def _outline(diagnostics: Diagnostics) -> tuple[tuple[str, int, str], ...]:
    """Return names, levels and messages without decimals: ages change all the time."""
    return tuple(
        (status.name, status.level, DECIMAL.sub('#', status.message))
        for status in diagnostics.statuses
    )
