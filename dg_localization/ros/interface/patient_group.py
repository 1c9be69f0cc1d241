# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Callbacks among which events of the middleware are rare, so that looking for them can be."""

from collections import Counter
import math
from time import monotonic
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import EventHandler

PERIOD_S = 1.0
# An executor asks whether to wait for an event, and again when the event is ready.
MOST_ALLOWED = 2


class PatientGroup(CallbackGroup):
    """
    Another group, but that each event is looked for once or twice a second only.

    rclpy makes two events of each publisher and subscription, such as that an endpoint with other
    quality of service has been found, and takes a time that grows with the square of their number
    to look for what is ready.

    An event is allowed twice in a period, however late: an event that is ready when it is first
    looked for is run in that look. One that is not is looked for once more.

    Parameters
    ----------
    group : CallbackGroup
        Decides on everything else.

    """

    def __init__(self, group: CallbackGroup) -> None:
        super().__init__()
        self._group = group
        self._period_began_s = -math.inf
        # By the id of the event, which keeps no event alive. An event that takes over the id of
        # one that is gone waits for the next period at worst.
        self._allowed: Counter[int] = Counter()

    def can_execute(self, entity: Any) -> bool:
        """Return whether the other group allows it and, if it is an event, it is time for it."""
        if not isinstance(entity, EventHandler):
            return bool(self._group.can_execute(entity))
        self._begin_period_if_due()
        if self._allowed.get(id(entity), 0) >= MOST_ALLOWED:
            return False
        allowed = bool(self._group.can_execute(entity))
        self._allowed[id(entity)] += allowed
        return allowed

    def _begin_period_if_due(self) -> None:
        """Allow all events again once a period is over."""
        now_s = monotonic()
        if now_s - self._period_began_s >= PERIOD_S:
            self._period_began_s = now_s
            self._allowed.clear()

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
