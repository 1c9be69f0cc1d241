# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The time of a node, which may be simulated: it may jump back, and it may stand still."""

from collections.abc import Callable, Sequence
import time

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter


class NodeTime:
    """
    Reads a clock, and notices what happens to its time.

    Parameters
    ----------
    read_s : callable
        Returns the time of the clock in s.
    steady_s : callable
        Returns a time in s that never stands still.

    """

    def __init__(
        self, read_s: Callable[[], float], steady_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._read_s = read_s
        self._steady_s = steady_s
        self._last_s = read_s()
        self._moved_at_s = steady_s()

    def now(self) -> tuple[float, float]:
        """Return the time in s, and by how many seconds it has jumped back since the last call."""
        now_s = self._read_s()
        back_s = max(0.0, self._last_s - now_s)
        if now_s != self._last_s:
            self._moved_at_s = self._steady_s()
        self._last_s = now_s
        return now_s, back_s

    def stands_still_s(self) -> float:
        """Return for how long, as far as the calls of `now` show, the time has stood still."""
        return self._steady_s() - self._moved_at_s


def refuse_use_sim_time(parameters: Sequence[Parameter]) -> SetParametersResult:
    """Refuse another clock while the node runs: all stamps so far would be wrong."""
    if any(parameter.name == 'use_sim_time' for parameter in parameters):
        reason = 'use_sim_time can be set only when the node starts'
        return SetParametersResult(successful=False, reason=reason)
    return SetParametersResult(successful=True)
