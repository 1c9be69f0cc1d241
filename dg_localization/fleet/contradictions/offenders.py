# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Repeat offenders: which sensors were among the suspects, and how often."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

from dg_localization.fleet.contradictions.suspects import Suspect

RECORD_S = 60.0
"""Contradictions are counted for so long."""


@dataclass(frozen=True)
class Offender:
    """
    How often a sensor was among the suspects.

    Parameters
    ----------
    sensor : Suspect
    count : int
        In so many contradictions it was.
    contradictions : int
        Of so many.
    span_s : float
        In this time.

    """

    sensor: Suspect
    count: int
    contradictions: int
    span_s: float

    def __str__(self) -> str:
        return (
            f'{self.sensor} was among the suspects in {self.count} of {self.contradictions} '
            f'contradictions of the last {self.span_s:.0f} s'
        )


class Record:
    """The contradictions of the last `RECORD_S`."""

    def __init__(self, memory_s: float) -> None:
        self._memory_s = memory_s
        self._entries: list[tuple[float, frozenset[Suspect]]] = []
        self._noted: frozenset[Suspect] = frozenset()

    def copied(self) -> Record:
        """Return one with the same entries."""
        other = copy(self)
        other._entries = list(self._entries)
        return other

    def add(
        self, stamp_s: float, sensors: Sequence[Suspect], in_window: Sequence[Suspect] = ()
    ) -> None:
        """Note whom an estimate made suspect."""
        if self._entries and stamp_s < self._entries[-1][0]:
            # Time has jumped back: what was noted is of another time.
            self._entries.clear()
            self._noted = frozenset()
        fresh = frozenset(in_window) - self._noted
        # They may be missing from an estimate in between that had no time to look for them.
        oldest_s = stamp_s - max(RECORD_S, self._memory_s)
        self._noted = frozenset(one for one in self._noted | fresh if one.stamp_s > oldest_s)
        suspected = frozenset(sensors) | {observation.sensor for observation in fresh}
        if suspected:
            self._entries.append((stamp_s, suspected))
        self._entries = [
            entry for entry in self._entries if stamp_s - RECORD_S < entry[0] <= stamp_s
        ]

    def offenders(self) -> tuple[Offender, ...]:
        """Return who was among the suspects, those that were most often first."""
        counts = Counter(sensor for _, sensors in self._entries for sensor in sensors)
        total = len(self._entries)
        order = sorted(counts, key=lambda sensor: (-counts[sensor], sensor))
        return tuple(Offender(sensor, counts[sensor], total, RECORD_S) for sensor in order)
