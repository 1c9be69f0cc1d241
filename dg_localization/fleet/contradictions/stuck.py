# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Stuck sensors: readings or odometry that stay equal to the last bit although robots move.

Equal readings of robots at rest prove nothing, since many sensors round their readings.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import NamedTuple

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.rotations import rotation_angle_rad
from dg_localization.fleet.vocabulary import DistanceReading, LinkKey, LinkKind, OdometrySample

LEAST_WAY_M = 0.5
LEAST_TURN_RAD = 0.5
"""After a way or a turn of this size a working sensor would read another value."""

UNKNOWN_MOTION_FACTOR = 10
"""With this multiple of the readings, no odometry is needed to call a sensor stuck."""

SHOWN = 3
"""Ranges in a row needed to show motion: one or two may be wrong."""

UNKNOWN_MOTION = 'and no odometry says that the robots stand still'

Poses = Mapping[str, OdometrySample]
"""The newest odometry by robot."""


class _Repetition(NamedTuple):
    """Equal readings in a row: the value, its first stamp, and the poses of the robots then."""

    value: tuple[float, ...]
    since_s: float
    newest_s: float
    times: int
    poses: Poses
    motion: str = ''


class StuckWatch:
    """
    Watches for repeated equal readings.

    Parameters
    ----------
    config : FleetConfig

    """

    def __init__(self, config: FleetConfig) -> None:
        self.config = config
        self._repetitions: dict[LinkKey, _Repetition] = {}
        self._movable: dict[LinkKey, tuple[str, ...]] = {}

    def movable(self, key: LinkKey) -> tuple[str, ...]:
        """Return the robots at the ends of a link that can move."""
        # This is called for every reading.
        if key not in self._movable:
            robots = dict.fromkeys(self.config.robot_of(point) for point in key.ends)
            self._movable[key] = tuple(r for r in robots if self.config.speed_m_s(r) > 0.0)
        return self._movable[key]

    def add(self, key: LinkKey, value: tuple[float, ...], stamp_s: float, newest: Poses) -> None:
        """Record a reading."""
        before = self._repetitions.get(key)
        if before is not None and before.newest_s == stamp_s:
            return
        equal = before is not None and before.value == value and before.newest_s < stamp_s
        if before is None or not equal or not all(map(math.isfinite, value)):
            self._repetitions[key] = _Repetition(value, stamp_s, stamp_s, 1, newest)
            return
        motion = before.motion
        if motion in ('', UNKNOWN_MOTION):
            motion = self._motion(key, before.poses, newest)
        # The reference pose of a robot is its first one, or the first after a restart.
        kept = {
            robot: pose
            for robot, pose in before.poses.items()
            if _is_same_frame(pose, newest.get(robot, pose))
        }
        self._repetitions[key] = _Repetition(
            value, before.since_s, stamp_s, before.times + 1, {**newest, **kept}, motion
        )

    def sentence(self, key: LinkKey) -> str:
        """Return a sentence that the readings of a link are stuck; empty if they are not."""
        least = self.config.stuck_readings
        found = self._repetitions.get(key)
        if found is None or not 0 < least <= found.times or not found.motion:
            return ''
        if found.motion == UNKNOWN_MOTION and found.times < UNKNOWN_MOTION_FACTOR * least:
            return ''
        numbers = ' '.join(repr(number) for number in found.value)
        value = f'the ray ({numbers})' if key.kind is LinkKind.BEARING else f'{numbers} m'
        return (
            f'stuck: {found.times} readings in a row are {value}, since {found.since_s:.3f} s, '
            f'{found.motion}'
        )

    def _motion(self, key: LinkKey, before: Poses, now: Poses) -> str:
        """Return which robot has moved in the meantime; empty if none is known to have moved."""
        movable = self.movable(key)
        for robot in movable:
            known = robot in before and robot in now
            if known and _is_same_frame(before[robot], now[robot]):
                way_m = float(np.linalg.norm(now[robot].position_m - before[robot].position_m))
                if way_m >= LEAST_WAY_M:
                    return f'while {robot} moved by {way_m:.1f} m'
                if key.kind is LinkKind.BEARING and robot == self.config.robot_of(key.observer):
                    turn_rad = rotation_angle_rad(before[robot].rotation.T @ now[robot].rotation)
                    if turn_rad >= LEAST_TURN_RAD:
                        return f'while {robot} turned by {turn_rad:.1f} rad'
        if movable and not any(robot in now for robot in movable):
            return UNKNOWN_MOTION
        return ''


def _is_same_frame(before: OdometrySample, now: OdometrySample) -> bool:
    """Return whether odometry did not restart between two readings."""
    return (before.frame, before.restarted_s) == (now.frame, now.restarted_s)


class _Still(NamedTuple):
    """First ranges of a link while its odometry is unchanged, and how many later ones differ."""

    poses: Poses
    first: tuple[DistanceReading, ...]
    shown: int = 0


class FrozenWatch:
    """
    Watches for odometry whose pose never changes while ranges show motion.

    Ranges show motion if `SHOWN` in a row, each with newer odometry, agree with none of the first
    ones, and all robots at both ends have odometry or are parked.
    """

    def __init__(self) -> None:
        self._still: dict[LinkKey, _Still] = {}
        self._frozen: dict[str, str] = {}

    def add(self, reading: DistanceReading, newest: Poses) -> None:
        """Record a range; `newest` are the poses of the robots at its ends that can move."""
        before = self._still.get(reading.key)
        for robot, pose in newest.items():
            if before is None or not _is_same_pose(before.poses[robot], pose):
                self._still[reading.key] = _Still(newest, (reading,))
                self._frozen.pop(robot, None)
                before = None
        if before is None or all(before.poses[r].stamp_s == p.stamp_s for r, p in newest.items()):
            return
        first, shown = before.first, 0
        if len(first) < SHOWN:
            first = (*first, reading)
        elif all(reading.lower_m > f.upper_m or reading.upper_m < f.lower_m for f in first):
            shown = before.shown + 1
        self._still[reading.key] = _Still(newest, first, shown)
        for robot in newest if shown >= SHOWN else ():
            self._frozen[robot] = (
                f'the pose has not changed since {first[0].stamp_s:.3f} s, while {reading.key} '
                f'went from {first[0].likeliest_m:.2f} to {reading.likeliest_m:.2f} m'
            )

    def sentence(self, robot: str) -> str:
        """Return a sentence that the odometry of a robot seems frozen; empty if it does not."""
        return self._frozen.get(robot, '')


def _is_same_pose(before: OdometrySample, now: OdometrySample) -> bool:
    """Return whether two poses are equal to the last bit."""
    return before is now or (
        np.array_equal(before.position_m, now.position_m)
        and np.array_equal(before.rotation, now.rotation)
        and _is_same_frame(before, now)
    )
