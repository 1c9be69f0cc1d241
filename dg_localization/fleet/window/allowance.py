# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The time that an estimate may spend on the window."""

from __future__ import annotations

from collections.abc import Callable
import time

from dg_localization.solver.options import Cancel


class Allowance:
    """
    A span of time from now on, to be divided among tasks.

    Parameters
    ----------
    seconds : float
        May be infinite.
    cancel : Cancel, optional
        Ends the time when set.

    """

    def __init__(self, seconds: float, cancel: Cancel | None) -> None:
        self._left_s = seconds
        self._end_s = time.monotonic() + seconds
        self._cancel = cancel

    def pause(self) -> None:
        """Let no time pass until `resume`."""
        self._left_s = max(0.0, self._end_s - time.monotonic())

    def resume(self) -> None:
        """Go on where it was paused."""
        self._end_s = time.monotonic() + self._left_s

    def part(self, tasks: int) -> Callable[[], bool]:
        """Return what tells the first of some tasks that its equal part of the rest is used up."""
        now_s = time.monotonic()
        end_s = now_s + max(0.0, self._end_s - now_s) / tasks

        def stopped() -> bool:
            cancelled = self._cancel is not None and self._cancel.is_set()
            return cancelled or time.monotonic() > end_s

        return stopped
