# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Ground truth from topics of a bag, or from tables of a spreadsheet or in TUM format."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
import math
from pathlib import Path
import re
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from dg_localization.calibration.truth import FleetTruth, TrueTrack
from dg_localization.fleet import FleetConfig
from dg_localization.ros.bags.bag import Bag, BagError, in_seconds
from dg_localization.ros.bags.reading import Reading
from dg_localization.ros.executables import UsageError
from dg_localization.ros.interface.parameters.settings import Settings
from msg_adapters.headers import stamp_from_message, xyz_from_message, xyzw_from_message

POSE_TYPES = (
    'geometry_msgs/msg/PoseStamped',
    'geometry_msgs/msg/PoseWithCovarianceStamped',
    'nav_msgs/msg/Odometry',
)
POSE_ARRAY = 'geometry_msgs/msg/PoseArray'
ROBOT = '{robot}'
TABLES = ('.csv', '.tsv', '.txt', '.tum')

Poses = dict[str, list[tuple[float, Any, Any]]]
"""Stamps in s, positions and quaternions by robot."""

COLUMNS = ('stamp', 'robot', 'x', 'y')
QUATERNION = ('qx', 'qy', 'qz', 'qw')
TUM = ('stamp', 'x', 'y', 'z', *QUATERNION)
"""The columns of a file without a header line."""

SYNONYMS = {'timestamp': 'stamp', 'time': 'stamp', 't': 'stamp', 'name': 'robot'}
AXIS = re.compile(r'(?:[pt]_?|p_[a-z]{2}_[a-z]_)?([xyz])|q(?:_?|_[a-z]{2}_)([wxyz])')
"""A coordinate as TUM (`tx`) and EuRoC (`p_RS_R_x`, `q_RS_w`) name it."""

NUMBER = re.compile(r'[-+]?\.?\d|nan\b')
"""The beginning of the first cell of a row of numbers."""

COLUMN_UNITS = ('', 'm', 's', 'ns', 'rad')
"""Units in brackets after the name of a column."""

UNITS = (('nanoseconds', 1e-9, 1e17), ('microseconds', 1e-6, 1e14), ('milliseconds', 1e-3, 1e11))
"""Units of stamps that are too large for seconds: name, factor, and least stamp."""


@dataclass
class Truth:
    """The true poses of the robots, with remarks on their source."""

    poses: Poses = field(default_factory=lambda: defaultdict(list))
    notices: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    topics: frozenset[str] = frozenset()

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


def read_truth(names: Sequence[str], settings: Settings, bag: Bag) -> Truth:
    """Read the ground truth that a command line names, if any."""
    truth, fleet = Truth(), settings.fleet
    files = [name for name in names if name.lower().endswith(TABLES)]
    if not files:
        _read_topics(_find_topics(names, fleet.robots, bag.types), settings, bag, truth)
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
            f'{" and ".join(files)}: no orientation in space, which takes qx, qy, qz and qw'
        )
    return truth


def _read_topics(topics: Mapping[str, str], settings: Settings, bag: Bag, truth: Truth) -> None:
    """Add the poses on topics of one robot each or, with an empty name, of all robots."""
    if not topics:
        return
    reading = Reading(bag, topics)
    for message in reading.messages():
        robot, message_class = topics[message.topic], bag.topics[message.topic].message_class
        robots = [robot] if robot else settings.fleet.robots
        try:
            decoded: Any = deserialize_message(message.data, message_class)
            stamp_s = stamp_from_message(decoded.header.stamp)
            # The pose of a message with or without covariance.
            poses = [getattr(decoded.pose, 'pose', decoded.pose)] if robot else decoded.poses
        except Exception:  # the decoder may raise anything on damaged bytes
            reading.unreadable[message.topic] += 1
            continue
        if len(poses) != len(robots):
            raise BagError(
                f'{message.topic} has {len(poses)} poses, not one of each of {len(robots)} robots'
            )
        if not settings.use_header_stamp:
            stamp_s = in_seconds(message.time_ns)
        for name, pose in zip(robots, poses, strict=True):
            place_m, turn = xyz_from_message(pose.position), xyzw_from_message(pose.orientation)
            truth.poses[name].append((stamp_s, place_m, turn))
    truth.damage += reading.damage
    truth.topics = frozenset(topics)
    truth.notices += reading.notices
    if malformed := reading.unreadable.total():
        truth.notices.append(f'{malformed} messages of the ground truth could not be read')


