# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What tells an estimate that will never end from one that does not get the processors."""

from dg_localization.fleet import FleetConfig

# An estimate that takes so many times its limit, and at least so long, will never end.
PATIENCE = 5.0
LEAST_PATIENCE_S = 10.0
# Any estimate that is not stuck uses this much of a processor in the time that it may take, also
# on a machine that is far too busy.
LEAST_PROGRESS_S = 0.02


def longest_estimate_s(fleet: FleetConfig) -> float:
    """Return how long an estimate may take by its limits."""
    return fleet.solver.max_seconds + fleet.memory_max_seconds + fleet.max_conflict_seconds


class Watchdog:
    """
    Looks at the running estimate from time to time.

    Parameters
    ----------
    limit_s : float
        How long an estimate may take by its parameters.

    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._patience_s = max(LEAST_PATIENCE_S, PATIENCE * limit_s)
        self._seen_cpu_s = 0.0
        self._seen_at_s = 0.0

    def is_late(self, busy_s: float) -> bool:
        """Return whether an estimate that has run for so long should have ended."""
        return busy_s > self._limit_s

    def is_hopeless(self, busy_s: float, cpu_s: float) -> bool:
        """
        Return whether the running estimate will never end.

        It has used all the time of a processor that it may, or has stood still for as long.

        Parameters
        ----------
        busy_s, cpu_s : float
            For how long it has run, and how much of a processor it has used meanwhile.

        """
        is_another = busy_s < self._seen_at_s or cpu_s < self._seen_cpu_s
        if is_another or cpu_s - self._seen_cpu_s > LEAST_PROGRESS_S:
            self._seen_cpu_s, self._seen_at_s = cpu_s, busy_s
        return cpu_s > self._patience_s or busy_s - self._seen_at_s > self._patience_s
