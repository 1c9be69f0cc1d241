# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A listener that joins the answers of the localizer with the truth of the simulation."""

from collections import deque
from functools import partial
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from visualization_msgs.msg import MarkerArray

from dg_localization.ros.demo.compare import (
    Answer,
    Compared,
    StatedPose,
    Truth,
    frame_of,
    robot_of_odometry_frame,
    truth_at,
    yaws_of,
)
from dg_localization.ros.interface.outputs import LATCHED
from dg_localization.simulation.moving_fleet import ROBOTS
from dg_localization.solver.result import Verdict
from msg_adapters.diagnostics import diagnostics_from_message
from msg_adapters.markers import marker_scene_from_message
from msg_adapters.odometry import odometry_from_message
from msg_adapters.poses import pose_array_from_message

POINTS_PER_BOX = 8

NEWEST_STATED = 3
"""Which odometry of a robot was the last to arrive before an answer is one of so many."""


class Spectator(Node):
    """
    Listens to the localizer, and to the simulation for the truth, and compares the two.

    Attributes
    ----------
    compared : list of Compared
        The answers with placements.
    contradictions : set of float
        The stamps in s of answers without any placement, as far as the diagnostics name them: they
        come when an answer is of another kind than the one before, and every second.
    status : str
        What the localizer says of itself.

    """

    def __init__(self) -> None:
        super().__init__('demo')
        self.compared: list[Compared] = []
        self.contradictions: set[float] = set()
        self.status = 'waiting for the localizer'
        self._began_s = math.inf
        self._shape_frame = ''
        self._truths: deque[Truth] = deque(maxlen=200)
        self._poses: dict[float, Any] = {}
        self._boxes: dict[float, NDArray[np.float64]] = {}
        self._waiting: deque[tuple[Answer, str]] = deque(maxlen=50)
        self._stated: dict[str, deque[StatedPose]] = {robot: deque(maxlen=100) for robot in ROBOTS}
        for robot in ROBOTS:
            self.create_subscription(
                Odometry,
                f'/{robot}/odom',
                partial(self._on_odometry, robot),
                qos_profile_sensor_data,
            )
        for message_class, topic, callback, qos in (
            (PoseArray, '/simulate_fleet/ground_truth', self._on_truth, LATCHED),
            (PoseArray, '/localizer/feasible_poses', self._on_poses, LATCHED),
            (MarkerArray, '/localizer/markers', self._on_markers, LATCHED),
            (DiagnosticArray, '/diagnostics', self._on_diagnostics, 10),
        ):
            self.create_subscription(message_class, topic, callback, qos)

    def begin(self) -> None:
        """Forget the first answers: those after them count."""
        self._began_s = self.compared[-1].answer.stamp_s
        self.compared.clear()

    def _on_truth(self, message: PoseArray) -> None:
        poses = pose_array_from_message(message)
        yaws_rad = yaws_of(poses.orientations_xyzw)
        self._truths.append(Truth(poses.stamp_s, poses.positions_m[:, :2], yaws_rad))
        self._compare()

    def _on_odometry(self, robot: str, message: Odometry) -> None:
        reading = odometry_from_message(message)
        yaw_rad = float(yaws_of(np.array(reading.orientation_xyzw)))
        place_m = np.array(reading.position_xyz[:2])
        self._stated[robot].append(StatedPose(robot, reading.stamp_s, place_m, yaw_rad))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in diagnostics_from_message(message).statuses:
            if status.name == 'localizer: fleet':
                self.status = status.message
                frame = status.values.get('frame', '')
                # Other frames are known by the name that the answers have.
                self._shape_frame = frame if frame.startswith('origin') else self._shape_frame
                # An answer that is empty because inputs are missing is no contradiction.
                if status.values.get('verdict') == Verdict.INFEASIBLE.value:
                    self._add_contradiction(float(status.values['stamp_s']))

    def _add_contradiction(self, stamp_s: float) -> None:
        """Add an answer without any placement, if it counts."""
        if stamp_s > self._began_s:
            self.contradictions.add(stamp_s)

    def _on_poses(self, message: PoseArray) -> None:
        poses = pose_array_from_message(message)
        self._poses = {poses.stamp_s: poses}
        self._join(poses.stamp_s)

    def _on_markers(self, message: MarkerArray) -> None:
        scene = marker_scene_from_message(message)
        corners = [m.points_m for m in scene.markers if m.namespace == 'enclosures']
        self._boxes = {scene.stamp_s: np.concatenate([np.zeros((0, 3)), *corners])}
        self._join(scene.stamp_s)

    def _join(self, stamp_s: float) -> None:
        """Make an answer of the poses and markers of one time, once both are there."""
        if stamp_s not in self._poses or stamp_s not in self._boxes:
            return
        poses, corners = self._poses.pop(stamp_s), self._boxes.pop(stamp_s)
        n_poses = len(poses.positions_m)
        # While inputs are missing some robots are not bounded and have no enclosure to draw.
        if n_poses == 0 or len(corners) != POINTS_PER_BOX * n_poses:
            return
        by_box = corners[:, :2].reshape(-1, len(ROBOTS), POINTS_PER_BOX, 2)
        answer = Answer(
            stamp_s,
            poses.positions_m[:, :2].reshape(-1, len(ROBOTS), 2),
            yaws_of(poses.orientations_xyzw).reshape(-1, len(ROBOTS)),
            np.stack([by_box.min(axis=2), by_box.max(axis=2)], axis=2),
        )
        self._waiting.append((answer, poses.frame_id))
        self._compare()

    def _compare(self) -> None:
        """Compare every answer whose truth has arrived."""
        while self._waiting and self._truths:
            answer, frame_id = self._waiting[0]
            frame = frame_of(frame_id) or self._shape_frame
            if not frame or self._truths[-1].stamp_s < answer.stamp_s:
                return
            self._waiting.popleft()
            truth = truth_at(self._truths, answer.stamp_s)
            seen = [] if truth is None else self._in_frame(truth, frame)
            compared = [Compared(answer, one, frame) for one in seen]
            holding = [one for one in compared if len(one.held_by)]
            self.compared += (holding or compared)[-1:]

    def _in_frame(self, truth: Truth, frame: str) -> list[Truth]:
        """Return a truth in the frame of the answers: that of one of the newest odometry."""
        robot = robot_of_odometry_frame(frame)
        if robot is None:
            return [truth.in_frame(frame)]
        stated = [pose for pose in self._stated[robot] if pose.stamp_s <= truth.stamp_s]
        return [
            truth.in_odometry_frame(pose, then)
            for pose in stated[-NEWEST_STATED:]
            if (then := truth_at(self._truths, pose.stamp_s)) is not None
        ]
