# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The time of a node, which may jump back or stand still, and the rate that it keeps."""

from collections import deque
from collections.abc import Callable, Iterator
import math
from statistics import median
import time

MOST_STEPS = 9
"""How many steps of the time are remembered."""

LEAST_SET_BACK_S = 0.001
"""A clock may be set back by less unnoticed: clocks of a machine do not run exactly alike."""


SILENT_CLOCK_S = 3.0
"""A clock that stands still for longer is worth a warning."""

LONGEST_CLOCK_STEP_S = 0.3
"""Stamps are ahead of a simulated time by up to its step, which `max_future` is to hold."""


class NodeTime:
    """
    Reads a clock, and notices what happens to its time.

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
        self._steps_s: deque[float] = deque(maxlen=MOST_STEPS)

    def now(self) -> tuple[float, float]:
        """Return the time in s, and by how many seconds it has jumped back since the last call."""
        passed_s = self._steady_s() - self._read_at_s
        now_s = self._read_s()
        self._read_at_s = self._steady_s()
        back_s = max(0.0, self._last_s - now_s)
        missing_s = self._last_s + passed_s - now_s
        if back_s == 0.0 and missing_s > LEAST_SET_BACK_S and not self._is_simulated:
            # So much passed at least: it was set back by less than since the last call.
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
        Return when that arrived which has waited for some real time before the last call of `now`.

        None where that was before the time jumped back: it must not look new. How much of a
        simulated time has passed is not known: it is that of the last call.
        """
        if self._steady_s() - waited_s < self._begun_at_s:
            return None
        return self._last_s if self._is_simulated else self._last_s - waited_s

    def step_s(self) -> float:
        """Return the usual step of the time between calls of `now` that found it moved."""
        return median(self._steps_s) if len(self._steps_s) == MOST_STEPS else 0.0

    def warnings(self, n_publishers: int, is_active: bool) -> Iterator[str]:
        """Yield what is wrong with the clock, given the number of publishers of /clock."""
        still_s, step_s = self._steady_s() - self._moved_at_s, self.step_s()
        if is_active and still_s > SILENT_CLOCK_S:
            yield f'time has stood still for {still_s:.1f} s: /clock is silent or paused'
        if n_publishers > 1:
            yield f'{n_publishers} publishers of /clock: time jumps between them'
        if self._is_simulated and step_s > LONGEST_CLOCK_STEP_S:
            yield f'time moves in steps of {step_s:.1f} s: /clock comes too rarely'


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

    Attributes
    ----------
    tighten_s : float
        From when on the next estimate is to tighten nothing any more, in s.

    """

    def __init__(self, wanted_hz: float, limit_s: float = math.inf) -> None:
        self._wanted_s = max(LEAST_TIGHTEN_S, SHARE_OF_PERIOD / wanted_hz)
        # More would have no effect, and take many late estimates to come down from.
        self._most_s = min(self._wanted_s, limit_s)
        self.tighten_s = self._most_s

    def note(self, took_s: float) -> None:
        """Note how long an estimate took, in s."""
        left_s = self.tighten_s + GAIN * (self._wanted_s - took_s)
        self.tighten_s = min(self._most_s, max(LEAST_TIGHTEN_S, left_s))


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
