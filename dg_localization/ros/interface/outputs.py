# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The outputs: an estimate as messages, and the publishers of the node."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
import re
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped
import numpy as np
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from visualization_msgs.msg import MarkerArray

from dg_localization.fleet import Estimate
from dg_localization.ros.interface.markers import scene
from dg_localization.ros.interface.parameters.spec import WrongParameterError
from dg_localization.ros.interface.poses import (
    LEAST_DEVIATION_M,
    feasible_poses,
    frame_id,
    unique_pose,
)
from msg_adapters import Diagnostics
from msg_adapters.diagnostics import diagnostics_to_cdr
from msg_adapters.headers import message_class
from msg_adapters.markers import marker_scene_to_cdr
from msg_adapters.poses import pose_array_to_cdr, uncertain_pose_to_cdr

# All are reliable, as profiles are by default.
RELIABLE = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# As tf2 publishes and listens.
DYNAMIC = QoSProfile(depth=100)

# Longest wait for subscribers, at the end of the node.
ACKNOWLEDGE_S = 1.0

DECIMAL = re.compile(r'\d+\.\d+|\d+ of \d+')


class Output(NamedTuple):
    """An output topic: its name as the node knows it, its type, and how it is offered."""

    name: str
    message_class: type
    qos: QoSProfile


DIAGNOSTICS = Output('/diagnostics', DiagnosticArray, RELIABLE)
TRANSFORM_TOPIC = '/tf'


def transform_output() -> Output:
    """Return the topic of transforms; raise `WrongParameterError` without its package."""
    try:
        tf_message: type = message_class('tf2_msgs/msg/TFMessage')
    except ImportError:
        raise WrongParameterError(
            "parameter 'publish_tf': true needs tf2_msgs: apt install ros-$ROS_DISTRO-tf2-msgs"
        ) from None
    return Output(TRANSFORM_TOPIC, tf_message, DYNAMIC)


def estimate_outputs(robots: tuple[str, ...]) -> tuple[Output, ...]:
    """Return every topic that `estimate_messages` has messages for."""
    return (
        Output('~/feasible_poses', PoseArray, LATCHED),
        Output('~/markers', MarkerArray, LATCHED),
        *(Output(f'~/{robot}/feasible_poses', PoseArray, LATCHED) for robot in robots),
        *(Output(f'~/{robot}/pose', PoseWithCovarianceStamped, RELIABLE) for robot in robots),
    )


def estimate_messages(
    estimate: Estimate,
    fixed_frame: str,
    lifetime_s: float,
    least_deviation_m: float | None = LEAST_DEVIATION_M,
) -> Iterator[tuple[str, bytes]]:
    """
    Yield the serialized messages of an estimate, each with the name of its topic.

    One without placements empties the pose arrays and the view, so that no old answer looks new.
    The array of one robot is for viewers, some of which refuse an array with NaN in it: a
    placement where its position is not known is left out. Viewers show markers for `lifetime_s`.
    """
    name = frame_id(estimate.frame, fixed_frame)
    fleet = feasible_poses(estimate, name)
    yield '~/feasible_poses', pose_array_to_cdr(fleet)
    n_robots = len(estimate.robots)
    is_known = np.asarray(np.isfinite(fleet.positions_m).all(axis=1))
    for row, robot in enumerate(estimate.robots):
        own = np.flatnonzero(is_known[row::n_robots]) * n_robots + row
        poses = replace(
            fleet,
            positions_m=fleet.positions_m[own],
            orientations_xyzw=fleet.orientations_xyzw[own],
        )
        yield f'~/{robot}/feasible_poses', pose_array_to_cdr(poses)
    for row, robot in enumerate(estimate.robots):
        pose = unique_pose(estimate, row, name, least_deviation_m)
        if pose is not None:
            yield f'~/{robot}/pose', uncertain_pose_to_cdr(pose)
    yield '~/markers', marker_scene_to_cdr(scene(estimate, name, lifetime_s))


def _publisher(node: LifecycleNode, output: Output) -> Publisher:
    """Make a publisher without events: an executor looks at each of them at every wake-up."""
    events = PublisherEventCallbacks(use_default_callbacks=False)
    return node.create_publisher(
        output.message_class, output.name, output.qos, event_callbacks=events
    )


class EstimatePublishers:
    """
    The publishers of estimates and of their transforms.

    Parameters
    ----------
    node : LifecycleNode
        The node they belong to.
    outputs : iterable of Output

    """

    def __init__(self, node: LifecycleNode, outputs: Iterable[Output]) -> None:
        self._node = node
        self._publishers = {output.name: _publisher(node, output) for output in outputs}

    def publish(self, messages: Iterable[tuple[str, bytes]]) -> None:
        """Publish serialized messages, each with the name of its topic."""
        for name, message in messages:
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

    def publish(self, diagnostics: Diagnostics, changes_only: bool = False) -> None:
        """Publish; or only if a level or a message differs from what was published last."""
        before, self._last_seen = self._last_seen, outline(diagnostics)
        if not changes_only or before != self._last_seen:
            self._publisher.publish(diagnostics_to_cdr(diagnostics))


def outline(diagnostics: Diagnostics) -> tuple[tuple[str, int, str], ...]:
    """Return names, levels and messages without numbers that change all the time."""
    return tuple(
        (status.name, status.level, DECIMAL.sub('#', status.message))
        for status in diagnostics.statuses
    )
