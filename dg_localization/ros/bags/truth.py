# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Where the robots truly were: in topics of a bag, or in tables."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from dg_localization.calibration.answers import FleetTruth
from dg_localization.calibration.truth import TrueTrack
from dg_localization.fleet import FleetConfig
from dg_localization.ros.bags.bag import Bag, BagError, find_message_class
from dg_localization.ros.bags.offline import in_seconds
from dg_localization.ros.bags.reading import BagMessage, Reading
from dg_localization.ros.bags.truth_table import Poses, read_table
from dg_localization.ros.executables import UsageError
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
TABLES = ('.csv', '.tsv', '.txt', '.tum')


def is_table(name: str) -> bool:
    """Return whether a ground truth is that of a file."""
    return name.lower().endswith(TABLES)


@dataclass
class Truth:
    """
    A ground truth.

    Attributes
    ----------
    poses : Poses
        By robot its stamps in s, positions and quaternions.
    topics : dict of str to str
        By topic that it is read of, the robot; empty for the poses of all robots.
    notices, damage : list of str
        What is passed over or not known, and what is wrong with the bag, a sentence each.

    """

    settings: Settings
    topics: dict[str, str] = field(default_factory=dict)
    poses: Poses = field(default_factory=lambda: defaultdict(list))
    notices: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    malformed: int = 0

    def take(self, message: BagMessage, message_class: type) -> None:
        """Take a message on one of the topics; it may have another number of poses: BagError."""
        robot = self.topics[message.topic]
        try:
            decoded: Any = deserialize_message(message.data, message_class)
            stamp_s = stamp_from_message(decoded.header.stamp)
            # The pose of a message, with a covariance or without.
            poses = [getattr(decoded.pose, 'pose', decoded.pose)] if robot else decoded.poses
            rows = [
                (xyz_from_message(p.position), xyzw_from_message(p.orientation)) for p in poses
            ]
        except Exception:  # on damaged bytes whatever the decoder raises
            self.malformed += 1
            return
        robots = [robot] if robot else self.settings.fleet.robots
        if len(rows) != len(robots):
            raise BagError(
                f'{message.topic} has {len(rows)} poses, there are {len(robots)} robots: it must '
                "hold one pose for each of the parameter 'robots', in that order"
            )
        if not self.settings.use_header_stamp:
            stamp_s = in_seconds(message.time_ns)
        for name, (position_m, orientation) in zip(robots, rows, strict=True):
            self.poses[name].append((stamp_s, position_m, orientation))

    def of_fleet(self, fleet: FleetConfig) -> FleetTruth:
        """Return the true paths of robots and sensors and the places of anchors."""
        tracks = {
            robot: TrueTrack(*map(np.array, zip(*rows, strict=True)))
            for robot, rows in self.poses.items()
        }
        for name, anchor in fleet.anchors.items():
            tracks.setdefault(name, TrueTrack.at_rest(anchor.coordinates_m))
        for name, mount in fleet.sensors.items():
            robot = tracks.get(fleet.robot_of(name))
            if robot is not None:
                tracks[name] = robot.carrying(mount.position_m)
        return FleetTruth(fleet, tracks)


def choose_truth(names: Sequence[str], settings: Settings, bag: Bag) -> Truth:
    """Read the tables that a command line names, or find its topics."""
    fleet, truth = settings.fleet, Truth(settings)
    files = [name for name in names if is_table(name)]
    if not files:
        truth.topics = _find_topics(names, fleet.robots, bag.types)
        return truth
    if len(files) < len(names):
        raise UsageError(f'--truth: name topics or files, not {" and ".join(names)}')
    for name in files:
        found = {name.replace(ROBOT, robot): robot for robot in fleet.robots}
        present = [path for path in found if Path(path).is_file()]
        if not present:
            raise UsageError(f"--truth: '{name}' is no file")
        for path in present:
            robots = [found[path]] if ROBOT in name else fleet.robots
            truth.notices += read_table(Path(path), robots, fleet.dimension, truth.poses)
    turns = [turn for rows in truth.poses.values() for _, _, turn in rows]
    if fleet.dimension == 3 and not any(np.isfinite(turn).all() for turn in turns):
        truth.notices.append(
            f'{" and ".join(files)}: no orientation in space, which takes the columns qx, qy, qz '
            'and qw (a robot with a yaw alone may be tilted): what depends on it is not compared'
        )
    return truth


def read_truth(names: Sequence[str], settings: Settings, bag: Bag) -> Truth:
    """Read the ground truth that a command line names, if it names any."""
    truth = choose_truth(names, settings, bag)
    if truth.topics:
        reading = Reading(bag, truth.topics)
        classes = {topic.name: topic.message_class for topic in reading.topics}
        for message in reading.messages():
            message_class = classes[message.topic]
            assert message_class is not None, 'only topics with a class are read'
            truth.take(message, message_class)
        truth.malformed += reading.unreadable.total()
        truth.damage += reading.damage
        truth.notices += reading.notices
    if truth.malformed:
        truth.notices.append(f'{truth.malformed} messages of the ground truth could not be read')
    return truth


def _find_topics(
    names: Iterable[str], robots: Sequence[str], recorded: Mapping[str, Sequence[str]]
) -> dict[str, str]:
    """
    Return the robots of the topics of a ground truth; empty for all robots.

    A name with `{robot}` stands for the pose of one robot each.
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
