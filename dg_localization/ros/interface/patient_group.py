# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Callbacks among which events of the middleware are rare, so that looking for them can be."""

import math
from time import monotonic
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import EventHandler

PERIOD_S = 1.0
# For so long after a period the events are looked for: an executor takes less to begin its wait.
LOOK_S = 0.01


class PatientGroup(CallbackGroup):
    """
    Another group, but that events are looked for once a second only.

    rclpy makes two events of each publisher and subscription, such as that an endpoint with other
    quality of service has been found, and takes a time that grows with the square of their number
    to look for what is ready.

    Parameters
    ----------
    group : CallbackGroup
        Decides on everything else.

    """

    def __init__(self, group: CallbackGroup) -> None:
        super().__init__()
        self._group = group
        self._look_began_s = -math.inf

    def can_execute(self, entity: Any) -> bool:
        """Return whether the other group allows it and, if it is an event, it is time for it."""
        if isinstance(entity, EventHandler) and not self._is_time():
            return False
        return bool(self._group.can_execute(entity))

    def _is_time(self) -> bool:
        """Return whether events are looked for now."""
        now_s = monotonic()
        if now_s - self._look_began_s >= PERIOD_S:
            self._look_began_s = now_s
        return now_s - self._look_began_s <= LOOK_S

    def add_entity(self, entity: Any) -> None:
        """Add to the other group."""
        self._group.add_entity(entity)

    def has_entity(self, entity: Any) -> bool:
        """Return whether the other group has it."""
        return bool(self._group.has_entity(entity))

    def beginning_execution(self, entity: Any) -> bool:
        """Ask the other group."""
        return bool(self._group.beginning_execution(entity))

    def ending_execution(self, entity: Any) -> None:
        """Notify the other group."""
        self._group.ending_execution(entity)
