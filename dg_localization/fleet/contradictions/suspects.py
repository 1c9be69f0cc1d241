# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Suspects: observations, sensors and robots that can be wrong, and a record of recent suspects.

An observation of the moment holds all readings of one target by one sensor, repeats included. The
range and the ray of one detection are one observation: they are wrong together or not at all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

from dg_localization.fleet.vocabulary import LinkKey, LinkKind


class SuspectKind(StrEnum):
    """The unit that is suspected as a whole."""

    OBSERVATION = 'observation'
    """The readings of one target by one sensor."""

    SENSOR = 'sensor'
    """All readings of one sensor: a camera, a ranging device, or a mounted sensor."""

    ROBOT = 'robot'
    """All readings by and of a robot, or of a landmark."""


@dataclass(frozen=True, order=True)
class Suspect:
    """
    Something that may be wrong as a whole.

    Parameters
    ----------
    kind : SuspectKind
    name : str
        The name of the robot, or of the observing point.
    target : str
        The target of an observation.
    measures : tuple of LinkKind
        What an observation or a sensor measures.
    stamp_s : float
        The stamp of an observation in the window; zero for observations of the moment.

    """

    kind: SuspectKind
    name: str
    target: str = ''
    measures: tuple[LinkKind, ...] = ()
    stamp_s: float = 0.0

    @property
    def sensor(self) -> Suspect:
        """The sensor that made an observation."""
        return Suspect(SuspectKind.SENSOR, self.name, measures=self.measures)

    def __str__(self) -> str:
        if self.kind is SuspectKind.ROBOT:
            return self.name
        if self.kind is SuspectKind.OBSERVATION:
            when = f' at {self.stamp_s:.3f} s' if self.stamp_s else ''
            return f'{" and ".join(self.measures)} {self.name}->{self.target}{when}'
        if '/' in self.name:
            return self.name
        return f"{self.name}'s {' and '.join(_SENSOR_NAMES[kind] for kind in self.measures)}"


_SENSOR_NAMES = {
    LinkKind.BEARING: 'camera',
    LinkKind.RANGE: 'ranging',
    LinkKind.RANGE_DIFFERENCE: 'range differences',
}

Suspects: TypeAlias = frozenset[Suspect]
Links: TypeAlias = frozenset[LinkKey]


@dataclass(frozen=True)
class Observations:
    """
    The observations of a snapshot, and the links, sensors and robots that they belong to.

    Parameters
    ----------
    links : mapping of Suspect to frozenset of LinkKey
        The links of each observation.
    sensors, robots : mapping of Suspect to frozenset of Suspect
        The observations of each sensor and of each robot.
    of_anchors : frozenset of Suspect
        The robots and landmarks that are anchors.

    """

    links: Mapping[Suspect, Links]
    sensors: Mapping[Suspect, Suspects]
    robots: Mapping[Suspect, Suspects]
    of_anchors: Suspects

    @property
    def observations(self) -> Suspects:
        """All observations."""
        return frozenset(self.links)

    def covered_by(self, kind: SuspectKind) -> Mapping[Suspect, Suspects]:
        """Return the suspects of a kind, with the observations that each covers."""
        if kind is SuspectKind.OBSERVATION:
            return {observation: frozenset([observation]) for observation in self.links}
        return self.sensors if kind is SuspectKind.SENSOR else self.robots

    def links_of(self, observations: Iterable[Suspect]) -> Links:
        """Return the links of some observations."""
        return frozenset(key for one in observations for key in self.links[one])

    def offenders(self, suspects: Iterable[Suspect]) -> Suspects:
        """
        Return the sensors and anchors of suspected observations; keep other suspects unchanged.

        It is unknown whether the sensor is wrong or the place of an anchor that it measures.
        """
        named = frozenset(suspects)
        whole = named - self.links.keys()
        accused = [suspect for suspect, covered in self.sensors.items() if covered & named]
        return whole.union(accused, (one for one in self.of_anchors if self.robots[one] & named))

    def in_short(self, observations: Suspects) -> Suspects:
        """Return the only sensor or robot that covers all observations, else the observations."""
        if len(observations) > 1:
            for named in (self.sensors, self.robots):
                one = [suspect for suspect, covered in named.items() if observations <= covered]
                if len(one) == 1:
                    return frozenset(one)
        return observations


RECORD_S = 60.0
"""Contradictions are counted over this time."""


@dataclass(frozen=True)
class Offender:
    """
    The count of contradictions in which a sensor was a suspect.

    Parameters
    ----------
    sensor : Suspect
    count : int
        Contradictions in which it was a suspect.
    contradictions : int
        All contradictions.
    span_s : float
        The time over which they are counted.

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

    def __init__(self) -> None:
        # Never changed in place: a copy of a record shares it.
        self._entries: tuple[tuple[float, frozenset[Suspect]], ...] = ()
        self._noted: frozenset[Suspect] = frozenset()

    def add(
        self,
        stamp_s: float,
        memory_s: float,
        sensors: Sequence[Suspect],
        in_window: Sequence[Suspect] = (),
    ) -> None:
        """Record the suspects of an estimate, with suspected observations of its window."""
        if self._entries and stamp_s < self._entries[-1][0]:
            # Time has jumped back: the recorded stamps mean nothing any more.
            self._entries, self._noted = (), frozenset()
        fresh = frozenset(in_window) - self._noted
        # An estimate in between may miss them if it had no time to look for them.
        oldest_s = stamp_s - max(RECORD_S, memory_s)
        self._noted = frozenset(one for one in self._noted | fresh if one.stamp_s > oldest_s)
        suspected = frozenset(sensors) | {observation.sensor for observation in fresh}
        entries = (*self._entries, (stamp_s, suspected)) if suspected else self._entries
        self._entries = tuple(
            entry for entry in entries if stamp_s - RECORD_S < entry[0] <= stamp_s
        )

    def offenders(self) -> tuple[Offender, ...]:
        """Return the recorded suspects, most frequent first."""
        counts = Counter(sensor for _, sensors in self._entries for sensor in sensors)
        total = len(self._entries)
        order = sorted(counts, key=lambda sensor: (-counts[sensor], sensor))
        return tuple(Offender(sensor, counts[sensor], total, RECORD_S) for sensor in order)
