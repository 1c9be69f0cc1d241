# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The time that an estimate may spend on the window."""

from __future__ import annotations

from collections.abc import Callable
import time

from dg_localization.solver.options import Cancel

MOST_LATE = 3.0
"""Where the processors are busy with other work, so many times the span may pass on the clock."""


class Allowance:
    """
    A span of processor time of this thread from now on, to be divided among tasks.

    On the clock other threads would use it up: what is left of a busy machine is needed.

    Parameters
    ----------
    seconds : float
        May be infinite.
    cancel : Cancel, optional
        Ends the time when set.

    """

    def __init__(self, seconds: float, cancel: Cancel | None) -> None:
        self._cancel = cancel
        self._left_s = seconds
        self._left_on_clock_s = MOST_LATE * seconds
        self.resume()

    def pause(self) -> None:
        """Let no time pass until `resume`."""
        self._left_s = max(0.0, self._end_s - time.thread_time())
        self._left_on_clock_s = max(0.0, self._end_on_clock_s - time.monotonic())

    def resume(self) -> None:
        """Go on where it was paused."""
        self._end_s = time.thread_time() + self._left_s
        self._end_on_clock_s = time.monotonic() + self._left_on_clock_s

    def part(self, tasks: int) -> Callable[[], bool]:
        """Return what tells the first of some tasks that its equal part of the rest is used up."""
        now_s = time.thread_time()
        end_s = now_s + max(0.0, self._end_s - now_s) / tasks

        def stopped() -> bool:
            cancelled = self._cancel is not None and self._cancel.is_set()
            late = time.monotonic() > self._end_on_clock_s
            return cancelled or late or time.thread_time() > end_s

        return stopped
