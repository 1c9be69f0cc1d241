# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Observations to forget because they contradict each other or the readings of now."""

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
If new measurements contradict the older ones for longer than this, they are no burst of outliers:
the older ones are forgotten.
"""

CONFIRMING = 3
"""A doubt ends after this many new measurements that agree with the older ones."""


@dataclass(frozen=True)
class Forgotten:
    """
    Observations that are no longer used.

    Parameters
    ----------
    ends : frozenset of (str, str)
        Pairs of points that observed each other, in either order.
    before_s : float
        Observations up to this time are forgotten.
    text : str
        The reason.
    after_s : float
        Observations up to this time are kept.
    now_too : bool
        Whether observations up to `before_s` are also left out of the measurements of the moment,
        because it is not known which of the contradicting ones are wrong.

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
    """Return the spans of forgotten observations, with `more`, without spans before `oldest_s`."""
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
    """Return the times up to which observations are left out of the moment, updated by `more`."""
    stamps = dict(known)
    for forgotten in more:
        for ends in forgotten.ends if forgotten.now_too else ():
            stamps[ends] = max(stamps.get(ends, -math.inf), forgotten.before_s)
    return stamps


def without(snapshot: Snapshot, forgotten: Collection[Forgotten]) -> Snapshot:
    """Return a snapshot without the forgotten observations."""
    if not forgotten:
        return snapshot
    left_out = left_out_until_s({}, forgotten)
    return snapshot.without(also_forgotten({}, forgotten), left_out.keys())


@dataclass(frozen=True)
class _Doubt:
    """
    The times at which new observations of two bodies contradicted their older ones.

    Attributes
    ----------
    since_s, last_s : float
        The first and the last time.
    agreed_since : bool
        Whether newer observations agreed since then, but too few to end the doubt.

    """

    since_s: float
    last_s: float
    agreed_since: bool = False


class Doubts:
    """
    The pairs of bodies whose observations contradict each other, from estimate to estimate.

    If the observations of a pair leave no pose, the newest ones, the older ones or an odometry
    are wrong. Until newer observations decide which, the pair gets no pose and no old observation
    is forgotten.

    If the pair is a robot and the anchors, the robot itself is in doubt: its odometry may be
    wrong, and that odometry carries all its observations.
    """

    def __init__(self) -> None:
        self._agreed_s: dict[Pair, float] = {}
        self._doubts: dict[Pair, _Doubt] = {}

    def copied(self) -> Doubts:
        """Return an independent copy."""
        other = Doubts()
        other._agreed_s, other._doubts = dict(self._agreed_s), dict(self._doubts)
        return other

    def keep(self, pairs: Collection[Pair], now_s: float) -> None:
        """Drop other pairs, and times in the future: the clock was set back."""
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
        Record that the observations of a pair contradict each other; return when they last agreed.

        The result is -inf if they never agreed, or if all of them are to be forgotten.
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
        Record that a pair has agreeing observations; return whether it is free of doubt.

        `stamps_s` are the times of its observations; `complete` says that all were tried.
        """
        doubt = self._doubts.get(pair)
        if doubt is not None:
            newer = int(np.count_nonzero(stamps_s > doubt.last_s))
            # If time never suffices to try all, it is enough that none contradicted for so long.
            tried = complete or now_s - doubt.last_s > LONGEST_DOUBT_S
            if newer < CONFIRMING or not tried:
                self._doubts[pair] = replace(doubt, agreed_since=newer > 0)
                return False
            del self._doubts[pair]
        if complete:
            self._agreed_s[pair] = now_s
        return True
