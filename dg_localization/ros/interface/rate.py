# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""How often estimates are started lately, and what they may spend to be in time."""

from collections import deque
import math

LEAST_WINDOW_S = 5.0
LEAST_PERIODS = 10
"""How far to look back, in seconds and in wanted periods: whichever is longer."""

LEAST_SPAN_S = 2.0
"""No rate is known before this time: one late estimate is no rate."""

SHARE_OF_PERIOD = 0.8
"""An estimate is to take no more of a period: its measurements and messages take time, too."""

GAIN = 0.5
"""What is spent on bounds follows the time that is left by this fraction, estimate by estimate."""

LEAST_TIGHTEN_S = 0.001
"""The least time that the solver takes for a limit."""


class Pace:
    """
    How long estimates may tighten their bounds without being late for the wanted rate.

    Parameters
    ----------
    wanted_hz : float
        The rate that is wanted.
    limit_s : float, optional
        From when on the solver tightens nothing in any case, in s.

    """

    def __init__(self, wanted_hz: float, limit_s: float = math.inf) -> None:
        self._wanted_s = max(LEAST_TIGHTEN_S, SHARE_OF_PERIOD / wanted_hz)
        # More would have no effect, and take many late estimates to come down from.
        self._most_s = min(self._wanted_s, limit_s)
        self._tighten_s = self._most_s

    @property
    def tighten_s(self) -> float:
        """From when on the next estimate is to tighten nothing any more, in s."""
        return self._tighten_s

    def note(self, took_s: float) -> None:
        """Note how long an estimate took, in s."""
        left_s = self._tighten_s + GAIN * (self._wanted_s - took_s)
        self._tighten_s = min(self._most_s, max(LEAST_TIGHTEN_S, left_s))


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
