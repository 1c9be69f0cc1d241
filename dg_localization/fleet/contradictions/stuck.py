# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Stuck sensors: readings that repeat themselves to the last bit although robots move.

Equal readings of robots that stand still prove nothing, since many sensors round theirs.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import NamedTuple

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.vocabulary import LinkKey, LinkKind, OdometryReading

LEAST_WAY_M = 0.5
LEAST_TURN_RAD = 0.5
"""A robot that has gone or turned so far since a reading would read another value."""

TIMES_MORE = 10
"""Of so many times the readings nothing need be known of the motion."""

UNKNOWN_MOTION = 'and no odometry says that the robots stand still'

Poses = Mapping[str, OdometryReading]
"""The newest odometry by robot."""


class _Repetition(NamedTuple):
    """Equal readings in a row: the value, its first stamp, and where the robots were then."""

    value: tuple[float, ...]
    since_s: float
    newest_s: float
    times: int
    poses: Poses
    motion: str = ''


class StuckWatch:
    """
    Watches for readings that repeat themselves.

    Parameters
    ----------
    config : FleetConfig

    """

    def __init__(self, config: FleetConfig) -> None:
        self._config = config
        self._repetitions: dict[LinkKey, _Repetition] = {}
        self._movable: dict[LinkKey, tuple[str, ...]] = {}

    def movable(self, key: LinkKey) -> tuple[str, ...]:
        """Return the robots at the ends of a link that can move."""
        # Every reading asks for it.
        if key not in self._movable:
            robots = dict.fromkeys(self._config.robot_of(point) for point in key.ends)
            self._movable[key] = tuple(r for r in robots if self._config.speed_m_s(r) > 0.0)
        return self._movable[key]

    def add(self, key: LinkKey, value: tuple[float, ...], stamp_s: float, newest: Poses) -> None:
        """
        Note a reading.

        Parameters
        ----------
        key : LinkKey
        value : tuple of float
            As it was read.
        stamp_s : float
        newest : mapping of str to OdometryReading
            The newest odometry of those of the `movable` robots that have some.

        """
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
        # Odometry that came later, or started anew, counts from then on.
        kept = {
            robot: pose
            for robot, pose in before.poses.items()
            if _is_same_frame(pose, newest.get(robot, pose))
        }
        self._repetitions[key] = _Repetition(
            value, before.since_s, stamp_s, before.times + 1, {**newest, **kept}, motion
        )

    def sentence(self, key: LinkKey) -> str:
        """Return that the readings of a link are stuck, with value and time; empty if not."""
        least = self._config.stuck_readings
        found = self._repetitions.get(key)
        if found is None or not 0 < least <= found.times or not found.motion:
            return ''
        if found.motion == UNKNOWN_MOTION and found.times < TIMES_MORE * least:
            return ''
        numbers = ' '.join(repr(number) for number in found.value)
        value = f'{numbers} m' if key.kind is LinkKind.RANGE else f'the ray ({numbers})'
        return (
            f'stuck: {found.times} readings in a row are {value}, since {found.since_s:.3f} s, '
            f'{found.motion}'
        )

    def _motion(self, key: LinkKey, before: Poses, now: Poses) -> str:
        """Return which robot has moved in the meantime; empty where none is known to have."""
        movable = self.movable(key)
        for robot in movable:
            known = robot in before and robot in now
            if known and _is_same_frame(before[robot], now[robot]):
                way_m = float(np.linalg.norm(now[robot].position_m - before[robot].position_m))
                if way_m >= LEAST_WAY_M:
                    return f'while {robot} moved by {way_m:.1f} m'
                if key.kind is LinkKind.BEARING and robot == self._config.robot_of(key.observer):
                    turn_rad = _angle_rad(before[robot].rotation.T @ now[robot].rotation)
                    if turn_rad >= LEAST_TURN_RAD:
                        return f'while {robot} turned by {turn_rad:.1f} rad'
        if movable and not any(robot in now for robot in movable):
            return UNKNOWN_MOTION
        return ''


def _is_same_frame(before: OdometryReading, now: OdometryReading) -> bool:
    """Return whether odometry did not start anew between two readings."""
    return (before.frame, before.restarted_s) == (now.frame, now.restarted_s)


def _angle_rad(rotation: np.ndarray) -> float:
    """Return the angle of a rotation matrix."""
    cosine = 0.5 * (float(np.trace(rotation)) - 1.0)
    return math.acos(min(1.0, max(-1.0, cosine)))
