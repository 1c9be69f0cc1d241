# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Who may measure whom, and when: the checks of names and stamps that every measurement passes."""

from __future__ import annotations

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.error_models import finite_number, quoted
from dg_localization.fleet.vocabulary import LinkKey, Rejection, RejectionReason

MOST_BEFORE_S = 0.15
"""How old an answer may be for the sake of odometry, when it is asked for."""


def is_young(config: FleetConfig, stamp_s: float, now_s: float) -> bool:
    """Return whether a measurement of that time counts at `now_s`."""
    return -config.max_future_s <= now_s - stamp_s <= config.max_age_s


class Admission:
    """
    Checks names and stamps.

    Parameters
    ----------
    config : FleetConfig

    """

    def __init__(self, config: FleetConfig) -> None:
        self._config = config
        self._points = frozenset(config.points)
        # Those that were checked: every reading asks for its own.
        self._links: set[LinkKey] = set()

    def check_names(self, *names: str) -> Rejection | None:
        """Return a rejection when a name is not one of the fleet."""
        for name in names:
            if name not in self._points:
                text = f'{name!r} is not one of the robots and anchors {sorted(self._points)}'
                return Rejection(RejectionReason.UNKNOWN_ROBOT, text)
        return None

    def check_robot(self, name: str) -> Rejection | None:
        """Return a rejection when a name is not that of a robot or anchor."""
        if name in self._config.sensors:
            text = f'{name!r} is a sensor, and odometry is that of a robot'
            return Rejection(RejectionReason.UNKNOWN_ROBOT, text)
        return self.check_names(name)

    def check_elevated(self, name: str) -> Rejection | None:
        """Return a rejection when a name is not that of a point with a stated elevation."""
        if name in self._points and name not in self._config.elevations_m:
            text = f'{name!r} has no stated elevation, which readings of it could narrow'
            return Rejection(RejectionReason.INVALID_ELEVATION, text)
        return self.check_names(name)

    def check_link(self, key: LinkKey) -> Rejection | None:
        """Return a rejection when a link does not join points of two robots or anchors."""
        if key in self._links:
            return None
        if key.observer == key.target:
            text = f'{key.observer!r} is both observer and target'
            return Rejection(RejectionReason.SAME_ROBOT, text)
        robot = self._config.robot_of(key.observer)
        if robot == self._config.robot_of(key.target):
            text = (
                f'{key.observer!r} and {key.target!r} are both on robot {robot!r}: where they are '
                'on it is known from its mounts'
            )
            return Rejection(RejectionReason.SAME_ROBOT, text)
        rejection = self.check_names(key.observer, key.target)
        if not rejection:
            self._links.add(key)
        return rejection

    def check_stamp(self, stamp_s: float, now_s: float) -> Rejection | None:
        """Return a rejection when a stamp, or now, is not a time, or they are too far apart."""
        now = finite_number(now_s)
        if now is None:
            text = f'the time now, {quoted(now_s)} s, is not a finite number'
            return Rejection(RejectionReason.INVALID_STAMP, text)
        stamp = finite_number(stamp_s)
        if stamp is None:
            text = f'stamp {quoted(stamp_s)} s is not a finite number'
            return Rejection(RejectionReason.INVALID_STAMP, text)
        if stamp == 0.0:
            text = 'stamp 0 s: the source does not fill it in'
            return Rejection(RejectionReason.ZERO_STAMP, text)
        age_s = now - stamp
        if age_s > self._config.max_age_s:
            text = f'stamp {stamp} s is {age_s:.3f} s old, max_age is {self._config.max_age_s} s'
            return Rejection(RejectionReason.TOO_OLD, text)
        if -age_s > self._config.max_future_s:
            text = (
                f'stamp {stamp} s is {-age_s:.3f} s in the future, '
                f'max_future is {self._config.max_future_s} s'
            )
            return Rejection(RejectionReason.FUTURE, text)
        return None
