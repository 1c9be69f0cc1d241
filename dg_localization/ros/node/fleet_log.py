# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the log says of the fleet: what it has become, for whoever has no diagnostics at hand."""

import re
from typing import Any

from dg_localization.ros.interface.diagnostics import shortened
from msg_adapters import Level, Status

BEGINNING = re.compile(r'[^:;,0-9]*')
"""What is wrong, of a message that goes on with names and numbers."""

LOOKS_BETWEEN = 5
"""A fleet that comes and goes has no more than one line in so many looks."""


class FleetLog:
    """
    Logs the status of the fleet when it becomes another one for more than a moment.

    Parameters
    ----------
    logger : rclpy.impl.rcutils_logger.RcutilsLogger

    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._seen: tuple[Level, str] | None = None
        self._said: tuple[Level, str] | None = None
        self._looks = LOOKS_BETWEEN

    def look(self, status: Status) -> None:
        """Log a status that is another one than was logged last, and that was seen last, too."""
        found = BEGINNING.match(status.message)
        state = status.level, found.group() if found else ''
        lasts, self._seen = state == self._seen, state
        self._looks += 1
        if not lasts or state == self._said or self._looks <= LOOKS_BETWEEN:
            return
        self._said, self._looks = state, 0
        text = shortened(f'fleet: {status.message}')
        # A logger takes one severity from each line.
        if status.level is Level.OK:
            self._logger.info(text)
        elif status.level is Level.WARN:
            self._logger.warning(text)
        else:
            self._logger.error(text)
