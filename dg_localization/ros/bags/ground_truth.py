# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Where the robots truly were: in topics of a bag, or in a table."""

import argparse
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from dg_localization.calibration.truth import TrueTrack
from dg_localization.fleet import FleetConfig
from dg_localization.ros.bags.contents import Contents, damage_of
from dg_localization.ros.bags.offline import in_seconds
from dg_localization.ros.bags.reader import (
    NS_PER_S,
    Bag,
    BagError,
    BagMessage,
    find_message_class,
)
from dg_localization.ros.executables import UsageError
from dg_localization.ros.interface.parameters.settings import Settings
from msg_adapters.geometry import xyz_from_message, xyzw_from_message
from msg_adapters.headers import stamp_from_message

Poses = dict[str, list[tuple[float, Any, Any]]]
"""By robot its stamps in s, positions and quaternions."""

POSE_TYPES = (
    'geometry_msgs/msg/PoseStamped',
    'geometry_msgs/msg/PoseWithCovarianceStamped',
    'nav_msgs/msg/Odometry',
)
POSE_ARRAY = 'geometry_msgs/msg/PoseArray'
ROBOT = '{robot}'
COLUMNS = ('stamp', 'robot', 'x', 'y')
QUATERNION = ('qx', 'qy', 'qz', 'qw')


def add_truth_argument(parser: argparse.ArgumentParser, purpose: str) -> None:
    """Add `--truth` to a command line; `purpose` is what the truth is for."""
    parser.add_argument(
        '--truth',
        nargs='+',
        default=[],
        metavar='TRUTH',
        help=f"where the robots truly were, {purpose}: '/mocap/{{robot}}/pose' with a pose for "
        'each robot, a PoseArray of all in the order of the robots, or a .csv with the columns '
        'stamp, robot, x, y, and where they are known z, and yaw or, in space, qx, qy, qz and qw',
    )


def is_table(name: str) -> bool:
    """Return whether a ground truth is that of a file."""
    return name.endswith('.csv')


class TruthReader:
    """
    Gathers the poses of a ground truth.

    Parameters
    ----------
    settings : Settings
    topics : mapping of str to str
        By topic, the robot; empty for the poses of all robots.
    poses : dict of str to list of (float, ndarray, ndarray), optional
        What is known without the topics.

    Attributes
    ----------
    malformed : int
        How many messages could not be read.
    notices : list of str
        What of the truth is passed over or not known, a sentence each.
    damage : list of str
        What is wrong with the bag, a sentence each; empty where others read its topics.

    """

    def __init__(
        self, settings: Settings, topics: Mapping[str, str], poses: Poses | None = None
    ) -> None:
        self.topics = topics
        self.poses: Poses = defaultdict(list, poses or {})
        self.malformed = 0
        self.notices: list[str] = []
        self.damage: list[str] = []
        self._settings = settings

    def take(self, message: BagMessage, message_class: type) -> None:
        """
        Take a message on one of the topics.

        Raises
        ------
        BagError
            If a message has not as many poses as there are robots.

        """
        robot = self.topics[message.topic]
        try:
            decoded = deserialize_message(message.data, message_class)
            stamp_s = stamp_from_message(decoded.header.stamp)
            poses = [_pose_of(decoded)] if robot else decoded.poses
            rows = [
                (xyz_from_message(p.position), xyzw_from_message(p.orientation)) for p in poses
            ]
        except Exception:  # on damaged bytes whatever the decoder raises
            self.malformed += 1
            return
        robots = [robot] if robot else self._settings.fleet.robots
        if len(rows) != len(robots):
            raise BagError(
                f'{message.topic} has {len(rows)} poses, there are {len(robots)} robots: it must '
                "hold one pose for each of the parameter 'robots', in that order"
            )
        if not self._settings.use_header_stamp:
            stamp_s = in_seconds(message.time_ns)
        for name, (position_m, orientation) in zip(robots, rows, strict=True):
            self.poses[name].append((stamp_s, position_m, orientation))


def truth_reader(
    names: Sequence[str], settings: Settings, recorded: Mapping[str, Sequence[str]]
) -> TruthReader:
    """
    Return what reads the ground truth that a command line names.

    Parameters
    ----------
    names : sequence of str
        Topics, or one `.csv` file.
    settings : Settings
    recorded : mapping of str to sequence of str
        By topic of the bag the types of its messages.

    Raises
    ------
    UsageError
        If the file is no table of poses, or is named beside others.
    BagError
        If a topic is not there or of a type that has no poses.

    """
    fleet = settings.fleet
    files = [name for name in names if is_table(name)]
    if not files:
        return TruthReader(settings, find_truth(names, fleet.robots, recorded))
    if len(names) > 1:
        raise UsageError(f'--truth: name topics or one .csv file, not {" and ".join(names)}')
    path = Path(files[0])
    if not path.is_file():
        raise UsageError(f"--truth: '{path}' is no file")
    poses = read_truth_file(path, fleet.robots, fleet.dimension)
    reader = TruthReader(settings, {}, poses)
    if fleet.dimension == 3 and not _any_orientation(poses):
        reader.notices.append(
            f'{path} tells no orientation in space, which takes the columns qx, qy, qz and qw (a '
            'robot with a yaw alone may be tilted): what depends on it is not compared'
        )
    return reader


