# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a bag holds of every input, and where the robots truly were, for learning error bounds."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
import csv
from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rclpy.serialization import deserialize_message

from dg_localization.calibration.truth import TrueTrack
from dg_localization.fleet import FleetConfig, LinkKey, LinkKind, Localizer, Rejection
from dg_localization.fleet.error_models import in_body_frame, interpret_range, interpret_ray
from dg_localization.fleet.localizer import PeerMeasurement
from dg_localization.fleet.measurements import is_pose
from dg_localization.ros.bags.offline import Inputs, in_seconds
from dg_localization.ros.bags.reader import BagError, BagMessage, find_message_class
from dg_localization.ros.executables import UsageError
from dg_localization.ros.interface.intake import Intake
from dg_localization.ros.interface.parameters.settings import Settings
from msg_adapters.geometry import xyz_from_message, xyzw_from_message
from msg_adapters.headers import stamp_from_message

POSE_TYPES = (
    'geometry_msgs/msg/PoseStamped',
    'geometry_msgs/msg/PoseWithCovarianceStamped',
    'nav_msgs/msg/Odometry',
)
POSE_ARRAY = 'geometry_msgs/msg/PoseArray'
ROBOT = '{robot}'
COLUMNS = ('stamp', 'robot', 'x', 'y')


@dataclass
class Samples:
    """
    The readings of a bag by input, each with its stamp in s, oldest first as they arrived.

    Attributes
    ----------
    ranges : dict of LinkKey to list of (float, float)
        Ranges in m that the error model takes.
    rays : dict of LinkKey to list of (float, ndarray)
        Unit vectors.
    odometry : dict of str to list of (float, ndarray, ndarray)
        By robot, positions and quaternions.
    truth : dict of str to list of (float, ndarray, ndarray)
        By robot, positions and quaternions.

    """

    ranges: dict[LinkKey, list[tuple[float, float]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    rays: dict[LinkKey, list[tuple[float, Any]]] = field(default_factory=lambda: defaultdict(list))
    odometry: dict[str, list[tuple[float, Any, Any]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    truth: dict[str, list[tuple[float, Any, Any]]] = field(
        default_factory=lambda: defaultdict(list)
    )

    @property
    def n_readings(self) -> int:
        """How many ranges and rays there are."""
        return sum(len(rows) for rows in (*self.ranges.values(), *self.rays.values()))

    def tracks(self, settings: Settings) -> dict[str, TrueTrack]:
        """Return the true paths of robots and sensors and the places of anchors, by name."""
        tracks = {
            robot: TrueTrack(*map(np.array, zip(*rows, strict=True)))
            for robot, rows in self.truth.items()
        }
        for name, anchor in settings.fleet.anchors.items():
            tracks.setdefault(name, TrueTrack.at_rest(anchor.coordinates_m))
        for name, mount in settings.fleet.sensors.items():
            robot = tracks.get(settings.fleet.robot_of(name))
            if robot is not None:
                tracks[name] = robot.carrying(mount.position_m)
        return tracks


class _Gatherer(Localizer):
    """
    Keeps the readings that the intake gives to a localizer, and localizes nothing.

    Parameters
    ----------
    config : FleetConfig

    """

    def __init__(self, config: FleetConfig) -> None:
        super().__init__(config)
        self.samples = Samples()

    def add_range(
        self,
        observer: str,
        target: str,
        range_m: float,
        stamp_s: float,
        now_s: float,
        min_range_m: float | None = None,
        max_range_m: float | None = None,
        variance_m2: float | None = None,
    ) -> None:
        """Keep a range that the error model takes and that is a number."""
        taken = interpret_range(self.config.range_error, range_m, min_range_m, max_range_m, 0.0)
        if math.isfinite(range_m) and not isinstance(taken, Rejection):
            key = LinkKey(LinkKind.RANGE, observer, target)
            self.samples.ranges[key].append((stamp_s, range_m))

    def add_bearing(
        self, observer: str, target: str, ray_xyz: ArrayLike, stamp_s: float, now_s: float
    ) -> None:
        """Keep the unit vector of a ray that has a direction, in the body frame."""
        taken = in_body_frame(self.config.sensors.get(observer), ray_xyz)
        if not isinstance(taken, Rejection):
            taken = interpret_ray(taken, self.config.dimension)
        if not isinstance(taken, Rejection):
            key = LinkKey(LinkKind.BEARING, observer, target)
            self.samples.rays[key].append((stamp_s, taken))

    def add_odometry(
        self,
        robot: str,
        position_xyz: ArrayLike,
        orientation_xyzw: ArrayLike,
        stamp_s: float,
        now_s: float,
        frame: str = '',
    ) -> None:
        """Keep what is a pose."""
        position = np.asarray(position_xyz, dtype=float)
        turn = np.asarray(orientation_xyzw, dtype=float)
        if is_pose(position, turn):
            unit = turn / np.linalg.norm(turn)
            self.samples.odometry[robot].append((stamp_s, position, unit))

    def odometry_restarted_s(self, robot: str) -> float:
        """Return 0: poses are kept as they come, and restarts are not looked for."""
        return 0.0

    def add_peers(
        self, observer: str, readings: Iterable[PeerMeasurement], stamp_s: float, now_s: float
    ) -> list[Rejection]:
        """Keep everything that one robot measured."""
        for target, value in readings:
            if isinstance(value, int | float):
                self.add_range(observer, target, value, stamp_s, now_s)
            else:
                self.add_bearing(observer, target, value, stamp_s, now_s)
        return []


class Collector:
    """
    Gathers the readings of a bag.

    Parameters
    ----------
    settings : Settings
    inputs : Inputs
    truth : mapping of str to str
        By topic of the ground truth, the robot; empty for the poses of all robots.

    """

    def __init__(self, settings: Settings, inputs: Inputs, truth: Mapping[str, str]) -> None:
        self._settings = settings
        self._links = {link.topic: link for link in inputs.links}
        self._truth = truth
        self._gatherer = _Gatherer(settings.fleet)
        self._intake = Intake(self._gatherer, settings.use_header_stamp, settings.ids)
        self._malformed_truth = 0
        self.samples = self._gatherer.samples

    @property
    def malformed(self) -> int:
        """How many messages could not be read."""
        of_inputs = sum(wrong.count for wrong in self._intake.malformed.values())
        return of_inputs + self._malformed_truth

    def take(self, message: BagMessage, message_class: type) -> None:
        """Take one recorded message."""
        now_s = in_seconds(message.time_ns)
        if message.topic in self._truth:
            self._take_truth(message, message_class, now_s)
        # The odometry of one input may serve as the truth of another.
        if link := self._links.get(message.topic):
            self._intake.take(link, message.data, now_s)

    def _take_truth(self, message: BagMessage, message_class: type, now_s: float) -> None:
        try:
            decoded = deserialize_message(message.data, message_class)
            stamp_s = stamp_from_message(decoded.header.stamp)
            robot = self._truth[message.topic]
            poses = [_pose_of(decoded)] if robot else decoded.poses
            rows = [
                (xyz_from_message(p.position), xyzw_from_message(p.orientation)) for p in poses
            ]
        except Exception:  # on damaged bytes whatever the decoder raises
            self._malformed_truth += 1
            return
        robots = [robot] if robot else self._settings.fleet.robots
        if len(rows) != len(robots):
            raise BagError(
                f'{message.topic} has {len(rows)} poses, there are {len(robots)} robots: it must '
                "hold one pose for each of the parameter 'robots', in that order"
            )
        if not self._settings.use_header_stamp:
            stamp_s = now_s
        for name, (position_m, orientation) in zip(robots, rows, strict=True):
            self.samples.truth[name].append((stamp_s, position_m, orientation))


def _pose_of(message: Any) -> Any:
    """Return the pose of a message, with a covariance or without."""
    return getattr(message.pose, 'pose', message.pose)


def find_truth(
    names: Iterable[str], robots: Sequence[str], recorded: Mapping[str, Sequence[str]]
) -> dict[str, str]:
    """
    Find the topics of a ground truth.

    Parameters
    ----------
    names : iterable of str
        Topics: with `{robot}` the pose of one robot each, without it those of all robots.
    robots : sequence of str
    recorded : mapping of str to sequence of str
        By topic the types of its messages.

    Returns
    -------
    dict of str to str
        By topic the robot; empty for all robots.

    Raises
    ------
    BagError
        If a topic is not there or of a type that has no poses.

    """
    found: dict[str, str] = {}
    for name in names:
        allowed = POSE_TYPES if ROBOT in name else (POSE_ARRAY,)
        topics = {name.replace(ROBOT, r): r for r in robots} if ROBOT in name else {name: ''}
        present = {topic: robot for topic, robot in topics.items() if topic in recorded}
        if not present:
            raise BagError(
                f'no topic {" or ".join(topics)} in the bag; it has {", ".join(sorted(recorded))}'
            )
        for topic in present:
            if len(recorded[topic]) != 1 or recorded[topic][0] not in allowed:
                raise BagError(
                    f'{topic} is {" and ".join(recorded[topic])}; a ground truth is '
                    f'{" or ".join(allowed)}'
                )
            if find_message_class(recorded[topic][0]) is None:
                raise BagError(f'{topic}: its type {recorded[topic][0]} is not installed')
        found.update(present)
    return found


def read_truth_file(
    path: Path, robots: Sequence[str], dimension: int
) -> dict[str, list[tuple[float, Any, Any]]]:
    """
    Read a ground truth from a table in text.

    Parameters
    ----------
    path : Path
        A .csv with the columns stamp (s), robot, x, y (m), and z (m) and yaw (rad) where they are
        known; in space z has to be. NaN stands for what is not known.
    robots : sequence of str
        Other names are passed over.
    dimension : {2, 3}

    Returns
    -------
    dict of str to list of (float, ndarray, ndarray)
        By robot, stamps, positions and quaternions.

    Raises
    ------
    UsageError
        If the file is no such table, or a value is no number or infinite, or a stamp is not
        known; the message names the line.

    """
    try:
        with path.open(newline='', encoding='utf-8-sig') as file:
            return _truth_of(path, csv.DictReader(file), robots, dimension)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f'{path} is no table in UTF-8: {error}') from None


def _truth_of(
    path: Path, rows: 'csv.DictReader[str]', robots: Sequence[str], dimension: int
) -> dict[str, list[tuple[float, Any, Any]]]:
    """Return the ground truth in the rows of a table."""
    truth: dict[str, list[tuple[float, Any, Any]]] = defaultdict(list)
    wanted = COLUMNS if dimension == 2 else (*COLUMNS, 'z')
    missing = [name for name in wanted if name not in (rows.fieldnames or ())]
    if missing:
        raise UsageError(
            f'{path} has no column {", ".join(missing)}; its first line must name stamp, '
            'robot, x, y, in space z, and z and yaw where they are known'
        )
    flat = '0' if dimension == 2 else ''
    for row in rows:
        try:
            stamp_s, x, y = (float(row[name]) for name in ('stamp', 'x', 'y'))
            z, half = float(row.get('z') or flat), float(row.get('yaw') or math.nan) / 2.0
            if not math.isfinite(stamp_s):
                raise ValueError(f'stamp {stamp_s} is not a finite number')
            if any(map(math.isinf, (x, y, z, half))):
                raise ValueError('no position and no yaw is infinite')
        except (TypeError, ValueError) as error:
            raise UsageError(f'{path}, line {rows.line_num}: {error}') from None
        if row['robot'] in robots:
            turn = np.array([0.0, 0.0, math.sin(half), math.cos(half)])
            truth[row['robot']].append((stamp_s, np.array([x, y, z]), turn))
    return truth
