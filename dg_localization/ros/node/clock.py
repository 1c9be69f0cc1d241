# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The time of a node, which may jump back or stand still, and its rate of estimates."""

from collections import deque
from collections.abc import Callable, Iterator
import math
from statistics import median
import time

from dg_localization.ros.interface.diagnostics import TOLERATED_RATE

PERIODS = round(1.0 / (1.0 - TOLERATED_RATE))
"""Number of periods over which a rate with one missing event is still tolerated."""

WINDOW_S = 5.0
"""Least time span of a rate, so that one late event does not lower it."""

LEAST_SET_BACK_S = 0.001
"""A clock that falls behind by less is not set back: the clocks of a machine differ slightly."""

SILENT_CLOCK_S = 3.0
"""A clock that stands still for longer gives a warning."""

LONGEST_CLOCK_STEP_S = 0.3
"""Stamps are ahead of a simulated time by up to its step, which `max_future` must cover."""


class NodeTime:
    """
    Reads a clock, and detects jumps back and standstill.

    Parameters
    ----------
    read_s : callable
        Returns the time of the clock in s.
    is_simulated : bool
        Whether the clock may run at another rate than real time.
    steady_s : callable
        Returns a time in s that never stands still.

    """

    def __init__(
        self,
        read_s: Callable[[], float],
        is_simulated: bool = False,
        steady_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._read_s = read_s
        self._is_simulated = is_simulated
        self._steady_s = steady_s
        self._last_s = read_s()
        self._moved_at_s = self._read_at_s = steady_s()
        self._begun_at_s = -math.inf
        self._steps_s: deque[float] = deque(maxlen=PERIODS)

    def now(self) -> tuple[float, float]:
        """Return the time in s, and the seconds by which it jumped back since the last call."""
        passed_s = self._steady_s() - self._read_at_s
        now_s = self._read_s()
        self._read_at_s = self._steady_s()
        back_s = max(0.0, self._last_s - now_s)
        missing_s = self._last_s + passed_s - now_s
        if back_s == 0.0 and missing_s > LEAST_SET_BACK_S and not self._is_simulated:
            # The clock was set back, by less than the time since the last call.
            back_s = missing_s
        if back_s > 0.0:
            self._begun_at_s = self._steady_s()
        if now_s > self._last_s > 0.0:
            self._steps_s.append(now_s - self._last_s)
        if now_s != self._last_s:
            self._moved_at_s = self._read_at_s
        self._last_s = now_s
        return now_s, back_s

    def arrived_s(self, waited_s: float) -> float | None:
        """
        Return when a message arrived that had waited for some real time at the last call of `now`.

        None if that was before the time jumped back: the message must not look new. How much of a
        simulated time has passed is not known, so the time is that of the last call.
        """
        if self._steady_s() - waited_s < self._begun_at_s:
            return None
        return self._last_s if self._is_simulated else self._last_s - waited_s

    def step_s(self) -> float:
        """Return the typical step of the time between calls of `now` that saw it change."""
        return median(self._steps_s) if len(self._steps_s) == PERIODS else 0.0

    def warnings(self, n_publishers: int, is_active: bool) -> Iterator[str]:
        """Yield warnings about the clock, given the number of publishers of /clock."""
        still_s, step_s = self._steady_s() - self._moved_at_s, self.step_s()
        if is_active and still_s > SILENT_CLOCK_S:
            yield f'time has stood still for {still_s:.1f} s: /clock is silent or paused'
        if n_publishers > 1:
            yield f'{n_publishers} publishers of /clock: time jumps between them'
        if self._is_simulated and step_s > LONGEST_CLOCK_STEP_S:
            yield f'time moves in steps of {step_s:.1f} s: /clock comes too rarely'


GAIN = 0.5
"""Fraction of the remaining time by which the time for bounds changes at each estimate."""


class Pace:
    """
    The time for which estimates may tighten their bounds without missing the wanted rate.

    Parameters
    ----------
    wanted_hz : float
        The rate that is wanted.
    limit_s : float, optional
        After this time the solver never tightens, in s.

    Attributes
    ----------
    tighten_s : float
        After this time the next estimate is not to tighten, in s.

    """

    def __init__(self, wanted_hz: float, limit_s: float = math.inf) -> None:
        # The rest of a period is for measurements and messages.
        self._wanted_s = TOLERATED_RATE / wanted_hz
        # A larger value would have no effect, and take many late estimates to reduce.
        self._most_s = min(self._wanted_s, limit_s)
        self.tighten_s = self._most_s

    def note(self, took_s: float) -> None:
        """Record the duration of an estimate in s."""
        left_s = self.tighten_s + GAIN * (self._wanted_s - took_s)
        self.tighten_s = min(self._most_s, max(0.0, left_s))


class RateMeter:
    """
    Counts events, and reports their rate by the clock of `now_s`.

    Parameters
    ----------
    wanted_hz : float
        The wanted rate; an event later than its period counts as missing.

    """

    def __init__(self, wanted_hz: float) -> None:
        self._period_s = 1.0 / wanted_hz
        n_steps = max(PERIODS, math.ceil(WINDOW_S * wanted_hz))
        self._times_s: deque[float] = deque(maxlen=1 + n_steps)

    def count(self, now_s: float) -> None:
        """Count an event."""
        self._times_s.append(now_s)

    def clear(self) -> None:
        """Forget all events."""
        self._times_s.clear()

    def rate_hz(self, now_s: float) -> float | None:
        """Return the rate in Hz; None while too few periods have passed."""
        times_s = self._times_s or (now_s,)
        first_s, last_s, n_steps = times_s[0], times_s[-1], len(times_s) - 1
        if n_steps < PERIODS and now_s - first_s < PERIODS * self._period_s:
            return None
        if now_s - last_s > self._period_s:
            # The next event is late: at best it comes now.
            n_steps, last_s = n_steps + 1, now_s
        return n_steps / (last_s - first_s) if last_s > first_s else None