def _any_orientation(poses: Poses) -> bool:
    """Return whether any orientation is known."""
    return any(np.isfinite(turn).all() for rows in poses.values() for _, _, turn in rows)


def read_truth(bag: Path, reader: TruthReader, contents: Contents) -> None:
    """
    Read the topics of a ground truth, up to the first damage of the bag.

    Parameters
    ----------
    bag : Path
    reader : TruthReader
        Gets the poses, and what there is to say of them.
    contents : Contents
        What the files of the bag hold.

    Raises
    ------
    BagError
        If nothing on its topics can be read, or a message has not as many poses as there are
        robots.

    """
    if not reader.topics:
        return
    with closing(Bag(bag, list(reader.topics), contents.span_ns())) as recorded:
        classes = {topic.name: topic.message_class for topic in recorded.topics}
        ending: list[str] = []
        for message in _before_damage(recorded, ending):
            reader.take(message, classes[message.topic])
        span_ns = None if ending else (recorded.start_ns, recorded.end_ns)
        reader.damage += [*damage_of(recorded, contents, span_ns), *ending]
        reader.malformed += recorded.unreadable.total()
        reader.notices += recorded.notices
    if reader.malformed:
        reader.notices.append(f'{reader.malformed} messages of the ground truth could not be read')


def _before_damage(bag: Bag, ending: list[str]) -> Iterator[BagMessage]:
    """Yield messages up to the first damage, and add a sentence on it to `ending`."""
    last_ns = bag.start_ns
    try:
        for message in bag.messages():
            last_ns = message.time_ns
            yield message
    except BagError as error:
        at_s = (last_ns - bag.start_ns) / NS_PER_S
        ending.append(f'the ground truth ends at {at_s:.1f} s: {error}')


def tracks_of(poses: Poses, fleet: FleetConfig) -> dict[str, TrueTrack]:
    """Return the true paths of robots and sensors and the places of anchors, by name."""
    tracks = {
        robot: TrueTrack(*map(np.array, zip(*rows, strict=True))) for robot, rows in poses.items()
    }
    for name, anchor in fleet.anchors.items():
        tracks.setdefault(name, TrueTrack.at_rest(anchor.coordinates_m))
    for name, mount in fleet.sensors.items():
        robot = tracks.get(fleet.robot_of(name))
        if robot is not None:
            tracks[name] = robot.carrying(mount.position_m)
    return tracks


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
        A .csv with the columns stamp (s), robot, x, y (m), and where they are known z (m), and yaw
        (rad) or the quaternion qx, qy, qz, qw. In space z has to be known, and a yaw alone is no
        orientation. NaN stands for what is not known.
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
    columns = rows.fieldnames or ()
    wanted: tuple[str, ...] = COLUMNS if dimension == 2 else (*COLUMNS, 'z')
    if not set(QUATERNION).isdisjoint(columns):
        wanted += QUATERNION
    missing = [name for name in wanted if name not in columns]
    if missing:
        raise UsageError(
            f'{path} has no column {", ".join(missing)}; its first line must name stamp, '
            'robot, x, y, in space z, and where they are known z, and yaw or qx, qy, qz and qw'
        )
    others: dict[str, None] = {}
    flat = '0' if dimension == 2 else ''
    for row in rows:
        try:
            stamp_s, x, y = (float(row[name]) for name in ('stamp', 'x', 'y'))
            z = float(row.get('z') or flat)
            yaw_rad, *turn = (float(row.get(name) or math.nan) for name in ('yaw', *QUATERNION))
            if not row['robot']:
                raise ValueError('it names no robot')
            if not math.isfinite(stamp_s):
                raise ValueError(f'stamp {stamp_s} is not a finite number')
            if any(map(math.isinf, (x, y, z, yaw_rad, *turn))):
                raise ValueError('no position and no orientation is infinite')
        except (TypeError, ValueError) as error:
            raise UsageError(f'{path}, line {rows.line_num}: {error}') from None
        if row['robot'] in robots:
            if dimension == 2 and any(map(math.isnan, turn)):
                turn = [0.0, 0.0, math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)]
            truth[row['robot']].append((stamp_s, np.array([x, y, z]), np.array(turn)))
        else:
            others.setdefault(row['robot'])
    if others and not truth:
        raise UsageError(
            f'{path} is the truth of {", ".join(others)}; the robots are {", ".join(robots)}'
        )
    return truth
