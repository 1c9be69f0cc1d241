# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The outputs: an estimate as messages and as markers for a viewer, and the publishers."""

from collections.abc import Iterable, Iterator
from colorsys import hsv_to_rgb
from dataclasses import replace
from itertools import combinations, product
import re
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped
import numpy as np
from numpy.typing import NDArray
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from visualization_msgs.msg import MarkerArray

from dg_localization.fleet import Estimate, LinkState, Placement
from dg_localization.fleet.rotations import rotation_of_quaternion
from dg_localization.ros.interface.parameters.settings import Settings
from dg_localization.ros.interface.parameters.spec import WrongParameterError
from dg_localization.ros.interface.poses import feasible_poses, frame_id, in_space, unique_pose
from msg_adapters import Diagnostics, Marker, MarkerScene, Shape
from msg_adapters.diagnostics import diagnostics_to_cdr
from msg_adapters.headers import message_class
from msg_adapters.markers import marker_scene_to_cdr
from msg_adapters.poses import pose_array_to_cdr, uncertain_pose_to_cdr

# All are reliable, as profiles are by default.
RELIABLE = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# The profile of tf2.
DYNAMIC = QoSProfile(depth=100)

# Longest wait for subscribers, at the end of the node.
ACKNOWLEDGE_S = 1.0

DECIMAL = re.compile(r'\d+\.\d+|\d+ of \d+')


class Output(NamedTuple):
    """An output topic: its name before remapping, its type, and its QoS profile."""

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
    """Return every topic of `estimate_messages`."""
    return (
        Output('~/feasible_poses', PoseArray, LATCHED),
        Output('~/markers', MarkerArray, LATCHED),
        *(Output(f'~/{robot}/feasible_poses', PoseArray, LATCHED) for robot in robots),
        *(Output(f'~/{robot}/pose', PoseWithCovarianceStamped, RELIABLE) for robot in robots),
    )


def estimate_messages(estimate: Estimate, settings: Settings) -> Iterator[tuple[str, bytes]]:
    """
    Yield the serialized messages of an estimate, each with the name of its topic.

    Without placements the pose arrays and the view are emptied, so that no old answer looks new.
    The array of one robot is for viewers, some of which refuse an array with NaN: placements
    without a position of the robot are left out.
    """
    name = frame_id(estimate.frame, settings.fixed_frame)
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
        pose = unique_pose(estimate, row, name, settings.least_deviation_m)
        if pose is not None:
            yield f'~/{robot}/pose', uncertain_pose_to_cdr(pose)
    yield '~/markers', marker_scene_to_cdr(scene(estimate, name, settings.lifetime_s))


ROBOT_DIAMETER_M = 0.3
NAME_HEIGHT_M = 0.3
LINE_WIDTH_M = 0.03
HEADING_LENGTH_M = 0.6

FRESH_RGBA = np.array([0.2, 0.8, 0.3, 0.8])
STALE_RGBA = np.array([0.6, 0.6, 0.6, 0.4])
CONTRADICTING_RGBA = np.array([0.9, 0.1, 0.1, 1.0])
LANDMARK_RGBA = np.array([0.8, 0.8, 0.8, 1.0])

# Hues of successive hypotheses differ by the golden angle, so that a few are easy to distinguish.
# The first is blue, since links are green or red by state.
FIRST_HUE = 0.58
HUE_STEP = 0.381966
NAME_RGBA = np.array([1.0, 1.0, 1.0, 1.0])

