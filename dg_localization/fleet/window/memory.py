# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The memory: observations of the last seconds, thinned to a bounded number.

A `Table` holds the observations of a pair of bodies as arrays.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import math
from operator import attrgetter
from types import MappingProxyType
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.mounts import AHEAD
from dg_localization.fleet.vocabulary import DistanceReading, RayReading
from dg_localization.poses import NO_RAY_RAD

MOST_OBSERVATIONS = 300
"""The limit for one observer and one target: more observations add little information."""

STAMP_S = attrgetter('stamp_s')

Ends: TypeAlias = tuple[str, str]
"""The names of an observer and its target."""

Span: TypeAlias = tuple[float, float]
"""Two times: stamps after the first, up to and including the second."""


Spans: TypeAlias = Mapping[Ends, tuple[Span, ...]]
"""Spans of observations between two points, in either order."""


WORLD = -1
"""The body of the anchors."""

Pair = tuple[int, int]
"""Two bodies, the smaller index first: the world before any robot."""


class Observation(NamedTuple):
    """
    The readings of one sensor of one target at one time.

    Parameters
    ----------
    stamp_s : float
    lower_m, upper_m : float
        Bounds of the distance.
    half_width_rad : float
        Bound of the angle between the direction and the true one; infinite if none was measured.
    least_m, most_m : float
        Bounds of a range difference; infinite if none was measured.
    likeliest_m : float
        The likeliest distance; NaN if none was measured.
    expected_error_rad : float
        The likeliest error of the direction about the vertical axis.
    direction : numpy.ndarray, shape (3,)
        Unit vector in the body frame of the observer.

    """

    stamp_s: float
    lower_m: float = 0.0
    upper_m: float = math.inf
    half_width_rad: float = NO_RAY_RAD
    least_m: float = -math.inf
    most_m: float = math.inf
    likeliest_m: float = math.nan
    expected_error_rad: float = 0.0
    direction: ArrayLike = AHEAD

    def joined(self, reading: DistanceReading | RayReading) -> Observation:
        """Return the observation with a reading of the same time."""
        if isinstance(reading, DistanceReading) and reading.key.reference:
            return self._replace(least_m=reading.lower_m, most_m=reading.upper_m)
        if isinstance(reading, DistanceReading):
            lower_m = max(self.lower_m, reading.lower_m)
            upper_m = min(self.upper_m, reading.upper_m)
            likeliest_m = reading.likeliest_m
            return self._replace(lower_m=lower_m, upper_m=upper_m, likeliest_m=likeliest_m)
        if reading.half_width_rad >= self.half_width_rad:
            return self
        return self._replace(
            direction=reading.direction,
            half_width_rad=reading.half_width_rad,
            expected_error_rad=reading.expected_error_rad,
        )

    def is_of_kind(self, reading: DistanceReading | RayReading) -> bool:
        """Return whether the observation has a ray, or for a distance reading a distance."""
        has_ray = self.half_width_rad < NO_RAY_RAD
        if isinstance(reading, RayReading):
            return has_ray
        return not has_ray or self.lower_m > 0.0 or self.upper_m < math.inf


@dataclass(frozen=True)
class Window:
    """
    The observations of the last seconds at the time of a snapshot.

    Parameters
    ----------
    observations : mapping of tuple of str to tuple of Observation
        By observer and target, and by reference for range differences.

    """

    observations: Mapping[tuple[str, ...], tuple[Observation, ...]] = field(
        default_factory=lambda: MappingProxyType({})
    )

    def without(self, forgotten: Spans) -> Window:
        """Return the window without forgotten observations."""
        left = {}
        for points, seen in self.observations.items():
            ends = points[0], points[1]
            for after_s, until_s in (*forgotten.get(ends, ()), *forgotten.get(ends[::-1], ())):
                first = bisect_right(seen, after_s, key=STAMP_S)
                end = bisect_right(seen, until_s, key=STAMP_S)
                seen = seen[:first] + seen[end:]
            if seen:
                left[points] = seen
        return Window(MappingProxyType(left))


NO_WINDOW = Window()


