# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A listener that joins the answers of the localizer with the truth of the simulation."""

from collections import deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from dg_localization.ros.demo.compare import Answer, Compared, Truth, truth_at, yaws_of
from dg_localization.ros.interface.outputs import LATCHED
from dg_localization.simulation.moving_fleet import ROBOTS
from msg_adapters.diagnostics import diagnostics_from_message
from msg_adapters.markers import marker_scene_from_message
from msg_adapters.poses import pose_array_from_message

POINTS_PER_BOX = 8


class Spectator(Node):
    """Listens to the localizer, and to the simulation for the truth, and compares the two."""

    def __init__(self) -> None:
        super().__init__('demo')
        self.compared: list[Compared] = []
        self.status = 'waiting for the localizer'
        self._frame = ''
        self._truths: deque[Truth] = deque(maxlen=200)
        self._poses: dict[float, Any] = {}
        self._boxes: dict[float, NDArray[np.float64]] = {}
        self._waiting: deque[Answer] = deque(maxlen=50)
        for message_class, topic, callback, qos in (
            (PoseArray, '/simulate_fleet/ground_truth', self._on_truth, LATCHED),
            (PoseArray, '/localizer/feasible_poses', self._on_poses, LATCHED),
            (MarkerArray, '/localizer/markers', self._on_markers, LATCHED),
            (DiagnosticArray, '/diagnostics', self._on_diagnostics, 10),
        ):
            self.create_subscription(message_class, topic, callback, qos)

    def _on_truth(self, message: PoseArray) -> None:
        poses = pose_array_from_message(message)
        yaws_rad = yaws_of(poses.orientations_xyzw)
        self._truths.append(Truth(poses.stamp_s, poses.positions_m[:, :2], yaws_rad))
        self._compare()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in diagnostics_from_message(message).statuses:
            if status.name == 'localizer: fleet':
                self.status = status.message
                self._frame = status.values.get('frame', '')

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
        self._waiting.append(
            Answer(
                stamp_s,
                poses.positions_m[:, :2].reshape(-1, len(ROBOTS), 2),
                yaws_of(poses.orientations_xyzw).reshape(-1, len(ROBOTS)),
                np.stack([by_box.min(axis=2), by_box.max(axis=2)], axis=2),
            )
        )
        self._compare()

    def _compare(self) -> None:
        """Compare every answer whose truth has arrived."""
        while self._frame and self._waiting and self._truths:
            if self._truths[-1].stamp_s < self._waiting[0].stamp_s:
                return
            answer = self._waiting.popleft()
            truth = truth_at(self._truths, answer.stamp_s)
            if truth is not None:
                self.compared.append(Compared(answer, truth.in_frame(self._frame), self._frame))
