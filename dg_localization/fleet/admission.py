# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Checks of the names and stamps of every measurement."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Set
from typing import TypeAlias

from numpy.typing import ArrayLike

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.error_models import finite_number, quoted
from dg_localization.fleet.vocabulary import LinkKey, RefusedError, RejectionReason

MOST_BEFORE_S = 0.15
"""Greatest age of an answer that is moved back in time to be covered by odometry."""

PeerMeasurement: TypeAlias = tuple[str | tuple[str, str], float | ArrayLike]
"""
The target, and its distance in m or the ray to it; or two points, and the distance to the second
minus the distance to the first.
"""

_NO_ROWS = (str, bytes, Mapping)
_NO_PAIR = (str, bytes, Mapping, Set)
"""Types with members that could be mistaken for rows, or for a target and a value."""


def is_young(config: FleetConfig, stamp_s: float, now_s: float) -> bool:
    """Return whether a measurement with this stamp counts at `now_s`."""
    return -config.max_future_s <= now_s - stamp_s <= config.max_age_s


class Admission:
    """Checks names and stamps; every check raises `RefusedError`."""

    def __init__(self, config: FleetConfig) -> None:
        self._config = config
        self._points = frozenset(config.points)
        # The checked links: every reading looks its own up.
        self._links: set[LinkKey] = set()

    def check_names(self, *names: str) -> None:
        """Refuse a name that is not in the fleet."""
        for name in names:
            if name not in self._points:
                text = f'{name!r} is not one of the robots and anchors {sorted(self._points)}'
                raise RefusedError(RejectionReason.UNKNOWN_ROBOT, text)

    def check_robot(self, name: str) -> None:
        """Refuse a name that is no robot or anchor."""
        if name in self._config.sensors:
            text = f'{name!r} is a sensor, and odometry is that of a robot'
            raise RefusedError(RejectionReason.UNKNOWN_ROBOT, text)
        self.check_names(name)

    def check_elevated(self, name: str) -> None:
        """Refuse a name that is no point with a stated elevation."""
        if name in self._points and name not in self._config.elevations_m:
            text = f'{name!r} has no stated elevation that a reading could narrow'
            raise RefusedError(RejectionReason.INVALID_ELEVATION, text)
        self.check_names(name)

    def check_link(self, key: LinkKey) -> None:
        """Refuse a link that does not connect points of two robots or anchors."""
        if key in self._links:
            return
        if key.observer == key.target:
            text = f'{key.observer!r} is both observer and target'
            raise RefusedError(RejectionReason.SAME_ROBOT, text)
        robot = self._config.robot_of(key.observer)
        if robot == self._config.robot_of(key.target):
            text = (
                f'{key.observer!r} and {key.target!r} are both on robot {robot!r}: its mounts '
                'give their places'
            )
            raise RefusedError(RejectionReason.SAME_ROBOT, text)
        self.check_names(*key.points)
        of_one = (
            self._body(key.target) == self._body(key.reference) and key.target != key.reference
        )
        if key.reference and not of_one:
            text = (
                f'{key.target!r} and {key.reference!r} are not two points of one body: both '
                'must be anchors, or on one robot'
            )
            raise RefusedError(RejectionReason.SEVERAL_BODIES, text)
        self._links.add(key)

    def _body(self, point: str) -> str:
        """Return the robot that a point is on; empty for anchors."""
        return '' if point in self._config.anchors else self._config.robot_of(point)

    def checked_stamp(self, stamp_s: float, now_s: float) -> float:
        """Return a stamp; refuse it if it is no time, or too far from now."""
        now = finite_number(now_s)
        if now is None:
            text = f'the time now, {quoted(now_s)} s, is not a finite number'
            raise RefusedError(RejectionReason.INVALID_STAMP, text)
        stamp = finite_number(stamp_s)
        if stamp is None:
            text = f'stamp {quoted(stamp_s)} s is not a finite number'
            raise RefusedError(RejectionReason.INVALID_STAMP, text)
        if stamp == 0.0:
            text = 'stamp 0 s: the source does not fill it in'
            raise RefusedError(RejectionReason.ZERO_STAMP, text)
        age_s = now - stamp
        if age_s > self._config.max_age_s:
            text = f'stamp {stamp} s is {age_s:.3f} s old, max_age is {self._config.max_age_s} s'
            raise RefusedError(RejectionReason.TOO_OLD, text)
        if -age_s > self._config.max_future_s:
            text = (
                f'stamp {stamp} s is {-age_s:.3f} s in the future, '
                f'max_future is {self._config.max_future_s} s'
            )
            raise RefusedError(RejectionReason.FUTURE, text)
        return stamp


def rows_of_peers(readings: Iterable[PeerMeasurement]) -> Iterator[PeerMeasurement]:
    """Yield the rows of peers until one cannot be read, then refuse the rest."""
    why = 'are not allowed'
    try:
        if not isinstance(readings, _NO_ROWS):
            yield from readings
            return
    except Exception as error:  # whatever the iterable raises while it is read
        why = f'cannot be read ({quoted(error)})'
    text = (
        f'peers {quoted(readings)} {why}, they must be pairs of a target, and its distance in m '
        'or the ray to it'
    )
    raise RefusedError(RejectionReason.INVALID_PEER, text)


def read_peer(row: PeerMeasurement) -> tuple[str, str, float | ArrayLike]:
    """Return the target, the reference (empty without one), and the measured value of a row."""
    try:
        target, value = () if isinstance(row, _NO_PAIR) else row
        first, second = target if isinstance(target, tuple) else ('', target)
        return str(second), str(first), value
    except Exception:  # whatever the row raises while it is read
        text = (
            f'peer {quoted(row)} is not allowed, it must be a target, and its distance in m or '
            'the ray to it'
        )
        raise RefusedError(RejectionReason.INVALID_PEER, text) from None
