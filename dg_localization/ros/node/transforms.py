# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The transforms that the node publishes when `publish_tf` is set."""

from collections.abc import Collection, Mapping
from importlib import import_module
import math

from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy

from dg_localization.fleet import Estimate
from dg_localization.ros.interface.parameters.spec import WrongParameterError
from dg_localization.ros.interface.transforms import (
    TRANSFORM_TOPIC,
    OdometryPoses,
    transforms,
)
from msg_adapters.transforms import transforms_to_cdr

# As tf2 publishes and listens.
DYNAMIC = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


def transform_message_class() -> type:
    """
    Return the class of `tf2_msgs/TFMessage`.

    Raises
    ------
    WrongParameterError
        If its package is not installed.

    """
    try:
        message_class: type = import_module('tf2_msgs.msg').TFMessage
    except ImportError as error:
        raise WrongParameterError(
            "parameter 'publish_tf': true needs the ROS package tf2_msgs, which cannot be "
            f'imported ({error}); install it (apt install ros-jazzy-tf2-msgs) or leave it at false'
        ) from None
    return message_class


def make_transform_publisher(node: Node) -> Publisher:
    """Return a publisher on /tf; see `transform_message_class` for what it raises."""
    return node.create_publisher(transform_message_class(), TRANSFORM_TOPIC, DYNAMIC)


class TransformPublisher:
    """
    Publishes the transforms of estimates.

    Parameters
    ----------
    node : LifecycleNode
    fixed_frame : str
        Name of the frame of the anchors.
    odometry : mapping of str to OdometryPoses
        By robot; it is read at each estimate.

    """

    def __init__(
        self, node: LifecycleNode, fixed_frame: str, odometry: Mapping[str, OdometryPoses]
    ) -> None:
        self._node = node
        self._fixed_frame = fixed_frame
        self._odometry = odometry
        self._publisher = make_transform_publisher(node)
        self._last_stamp_s = -math.inf

    def publish(self, estimate: Estimate, awaited: Collection[str]) -> None:
        """
        Publish where the robots are, if that is known; silence says that it is not.

        Answers are for the time of the odometry, and may come more often than that. tf2 warns of
        transforms that repeat a time, and does not take them.

        Parameters
        ----------
        estimate : Estimate
        awaited : collection of str
            Robots that have an input of odometry.

        """
        if estimate.stamp_s == self._last_stamp_s:
            return
        found = transforms(estimate, self._fixed_frame, self._odometry, awaited)
        if found:
            self._last_stamp_s = estimate.stamp_s
            self._publisher.publish(transforms_to_cdr(found))

    def destroy(self) -> None:
        """Take the topic off the graph."""
        self._node.destroy_publisher(self._publisher)
