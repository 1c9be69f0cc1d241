# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The demonstration: `simulate_fleet` and `localizer` as two processes, looked at as a user would.

First the robots measure ranges only. Then they drive loops and publish odometry: mirror images
disappear and headings appear. At last they see each other. Every answer on the topics of the
localizer is compared with the simulated truth. The exit code is 1 when the truth was in no
hypothesis of some answer.

    python docs/demo.py [--seconds 5] [--picture demo.png]
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
import re
import subprocess
import sys
import tempfile
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from visualization_msgs.msg import MarkerArray

from dg_localization.calibration.truth import FleetTruth, TruePlacement, TrueTrack
from dg_localization.fleet import FixedFrame, FleetConfig, FrameKind
from dg_localization.fleet.rotations import rotation_of_quaternion
from dg_localization.fleet.vocabulary import OdometrySample
from dg_localization.ros.domain import claim_domain
from dg_localization.simulation.moving_fleet import EDGES, ROBOTS
from msg_adapters.diagnostics import diagnostics_from_message
from msg_adapters.markers import marker_scene_from_message
from msg_adapters.poses import pose_array_from_message
from msg_adapters.readings import odometry_from_message

CONFIG = Path(__file__).parents[1] / 'config/paper_fleet.yaml'
COLORS = ('#0072B2', '#E69F00', '#009E73', '#D55E00', '#CC79A7', '#56B4E9')
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# Without compiled kernels in its cache the localizer compiles them before its first answer.
FIRST_ANSWER_S = 1800.0
ROUNDING_M = 1e-6

MOVING = {'path': 'loops', 'speed': 0.5, 'odometry': True, 'peers': True, 'rate': 5.0}
ODOMETRY = {
    'max_speed': 0.6,
    'max_turn_rate': 1.5,
    'odometry.translation_per_m': 0.05,
    'odometry.rotation_per_m': 0.0,
    'odometry.rotation_per_rad': 0.05,
    'odometry.constant_translation': 0.002,
    'odometry.constant_rotation': 0.002,
    'rate': 2.0,
    # Sixteen hypotheses share the time for what is remembered.
    'memory.max_seconds': 1.0,
}


@dataclass
class Phase:
    """A title, how many times as long it takes, and the parameters of both executables."""

    title: str
    times: float
    simulator: dict[str, Any]
    localizer: dict[str, Any] = field(default_factory=dict)


PHASES = (
    Phase('Ranges', 1.0, {'cameras': False}),
    Phase('The robots move', 6.0, {'cameras': False, 'odometry_rate': 10.0, **MOVING}, ODOMETRY),
    Phase('With cameras', 1.0, {'cameras': True}),
)


@dataclass
class Answer:
    """
    Every feasible placement at one time, and the truth.

    Positions (k, n, 2) in m, headings (k, n) in rad, NaN where unknown, boxes (k, n, 2, 2) in m.
    """

    stamp_s: float
    positions_m: np.ndarray
    yaws_rad: np.ndarray
    boxes_m: np.ndarray
    truth: TruePlacement

    @property
    def holding(self) -> list[int]:
        """The hypotheses whose boxes hold the true places of all robots."""
        low, high = self.boxes_m[:, :, 0] - ROUNDING_M, self.boxes_m[:, :, 1] + ROUNDING_M
        inside = (low <= self.truth.positions_m) & (self.truth.positions_m <= high)
        return np.flatnonzero(inside.all(axis=(1, 2))).tolist()

    @property
    def width_m(self) -> float:
        """The longest side of all boxes."""
        return float(np.ptp(self.boxes_m, axis=2).max())


