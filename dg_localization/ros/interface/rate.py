# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""How often estimates are started lately."""

from collections import deque

LEAST_WINDOW_S = 5.0
LEAST_PERIODS = 10
"""How far to look back, in seconds and in wanted periods: whichever is longer."""

LEAST_SPAN_S = 2.0
"""No rate is known before this time: one late estimate is no rate."""


class RateMeter:
    """
    Counts events, and reports their rate by the clock that the events are counted by.

    Parameters
    ----------
    wanted_hz : float
        The rate that is wanted; an event that is later than its period counts as missing.

    """

    def __init__(self, wanted_hz: float) -> None:
        self._period_s = 1.0 / wanted_hz
        self._window_s = max(LEAST_WINDOW_S, LEAST_PERIODS * self._period_s)
        self._times_s: deque[float] = deque()

    def count(self, now_s: float) -> None:
        """Count an event."""
        self._times_s.append(now_s)
        while len(self._times_s) > 2 and now_s - self._times_s[1] > self._window_s:
            self._times_s.popleft()

    def clear(self) -> None:
        """Forget all events."""
        self._times_s.clear()

    def rate_hz(self, now_s: float) -> float | None:
        """Return the rate in Hz, None while too little time has passed to know one."""
        if not self._times_s or now_s - self._times_s[0] < LEAST_SPAN_S:
            return None
        first_s, last_s = self._times_s[0], self._times_s[-1]
        if now_s - last_s > self._period_s:
            # The next one is late: at best it comes now.
            return len(self._times_s) / (now_s - first_s)
        return (len(self._times_s) - 1) / (last_s - first_s)