class Memory:
    """
    Keeps observations for `FleetConfig.memory_s`, the first of each kind in a short time slot.

    Leaving out an observation is always sound.

    Parameters
    ----------
    config : FleetConfig

    """

    def __init__(self, config: FleetConfig) -> None:
        # The observations of the points of a link, oldest first.
        self._observations: dict[tuple[str, ...], list[Observation]] = {}
        self._newest_s = self._viewed_s = -math.inf
        self._memory_s = self._max_future_s = 0.0
        self.adopt(config)

    def adopt(self, config: FleetConfig) -> None:
        """Adopt settings; observations that were too old for an answer stay forgotten."""
        oldest_s = self._viewed_s - self._memory_s
        self._memory_s, self._slot_s = config.memory_s, config.memory_s / MOST_OBSERVATIONS
        # Stored stamps may be as late as an earlier value allowed.
        self._max_future_s = max(self._max_future_s, config.max_future_s)
        for kept in self._observations.values():
            del kept[: bisect_right(kept, oldest_s, key=STAMP_S)]

    def add(self, reading: DistanceReading | RayReading, now_s: float) -> None:
        """Keep a reading accepted at `now_s`, unless its time slot has one of its kind."""
        if self._memory_s <= 0.0:
            return
        if self._newest_s > now_s + self._max_future_s:
            # Time has jumped back: the stored stamps mean nothing any more.
            self._observations.clear()
            self._newest_s = -math.inf
        if isinstance(reading, DistanceReading) and reading.lower_m > reading.upper_m:
            return
        self._newest_s = max(self._newest_s, reading.stamp_s)
        kept = self._observations.setdefault(reading.key.points, [])
        if len(kept) > MOST_OBSERVATIONS:
            del kept[: bisect_left(kept, now_s - self._memory_s - self._slot_s, key=STAMP_S)]
        slot = self._slot_of(reading)
        first = bisect_left(kept, slot, key=self._slot_of)
        end = bisect_right(kept, slot, key=self._slot_of)
        stamps_s = [one.stamp_s for one in kept[first:end]]
        if reading.stamp_s in stamps_s:
            place = first + stamps_s.index(reading.stamp_s)
            joined = kept[place].joined(reading)
            if joined.lower_m <= joined.upper_m:
                kept[place] = joined
        elif not any(one.is_of_kind(reading) for one in kept[first:end]):
            insort(kept, Observation(reading.stamp_s).joined(reading), key=STAMP_S)

    def _slot_of(self, one: Observation | DistanceReading | RayReading) -> int:
        """Return the number of the time slot of an observation or a reading."""
        return math.floor(one.stamp_s / self._slot_s)

    def view(self, now_s: float, forgotten: Spans) -> Window:
        """Return the observations remembered at a time, without forgotten ones."""
        if self._memory_s <= 0.0:
            return NO_WINDOW
        self._viewed_s = now_s
        found = {}
        for ends, kept in self._observations.items():
            first = bisect_right(kept, now_s - self._memory_s, key=STAMP_S)
            end = bisect_right(kept, now_s, key=STAMP_S)
            if first < end:
                found[ends] = tuple(kept[first:end])
        return Window(MappingProxyType(found)).without(forgotten)


class Table(NamedTuple):
    """
    Observations of a pair as arrays; `points` are the points on the first and second body.

    `references` equals `points`, with the reference of a range difference in place of its target.
    """

    seen_by_second: NDArray[np.bool_]
    points: NDArray[np.int64]
    references: NDArray[np.int64]
    rays: NDArray[np.float64]
    stamps_s: NDArray[np.float64]
    lower_m: NDArray[np.float64]
    upper_m: NDArray[np.float64]
    errors_rad: NDArray[np.float64]
    least_m: NDArray[np.float64]
    most_m: NDArray[np.float64]
    likeliest_m: NDArray[np.float64]
    expected_errors_rad: NDArray[np.float64]

    @classmethod
    def of(
        cls, seen: Sequence[Observation], by_second: bool, points: Pair, references: Pair
    ) -> Table:
        """Return a table of the observations between two points."""
        count = len(seen)
        rays = np.array([one.direction for one in seen], dtype=float)
        shared = (np.tile(value, (count, 1)) for value in (points, references))
        numbers = np.array([one[:-1] for one in seen]).T
        return cls._make([np.full(count, by_second), *shared, rays, *numbers])

    @classmethod
    def joined(cls, parts: Iterable[Table]) -> Table:
        """Return the rows of all parts."""
        return cls._make(map(np.concatenate, zip(*parts, strict=True)))

    @property
    def ends(self) -> NDArray[np.int64]:
        """The observer and the target of each row, shape (m, 2)."""
        return np.where(self.seen_by_second[:, None], self.points[:, ::-1], self.points)

    @property
    def references_of_targets(self) -> NDArray[np.int64]:
        """The reference of each row that is a range difference, the target of other rows."""
        first, second = self.references.T
        return np.where(self.seen_by_second, first, second)

    @property
    def differences(self) -> NDArray[np.intp]:
        """The rows that are range differences."""
        return np.flatnonzero(np.isfinite(self.most_m))

    def newest_first(self) -> Table:
        """Return the rows sorted by time, newest first."""
        return self.some(np.argsort(-self.stamps_s, kind='stable'))

    def some(self, index: slice | NDArray[np.int64]) -> Table:
        """Return some of the rows."""
        return Table._make(column[index] for column in self)