class Spectator(Node):
    """Joins the answers of the localizer with the truth of the simulation."""

    def __init__(self) -> None:
        super().__init__('demo')
        self.answers: list[Answer] = []
        self.status = 'waiting for the localizer'
        self._shape: FixedFrame | None = None
        self._poses: dict[float, Any] = {}
        self._boxes: dict[float, np.ndarray] = {}
        self._truths: list[Any] = []
        self._odometry: dict[str, list[OdometrySample]] = {robot: [] for robot in ROBOTS}
        for topic, kind, take in (
            ('/simulate_fleet/ground_truth', PoseArray, self._take_truth),
            ('/localizer/feasible_poses', PoseArray, self._take_poses),
            ('/localizer/markers', MarkerArray, self._take_markers),
        ):
            self.create_subscription(kind, topic, take, LATCHED)
        self.create_subscription(DiagnosticArray, '/diagnostics', self._take_diagnostics, 10)
        for robot in ROBOTS:
            take = partial(self._take_odometry, robot)
            self.create_subscription(Odometry, f'/{robot}/odom', take, qos_profile_sensor_data)

    def _take_odometry(self, robot: str, message: Odometry) -> None:
        read = odometry_from_message(message)
        turn = rotation_of_quaternion(np.array(read.orientation_xyzw)[None])[0]
        reading = OdometrySample(read.stamp_s, np.array(read.position_xyz), turn)
        self._odometry[robot] = [*self._odometry[robot][-100:], reading]

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in diagnostics_from_message(message).statuses:
            if status.name == 'localizer: fleet':
                self.status = status.message
                ends = re.findall(r'robot_\d', status.values.get('frame', ''))
                if status.values.get('frame', '').startswith('origin'):
                    self._shape = FixedFrame(FrameKind.ROBOTS, tuple(ends))

    def _take_poses(self, message: PoseArray) -> None:
        poses = pose_array_from_message(message)
        self._poses[poses.stamp_s] = poses

    def _take_markers(self, message: MarkerArray) -> None:
        scene = marker_scene_from_message(message)
        corners = [m.points_m for m in scene.markers if m.namespace == 'enclosures']
        self._boxes[scene.stamp_s] = np.concatenate([np.zeros((0, 3)), *corners])

    def _take_truth(self, message: PoseArray) -> None:
        self._truths = [*self._truths[-200:], pose_array_from_message(message)]
        for stamp_s in sorted(self._poses.keys() & self._boxes.keys()):
            if stamp_s <= self._truths[-1].stamp_s:
                poses, corners = self._poses.pop(stamp_s), self._boxes.pop(stamp_s)
                # Robots that are not bounded have no box, while inputs are missing.
                if len(poses.positions_m) and len(corners) == 8 * len(poses.positions_m):
                    self.answers += self._compared(stamp_s, poses, corners)

    def _compared(self, stamp_s: float, poses: Any, corners: np.ndarray) -> Iterator[Answer]:
        """Yield an answer beside the truth in its frame, once that is known."""
        robot, _, kind = poses.frame_id.partition('/')
        frame, odometry = self._shape, list[OdometrySample | None]([None])
        if kind:
            is_odometry = kind == 'odom'
            frame = FixedFrame(FrameKind.ODOMETRY if is_odometry else FrameKind.HEADING, (robot,))
            before = [one for one in self._odometry[robot] if one.stamp_s <= stamp_s]
            # Which one was the last to reach the localizer before its answer is not told.
            odometry = [*before[-3:]] if is_odometry else [None]
        if frame is None:
            return
        stamps_s = [one.stamp_s for one in self._truths]
        tracks = {
            name: TrueTrack(
                stamps_s,
                [one.positions_m[row] for one in self._truths],
                [one.orientations_xyzw[row] for one in self._truths],
            )
            for row, name in enumerate(ROBOTS)
        }
        truth = FleetTruth(FleetConfig(ROBOTS), tracks)
        turns = poses.orientations_xyzw
        known = np.any(turns != 0.0, axis=1)
        yaws_rad = np.where(known, 2.0 * np.arctan2(turns[:, 2], turns[:, 3]), np.nan)
        boxes_m = corners[:, :2].reshape(-1, len(ROBOTS), 8, 2)
        found = [
            Answer(
                stamp_s,
                poses.positions_m[:, :2].reshape(-1, len(ROBOTS), 2),
                yaws_rad.reshape(-1, len(ROBOTS)),
                np.stack([boxes_m.min(axis=2), boxes_m.max(axis=2)], axis=2),
                truth.at(frame, stamp_s, newest),
            )
            for newest in odometry
        ]
        true = [answer for answer in found if np.isfinite(answer.truth.positions_m).all()]
        yield from ([answer for answer in true if answer.holding] or true)[-1:]


