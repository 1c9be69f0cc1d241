# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Earlier pose sets: the poses of two bodies at an earlier time, carried to now by odometry.

Carrying each old reading to now adds the error of the odometry to every one of them. An earlier
set was made when these readings were new and is carried in one step, and only new readings cut
it. A set lives for `FleetConfig.memory_s` while the next one is built beside it: older readings
have no effect, unless no newer ones bound the pose. Gaps without readings do not age a set, so
a body is not lost in a gap as long as odometry arrives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np

from dg_localization.fleet.best_point.stated_way import LikelyPose
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.forgetting import Doubts, Forgotten
from dg_localization.fleet.window.memory import WORLD, Pair
from dg_localization.poses import Cover, PairOptions, PairReadings, cover_poses

STEPS = 30
"""Steps per memory span. After one step, a set is replaced by the one carried on from it."""

OVERLAP = 0.25
"""
Fraction of the memory: readings of this span before a set cut it once more after it is carried.
With a third, sets of MRCLAM are 2.235 m wide instead of 2.228.
"""

START = 1.0 / 9.0
"""Fraction of the memory: a set starts from the readings of this span and lives for the rest."""

MOST_CARRIED = 40
"""Boxes of a carried set. With 60, an answer of MRCLAM takes 125 ms instead of 119."""


@dataclass(frozen=True)
class EarlierSet:
    """
    The poses of the tracks of two bodies at a time, by all observations since an earlier time.

    Parameters
    ----------
    since_s : float
        Older observations have no effect.
    stamp_s : float
    samples_s : tuple of float
        The stamps of the odometry samples at which the tracks are; NaN for the world.
    cover : Cover
    fixed : bool
        Whether its observations would leave finitely many places if they were exact.
    lived_s : float
        The time during which observations arrived.

    """

    since_s: float
    stamp_s: float
    samples_s: tuple[float, ...]
    cover: Cover
    fixed: bool
    lived_s: float


class EarlierSets:
    """
    The earlier sets of all pairs of bodies, oldest first; used by the estimation thread only.

    Attributes
    ----------
    doubts : Doubts
        The pairs of bodies whose observations contradict each other.
    likely : dict of str to LikelyPose
        The likeliest poses of the robots among the anchors.

    """

    def __init__(self) -> None:
        self.doubts = Doubts()
        self.likely: dict[str, LikelyPose] = {}
        self._before: dict[Pair, tuple[EarlierSet, ...]] = {}
        self._sets: dict[Pair, tuple[EarlierSet, ...]] = {}
        self._newest: dict[Pair, EarlierSet] = {}

    @property
    def pairs(self) -> frozenset[Pair]:
        """The pairs of bodies that have a set."""
        return frozenset(pair for pair, known in self._sets.items() if known)

    def copied(self) -> EarlierSets:
        """Return a copy with independent sets and doubts."""
        other = copy(self)
        other.doubts = self.doubts.copied()
        other._before, other._sets = dict(self._before), dict(self._sets)
        other._newest = dict(self._newest)
        return other

    def place(
        self, snapshot: Snapshot, pair: Pair, options: PairOptions, stopped: Callable[[], bool]
    ) -> tuple[Cover, bool] | None:
        """
        Return the poses of the tracks of a pair now, and whether its places are fixed.

        Places are fixed if the readings would leave finitely many of them if they were exact.
        Return None if no earlier set can be carried to now: all readings give as much then.
        """
        self._before[pair] = self._sets.get(pair, ())
        step = _Step(snapshot, pair, options, stopped)
        known = [one for one in self._before[pair] if step.goes_on(one)]
        memory_s = snapshot.config.memory_s
        if len(known) > 1 and known[0].lived_s > memory_s:
            known = known[1:]
        if not known:
            self._sets[pair] = step.started(-math.inf)
            return None
        newest = self._newest.get(pair)
        if newest and newest.since_s == known[0].since_s and not step.is_due(known[0]):
            # Without new measurements odometry alone carries the set on.
            carried = step.carried(newest) if step.is_still(newest) else None
            if carried is not None:
                return carried, newest.fixed
        oldest = step.taken(known[0])
        if oldest is None:
            self._sets[pair] = step.started(-math.inf)
            return None
        self._newest[pair] = oldest
        if step.is_due(known[0]):
            younger = [found for one in known[1:] if (found := step.taken(one)) is not None]
            if not younger and known[0].lived_s > 0.5 * memory_s:
                # If answers are rare, use all readings since the last one.
                after_s = min(snapshot.stamp_s - START * memory_s, self._before[pair][0].stamp_s)
                younger += step.started(after_s)
            known = [oldest, *younger]
        self._sets[pair] = tuple(known)
        return oldest.cover, oldest.fixed

    def set_back(self, pair: Pair) -> None:
        """Undo the last `place` of a pair: its newest readings are in doubt."""
        self._newest.pop(pair, None)
        if pair in self._before:
            self._sets[pair] = self._before[pair]

    def forget(self, config: FleetConfig, forgotten: Iterable[Forgotten]) -> None:
        """Drop the sets that used forgotten observations."""
        for item in forgotten:
            bodies = {frozenset(map(config.robot_of, ends)) for ends in item.ends}
            for pair, known in self._sets.items():
                if any(_are_of(config, pair, ends) for ends in bodies):
                    self._newest.pop(pair, None)
                    self._sets[pair] = tuple(
                        one
                        for one in known
                        if one.since_s > item.before_s or one.stamp_s <= item.after_s
                    )