LOOKS = {
    'robots': (Shape.SPHERE_LIST, ROBOT_DIAMETER_M),
    'headings': (Shape.LINE_LIST, 2.0 * LINE_WIDTH_M),
    'enclosures': (Shape.LINE_LIST, LINE_WIDTH_M),
    'links': (Shape.LINE_LIST, LINE_WIDTH_M),
}
Objects = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Objects of m points each, shape (k, m, 3), and one color for all or one for each."""


def scene(estimate: Estimate, frame_id: str, lifetime_s: float) -> MarkerScene:
    """
    Return robots, headings, names, enclosures and links of the placements.

    Each placement has its own color; links are green, gray if stale, red if they contradict
    others. Unknown and unbounded objects are left out.
    """
    rows = {name: i for i, name in enumerate((*estimate.robots, *estimate.landmarks))}
    # A link of a sensor is drawn from its robot.
    ends = {
        link: [rows.get(name.partition('/')[0], -1) for name in link.key.ends]
        for link in estimate.links
    }
    drawn = {link: pair for link, pair in ends.items() if min(pair) >= 0}
    pairs = np.reshape([*drawn.values()], (-1, 2)).astype(int)
    link_colors = np.reshape([_link_color(link) for link in drawn], (-1, 4))
    drawn_as: dict[str, list[Objects]] = {name: [] for name in LOOKS}
    for number, placement in enumerate(estimate.placements):
        color, points_m = _color(number), _points(placement)
        robots_m, landmarks_m = np.split(points_m, [len(estimate.robots)])
        tips_m = HEADING_LENGTH_M * rotation_of_quaternion(placement.best_headings[0])[:, :, 0]
        tips_m[~placement.heading_known] = np.nan
        drawn_as['robots'] += [(robots_m[:, None], color), (landmarks_m[:, None], LANDMARK_RGBA)]
        drawn_as['headings'].append((np.stack([robots_m, robots_m + tips_m], axis=1), color))
        drawn_as['enclosures'].append((in_space(_edges(placement.enclosure_m)), color))
        drawn_as['links'].append((points_m[pairs], link_colors))
    markers = [*(_marker(name, drawn_as[name]) for name in LOOKS), *_names(estimate)]
    shown = tuple(marker for marker in markers if len(marker.points_m))
    return MarkerScene(estimate.stamp_s, frame_id, shown, lifetime_s)


def _color(hypothesis: int) -> NDArray[np.float64]:
    return np.array([*hsv_to_rgb((FIRST_HUE + hypothesis * HUE_STEP) % 1.0, 0.8, 0.95), 0.9])


def _points(placement: Placement) -> NDArray[np.float64]:
    """Return the robots, then the landmarks, shape (n + m, 3)."""
    return in_space(np.concatenate([placement.positions_m, placement.landmarks_m]))


def _marker(namespace: str, parts: list[Objects]) -> Marker:
    """Join all known objects to one marker."""
    points_m, colors = [np.zeros((0, 3))], [np.zeros((0, 4))]
    for objects_m, color in parts:
        is_known = np.isfinite(objects_m).all(axis=(1, 2))
        points_m.append(objects_m[is_known].reshape(-1, 3))
        of_objects = np.broadcast_to(color, (len(objects_m), 4))[is_known]
        colors.append(np.repeat(of_objects, objects_m.shape[1], axis=0))
    shape, size_m = LOOKS[namespace]
    return Marker(namespace, 0, shape, np.concatenate(points_m), np.concatenate(colors), size_m)


def _edges(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the edges of boxes of shape (k, 2, q), two rows each, shape (k, m, q)."""
    dimension = boxes.shape[2]
    corners = [np.array(choice) for choice in product((0, 1), repeat=dimension)]
    pairs = [pair for pair in combinations(corners, 2) if np.abs(pair[0] - pair[1]).sum() == 1]
    # For each row, the index of its bound in each coordinate.
    bounds = np.array([corner for pair in pairs for corner in pair])
    return boxes[:, bounds, np.arange(dimension)]


def _link_color(link: LinkState) -> NDArray[np.float64]:
    if link.contradicts:
        return CONTRADICTING_RGBA
    return STALE_RGBA if link.stale else FRESH_RGBA


def _names(estimate: Estimate) -> Iterator[Marker]:
    """Yield the name of each point, once for all placements with about the same place."""
    names = (*estimate.robots, *estimate.landmarks)
    # Beside the point as seen from above, and above it as seen from the side.
    offset = np.array([0.0, ROBOT_DIAMETER_M, ROBOT_DIAMETER_M])
    placed_m = np.reshape([_points(one) for one in estimate.placements], (-1, len(names), 3))
    for number, points_m in enumerate(placed_m):
        before_m = np.linalg.norm(placed_m[:number] - points_m, axis=2)
        is_new = np.isfinite(points_m).all(axis=1) & ~(before_m < NAME_HEIGHT_M).any(axis=0)
        for row in np.flatnonzero(is_new).tolist():
            yield Marker(
                namespace='names',
                identifier=number * len(names) + row,
                shape=Shape.TEXT,
                points_m=points_m[None, row] + offset,
                colors_rgba=NAME_RGBA[None, :],
                size_m=NAME_HEIGHT_M,
                text=names[row],
            )


class Publishers:
    """
    The publishers of a node on some topics, which take messages, serialized or not.

    They have no event callbacks: an executor would check each of them at every wake-up.

    Parameters
    ----------
    node : Node
        The node that owns them.
    outputs : iterable of Output

    """

    def __init__(self, node: Node, outputs: Iterable[Output]) -> None:
        self._node = node
        events = PublisherEventCallbacks(use_default_callbacks=False)
        self._publishers: dict[str, Publisher] = {
            name: node.create_publisher(message_class, name, qos, event_callbacks=events)
            for name, message_class, qos in outputs
        }

    def publish(self, messages: Iterable[tuple[str, Any]]) -> None:
        """Publish messages, each with the name of its topic."""
        for name, message in messages:
            self._publishers[name].publish(message)

    def destroy(self) -> None:
        """Remove the topics from the graph after the last messages have arrived."""
        deadline_s = time.monotonic() + ACKNOWLEDGE_S
        for publisher in self._publishers.values():
            left_s = max(0.0, deadline_s - time.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=left_s))
            self._node.destroy_publisher(publisher)


class DiagnosticsStream:
    """
    Makes messages of the diagnostics that are to be published.

    Diagnostics that have not changed are repeated only at regular times. A change is another
    level, or a message that differs in more than decimal numbers and counts.
    """

    def __init__(self) -> None:
        self._last_seen: object = None

    def messages(
        self, diagnostics: Diagnostics, is_regular: bool = True
    ) -> Iterator[tuple[str, bytes]]:
        """Yield the message with the name of its topic, if it is to be published."""
        before = self._last_seen
        self._last_seen = [
            (status.name, status.level, DECIMAL.sub('#', status.message))
            for status in diagnostics.statuses
        ]
        if is_regular or before != self._last_seen:
            yield DIAGNOSTICS.name, diagnostics_to_cdr(diagnostics)