@contextmanager
def running(name: str, *arguments: str, **parameters: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Run an executable of this package in a process of its own."""
    command = [sys.executable, '-m', 'dg_localization.ros', name, '--ros-args', *arguments]
    for parameter, value in parameters.items():
        command += ['-p', f'{parameter}:={str(value).lower()}']
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
        try:
            yield process
            if process.poll() is not None:
                log.seek(0)
                sys.exit(f'{name} ended:\n{log.read().decode()}')
        finally:
            process.terminate()
            process.wait(10.0)


def run(phase: Phase, seconds: float) -> list[Answer]:
    """Run a phase, tell how it goes, and return its answers."""
    print(f'{phase.title}:')
    spectator, began_s, told_s = Spectator(), time.monotonic(), time.monotonic()
    localizer = running('localizer', '--params-file', str(CONFIG), **phase.localizer)
    with running('simulate_fleet', **phase.simulator) as simulator, localizer as node:
        end_s = began_s + FIRST_ANSWER_S
        while time.monotonic() < end_s and simulator.poll() is None and node.poll() is None:
            if spectator.answers:
                end_s = min(end_s, time.monotonic() + phase.times * seconds)
            rclpy.spin_once(spectator, timeout_sec=0.1)
            if time.monotonic() - told_s >= 5.0:
                told_s = time.monotonic()
                print(f'  {told_s - began_s:5.0f} s  {spectator.status}', flush=True)
    answers = spectator.answers
    if not answers:
        sys.exit(f'no answer within {FIRST_ANSWER_S:g} s: {spectator.status}')
    counts = [len(answer.positions_m) for answer in answers]
    held = sum(bool(answer.holding) for answer in answers)
    print(
        f'  {max(counts)} hypotheses at most, {min(counts)} at least; the truth is in one of '
        f'them in {held} of {len(answers)} answers.'
    )
    spectator.destroy_node()
    return answers


def draw(phases: dict[str, list[Answer]], path: Path) -> None:
    """Draw the answer of each phase that has the fewest hypotheses and the smallest boxes."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot
    from matplotlib.patches import Rectangle

    figure, panels = pyplot.subplots(1, len(phases), figsize=(16, 5.6), layout='constrained')
    for panel, (title, answers) in zip(panels, phases.items(), strict=True):
        best = min(answers, key=lambda answer: (len(answer.positions_m), answer.width_m))
        true_m, count = best.truth.positions_m, len(best.positions_m)
        for a, b in EDGES:
            panel.plot(*best.positions_m[:, [a, b]].T, color='0.8', linewidth=0.7, zorder=1)
            panel.plot(*true_m[[a, b]].T, color='black', linewidth=1.2, zorder=4)
        for robot, color in enumerate(COLORS):
            for low, high in best.boxes_m[:, robot]:
                box = Rectangle(low, *(high - low), facecolor=color, edgecolor=color, alpha=0.15)
                panel.add_patch(box)
            places_m, yaws_rad = best.positions_m[:, robot], best.yaws_rad[:, robot]
            panel.plot(*places_m.T, 'o', color=color, label=ROBOTS[robot])
            ways_m = np.stack([np.cos(yaws_rad), np.sin(yaws_rad)])
            panel.quiver(*places_m.T, *ways_m, color=color, scale=12.0, width=0.006, zorder=5)
        panel.plot(*true_m.T, 'o', color='black', markersize=12, fillstyle='none', label='truth')
        after = f' after {best.stamp_s - answers[0].stamp_s:.0f} s' if count == 1 else ''
        panel.set_title(f'{title}: {count} hypothes{"i" if count == 1 else "e"}s{after}')
        panel.set_aspect('equal', adjustable='datalim')
        panel.set(xlabel='x [m]', ylabel='y [m]')
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=7, frameon=False)
    figure.savefig(path, dpi=110)
    print(f'All feasible placements next to the truth: {path}')


def main() -> int:
    """Run all phases; return the exit code."""
    parser = argparse.ArgumentParser(description='Localize a simulated fleet over DDS.')
    parser.add_argument('--seconds', type=float, default=5.0, help='length of the first phase')
    parser.add_argument('--picture', type=Path, default='demo.png', help='file to write')
    options = parser.parse_args()
    print(f'Six robots measure nine ranges to +-3 % (ROS_DOMAIN_ID={claim_domain()}).')
    rclpy.init()
    phases = {phase.title: run(phase, options.seconds) for phase in PHASES}
    rclpy.shutdown()
    draw(phases, options.picture)
    return int(not all(answer.holding for answers in phases.values() for answer in answers))


if __name__ == '__main__':
    sys.exit(main())