def _find_topics(
    names: Iterable[str], robots: Sequence[str], recorded: Mapping[str, Sequence[str]]
) -> dict[str, str]:
    """
    Return the robot of each topic of a ground truth; empty for all robots.

    A name with `{robot}` means one topic for each robot.
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
        found.update(present)
    return found


def read_table(path: Path, robots: Sequence[str], dimension: int, poses: Poses) -> list[str]:
    """
    Add a ground truth in a text file to `poses`, and return remarks on it.

    A table of one robot needs no names of robots; unknown names are skipped. In space z must be
    given, and a yaw alone is no orientation.

    Raises
    ------
    UsageError
        If the file is no such table; the message names the line.

    """
    columns, rows = read_columns(path)
    wanted = [name for name in COLUMNS if name != 'robot' or len(robots) > 1]
    wanted += ['z'] if dimension == 3 else []
    if not set(QUATERNION).isdisjoint(columns):
        wanted += QUATERNION
    missing = [name for name in wanted if name not in columns]
    if missing:
        raise UsageError(
            f'{path} has no column {", ".join(missing)}; its first line must name stamp, robot '
            "(not in 'truth_{robot}.tum'), x, y, in space z; where known yaw or qx, qy, qz and qw"
        )
    found: Poses = {}
    for number, row in rows:
        try:
            name = row['robot'] if 'robot' in columns else robots[0]
            found.setdefault(name, []).append(_pose_of(row, dimension))
        except ValueError as error:
            raise UsageError(f'{path}, line {number}: {error}') from None
    if found and found.keys().isdisjoint(robots):
        raise UsageError(
            f'{path} is the truth of {", ".join(found)}; the robots are {", ".join(robots)}'
        )
    first_s = min((stamp_s for kept in found.values() for stamp_s, _, _ in kept), default=0.0)
    unit, one = next(((name, one) for name, one, least in UNITS if first_s >= least), ('', 1.0))
    for name in filter(found.__contains__, robots):
        poses[name] += [(stamp * one, place, turn) for stamp, place, turn in found[name]]
    text = f'{path}: stamps from {first_s:.0f} on are taken as {unit}, not in seconds'
    return [text] if unit else []


def read_columns(path: Path) -> tuple[Sequence[str], list[tuple[int, dict[str, str]]]]:
    """Return the names of the columns of a table, and the numbered lines as dicts by these."""
    try:
        text = path.read_text(encoding='utf-8-sig')
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f'{path} is no table in UTF-8: {error}') from None
    lines = [(n, line.strip()) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    plain = next((line for _, line in lines if line[0] != '#'), '')
    mark = next((mark for mark in ';\t,' if mark in plain), None)
    names: list[str] = []
    rows: list[tuple[int, list[str]]] = []
    is_named = False
    for number, line in lines:
        cells = [cell.strip(' "') for cell in line.replace(' [', '[').lstrip('#').split(mark)]
        if mark == ';':
            # With another separator, commas may be decimal points.
            cells = [cell.replace(',', '.') for cell in cells]
        is_data = cells and NUMBER.match(cells[0])
        # A comment may name the columns, as in files in TUM format.
        if not rows and not is_named and not is_data:
            names = [_column(cell) for cell in cells]
            is_named = line[0] != '#'
        elif line[0] != '#':
            rows.append((number, cells))
    if rows and not is_named and len(rows[0][1]) == len(TUM) and 'x' not in names:
        names = [*TUM]
    twice = sorted(name for name in {*COLUMNS, *TUM, 'yaw'} if names.count(name) > 1)
    if twice:
        raise UsageError(f'{path} has two columns {twice[0]!r}: name the other one differently')
    return names, [
        (n, dict(zip_longest(names, cells[: len(names)], fillvalue=''))) for n, cells in rows
    ]


def _column(cell: str) -> str:
    """Return the name of a column from a cell of the header, which may have a unit."""
    name, _, unit = cell.lower().partition('[')
    if unit.rstrip(' ]') not in COLUMN_UNITS:
        return cell.lower()
    name = name.strip()
    axis = AXIS.fullmatch(name)
    if axis is None:
        return SYNONYMS.get(name, name)
    return axis[1] or f'q{axis[2]}'


def _pose_of(row: dict[str, str], dimension: int) -> tuple[float, Any, Any]:
    """Return stamp, position and quaternion of one row; raise ValueError if one is wrong."""
    stamp, x, y = (float(row[name]) for name in ('stamp', 'x', 'y'))
    z = float(row.get('z') or ('0' if dimension == 2 else ''))
    yaw_rad, *turn = (float(row.get(name) or math.nan) for name in ('yaw', *QUATERNION))
    if row.get('robot') == '':
        raise ValueError('it names no robot')
    if not math.isfinite(stamp):
        raise ValueError(f'stamp {stamp} is not a finite number')
    if any(map(math.isinf, (x, y, z, yaw_rad, *turn))):
        raise ValueError('no position and no orientation is infinite')
    if dimension == 2 and any(map(math.isnan, turn)):
        turn = [0.0, 0.0, math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)]
    return stamp, np.array([x, y, z]), np.array(turn)


def apart_text(truth_s: Sequence[float], others_s: Sequence[float], what: str) -> str:
    """Return a sentence if the stamps of a ground truth and other stamps do not overlap."""
    if not (len(truth_s) and len(others_s)):
        return ''
    first_s, last_s = min(truth_s), max(truth_s)
    begin_s, end_s = min(others_s), max(others_s)
    if first_s <= end_s and begin_s <= last_s:
        return ''
    hint = f'they are {max(first_s - end_s, begin_s - last_s):.1f} s apart.'
    if last_s - first_s < begin_s and first_s < 1e6 < begin_s:
        hint = f'those of the ground truth look counted from zero: add {begin_s:.3f}.'
    return (
        f'The ground truth is of {first_s:.3f} to {last_s:.3f} s, {what} are of {begin_s:.3f} to '
        f'{end_s:.3f} s. Stamps must be in seconds, on the same clock; {hint}'
    )