def _are_of(config: FleetConfig, pair: Pair, bodies: frozenset[str]) -> bool:
    """Return whether two bodies, given by name, are the bodies of a pair."""
    names = [config.robots[body] for body in pair if body != WORLD]
    others = bodies.difference(names)
    return bodies.issuperset(names) and (others <= config.anchors.keys())


class _Step:
    """The step of the sets of a pair from an earlier time to the time of a snapshot."""

    def __init__(
        self, snapshot: Snapshot, pair: Pair, options: PairOptions, stopped: Callable[[], bool]
    ) -> None:
        config, self._carried = snapshot.config, snapshot.carried
        self._now_s, self._pair, self._options = snapshot.stamp_s, pair, options
        self._in_plane, self._stopped = config.dimension == 2, stopped
        self.overlap_s = OVERLAP * config.memory_s
        self._step_s = config.memory_s / STEPS
        self._paths = [None if body == WORLD else self._carried.path(body) for body in pair]
        self.stamps_s = self._carried.stamps_s(pair)

    def goes_on(self, known: EarlierSet) -> bool:
        """Return whether a set is of the past and both odometries still hold its samples."""
        there = [
            path is None or bool(np.any(path.stamps_s == sample_s))
            for path, sample_s in zip(self._paths, known.samples_s, strict=True)
        ]
        return all(there) and known.stamp_s <= self._now_s

    def is_due(self, known: EarlierSet) -> bool:
        """Return whether a newer set is due: later if no new readings would improve it."""
        age_s = self._now_s - known.stamp_s
        if not np.any(self.stamps_s > known.stamp_s):
            return age_s >= 2.0 * self.overlap_s
        return age_s >= self._step_s

    def is_still(self, known: EarlierSet) -> bool:
        """Return whether a set can be carried on and no reading is newer than it."""
        return self.goes_on(known) and not np.any(self.stamps_s > known.stamp_s)

    def started(self, after_s: float) -> tuple[EarlierSet, ...]:
        """Return a set made from the readings after a time, if they bound the pose."""
        height_m = (0.0, 0.0) if self._in_plane else (-math.inf, math.inf)
        chosen = np.flatnonzero(self.stamps_s > after_s)
        if len(chosen) <= self._options.max_outliers:
            return ()
        cover = cover_poses(
            self._readings[chosen], self._options, height_m=height_m, stopped=self._stopped
        )
        if cover.empty or not cover.bounded:
            return ()
        fixed = self._carried.fixes_place(self._pair, chosen)
        since_s = float(self.stamps_s[chosen].min())
        return (self._now(since_s, cover, fixed, self._now_s - since_s),)

    def taken(self, known: EarlierSet) -> EarlierSet | None:
        """
        Return a set at the time of the snapshot, cut by the readings since and some before.

        Return None if odometry does not bound the motion.
        """
        carried = self.carried(known)
        if carried is None:
            return None
        cover = carried.coarsened(MOST_CARRIED)
        after_s = max(known.since_s, known.stamp_s - self.overlap_s)
        chosen = np.flatnonzero(self.stamps_s >= after_s)
        if len(chosen):
            cover = cover_poses(
                self._readings[chosen], self._options, within=cover, stopped=self._stopped
            )
        fixed = known.fixed or self._carried.fixes_place(self._pair, chosen)
        lived_s = known.lived_s + self._measured_seconds(known.stamp_s)
        return self._now(known.since_s, cover, fixed, lived_s)

    def _measured_seconds(self, after_s: float) -> float:
        """Return the time since `after_s`, without a gap before the first new observation."""
        is_new = self.stamps_s > after_s
        before_s = float(self.stamps_s[~is_new].max(initial=-math.inf))
        begins_s = float(self.stamps_s[is_new].min(initial=self._now_s))
        gap_s = begins_s - max(after_s, before_s + self._step_s)
        return self._now_s - after_s - max(0.0, gap_s)

    def carried(self, known: EarlierSet) -> Cover | None:
        """Return a set at the time of the snapshot; None if odometry does not bound the motion."""
        (first, second), (first_s, second_s) = self._paths, known.samples_s
        assert second is not None
        ahead = second.track_step(second_s, self._now_s)
        back = None if first is None else first.track_back(first_s, self._now_s)
        return known.cover.carried(ahead.pose, ahead.ball_m, back, self._in_plane)

    def _now(self, since_s: float, cover: Cover, fixed: bool, lived_s: float) -> EarlierSet:
        """Return a set of track poses at the time of the snapshot."""
        samples_s = [
            math.nan if path is None else path.sample_s(self._now_s) for path in self._paths
        ]
        return EarlierSet(since_s, self._now_s, tuple(samples_s), cover, fixed, lived_s)

    @cached_property
    def _readings(self) -> PairReadings:
        """All readings of the window, relative to the tracks now."""
        return self._carried.readings(self._pair, on_tracks=True)
