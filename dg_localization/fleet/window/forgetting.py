# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What of a window contradicts itself, or what is measured now, and is forgotten therefore."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.memory import WORLD, Ends, Pair, Spans

LONGEST_DOUBT_S = 2.0
"""
Measurements that contradict what was measured before for longer than this are no burst of wrong
ones: then what was measured before is forgotten.
"""

CONFIRMING = 3
"""A doubt ends after this many measurements that agree with those before."""


@dataclass(frozen=True)
class Forgotten:
    """
    Observations that are not used any more.

    Parameters
    ----------
    ends : frozenset of (str, str)
        The points that observed each other, in either order.
    before_s : float
        Observations up to this time are forgotten.
    text : str
        Why.
    after_s : float
        Observations up to this time are not.
    now_too : bool
        Whether all up to `before_s` do not count as measurements of the moment, either: which of
        those that contradict each other are wrong is not known.

    """

    ends: frozenset[Ends]
    before_s: float
    text: str
    after_s: float = -math.inf
    now_too: bool = False


def ends_between(config: FleetConfig, body: str, others: Iterable[str]) -> frozenset[Ends]:
    """Return the points by which a robot and other bodies observe each other."""
    theirs = [point for other in others for point in config.points_on(other)]
    return frozenset(product(config.points_on(body), theirs))


def ends_of(config: FleetConfig, pairs: Iterable[Pair]) -> frozenset[Ends]:
    """Return the points by which pairs of bodies observe each other."""
    robots = config.robots
    found: frozenset[Ends] = frozenset()
    for first, second in pairs:
        others = config.anchors if first == WORLD else (robots[first],)
        found |= ends_between(config, robots[second], others)
    return found


def also_forgotten(known: Spans, more: Iterable[Forgotten], oldest_s: float = -math.inf) -> Spans:
    """Return which observations are forgotten, with some more, without those that are older."""
    spans = {
        ends: kept
        for ends, some in known.items()
        if (kept := tuple(span for span in some if span[1] > oldest_s))
    }
    for forgotten in more:
        after_s, before_s = forgotten.after_s, forgotten.before_s
        for ends in forgotten.ends:
            some = spans.get(ends, ())
            others = (span for span in some if span[0] < after_s or span[1] > before_s)
            spans[ends] = (*others, (after_s, before_s))
    return spans


def left_out_until_s(
    known: Mapping[Ends, float], more: Iterable[Forgotten]
) -> Mapping[Ends, float]:
    """Return up to when observations do not count at the moment, either, with some more."""
    stamps = dict(known)
    for forgotten in more:
        for ends in forgotten.ends if forgotten.now_too else ():
            stamps[ends] = max(stamps.get(ends, -math.inf), forgotten.before_s)
    return stamps


def without(snapshot: Snapshot, forgotten: Collection[Forgotten]) -> Snapshot:
    """Return what is left of a snapshot where some observations are forgotten."""
    if not forgotten:
        return snapshot
    left_out = left_out_until_s({}, forgotten)
    return snapshot.without(also_forgotten({}, forgotten), left_out.keys())


@dataclass(frozen=True)
class _Doubt:
    """
    When what two bodies observed contradicted what they had observed before.

    Attributes
    ----------
    since_s, last_s : float
        The first and the last time.
    agreed_since : bool
        Whether newer observations agree since the last time, if too few to end the doubt.

    """

    since_s: float
    last_s: float
    agreed_since: bool = False


class Doubts:
    """
    Which pairs of bodies contradict themselves, from estimate to estimate.

    Where the observations of a pair leave no pose, the newest of them are wrong, or the older
    ones, or an odometry. While that is open nothing is said of the pair, and nothing old is
    forgotten. Newer observations decide it.

    A robot that contradicts what it and the anchors measured is in doubt itself: its odometry may
    be wrong, which carries all that it measured.
    """

    def __init__(self) -> None:
        self._agreed_s: dict[Pair, float] = {}
        self._doubts: dict[Pair, _Doubt] = {}

    def copied(self) -> Doubts:
        """Return the same doubts; what changes one does not change the other."""
        other = Doubts()
        other._agreed_s, other._doubts = dict(self._agreed_s), dict(self._doubts)
        return other

    def keep(self, pairs: Collection[Pair], now_s: float) -> None:
        """Drop what is known of other pairs, and of times to come: the clock was set back."""
        self._agreed_s = {
            pair: agreed_s
            for pair, agreed_s in self._agreed_s.items()
            if pair in pairs and agreed_s <= now_s
        }
        self._doubts = {
            pair: doubt
            for pair, doubt in self._doubts.items()
            if pair in pairs and doubt.last_s <= now_s
        }

    def about(self, pair: Pair) -> bool:
        """Return whether a pair is in doubt."""
        return pair in self._doubts

    def contradicted(self, pair: Pair, now_s: float) -> float:
        """
        Note that what a pair observed contradicts itself, and return when it agreed last.

        That is -inf where it never did, or where all is to be forgotten.
        """
        agreed_s = self._agreed_s.get(pair, math.inf)
        doubt = self._doubts.get(pair)
        if doubt is None or doubt.agreed_since:
            doubt = _Doubt(now_s, now_s)
        if agreed_s >= now_s or now_s - doubt.since_s > LONGEST_DOUBT_S:
            self._agreed_s.pop(pair, None)
            self._doubts.pop(pair, None)
            return -math.inf
        self._doubts[pair] = _Doubt(doubt.since_s, now_s)
        return agreed_s

    @property
    def robots(self) -> frozenset[int]:
        """The robots in doubt."""
        return frozenset(second for first, second in self._doubts if first == WORLD)

    def settled(
        self, pair: Pair, stamps_s: NDArray[np.float64], now_s: float, complete: bool
    ) -> bool:
        """
        Return whether a pair that does not contradict itself is in no doubt, and note it.

        `stamps_s` are the times of its observations; `complete` says that all were tried.
        """
        doubt = self._doubts.get(pair)
        if doubt is not None:
            newer = int(np.count_nonzero(stamps_s > doubt.last_s))
            # Where there is never time to try all of them, none has contradicted for long enough.
            tried = complete or now_s - doubt.last_s > LONGEST_DOUBT_S
            if newer < CONFIRMING or not tried:
                self._doubts[pair] = replace(doubt, agreed_since=newer > 0)
                return False
            del self._doubts[pair]
        if complete:
            self._agreed_s[pair] = now_s
        return True
