# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Robots among anchors, followed from knot to knot of their tracks: set-membership filters.

What a robot and the anchors observed of each other cuts a cover of its poses, which odometry
carries to the next knot. That is sharper than to see all observations from now, where the errors
of the odometry since then count for each of them anew, and costs only what is new. A filter lives
for `FleetConfig.memory_s`, and others start in the meantime: nothing older than the memory has any
effect, and no filter counts what was broken in more than one memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass
import math

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.carry import WORLD, Pair
from dg_localization.fleet.window.forgetting import Doubts, Forgotten
from dg_localization.fleet.window.memory import Ends, Observation
from dg_localization.pairs import CountedCover, Cover, PairOptions

LEAST_FOLLOWED_S = 25.0
"""In a shorter memory all readings, seen from now, tell as much in less time."""

KNOTS, LEAST_STEP_S = 120, 0.75
"""In a memory, where it is long enough for steps like this. Readings cut at the next knot: with
fewer, they are seen from farther away."""

FILTERS = 4
"""Of a robot: the oldest knows at least all but one part of so many of what is remembered."""

START_SHARE = 1.0 / 9.0
"""Of the memory, for the readings that a filter starts from."""

YOUNG_SHARE, LEAST_SHARE = 0.7, 0.5
"""A filter that knows less than this share of what is remembered, or has lived for less than that
share of the memory, tells less than all readings."""

MOST_BOXES = 1000
"""Of the cover that a filter starts from."""

NOWHERE = Cover(np.empty((0, 2, 4)))


@dataclass(frozen=True)
class PoseFilter:
    """
    What the observations of a robot since some time tell of its track at a knot.

    Parameters
    ----------
    since_s : float
        Older observations have no effect.
    knot_s : float
        The stamp of a sample of the odometry.
    cover : CountedCover
        Of the pose of its track then, among the anchors.

    """

    since_s: float
    knot_s: float
    cover: CountedCover


@dataclass(frozen=True)
class Step:
    """
    A filter at a knot and at the next one, and what it was carried on by.

    Until no reading can come late any more, estimates take the same steps again.

    Parameters
    ----------
    before, after : PoseFilter
    seen : tuple of Observation
        The observations in between.
    samples : int
        How many samples the odometry has in between.

    """

    before: PoseFilter
    after: PoseFilter
    seen: tuple[Observation, ...]
    samples: int

    def is_of(
        self, before: PoseFilter, until_s: float, seen: tuple[Observation, ...], samples: int
    ) -> bool:
        """Return whether this is the step of a filter to a time, with nothing heard since."""
        same_way = self.before is before and self.after.knot_s == until_s
        if not same_way or self.samples != samples or len(self.seen) != len(seen):
            return False
        return all(one is other for one, other in zip(self.seen, seen, strict=True))


class PoseFilters:
    """
    The filters of all robots, the oldest first, in the thread of the estimates.

    Attributes
    ----------
    doubts : Doubts
        Which pairs of bodies contradict themselves.

    """

    def __init__(self) -> None:
        self.doubts = Doubts()
        self._before: dict[int, tuple[PoseFilter, ...]] = {}
        self._filters: dict[int, tuple[PoseFilter, ...]] = {}
        self._steps: dict[int, tuple[Step, ...]] = {}

    def copied(self) -> PoseFilters:
        """Return the same filters; what changes one does not change the other."""
        other = copy(self)
        other.doubts = self.doubts.copied()
        other._before, other._filters = dict(self._before), dict(self._filters)
        other._steps = dict(self._steps)
        return other

    def place(self, snapshot: Snapshot, robot: int, stopped: Callable[[], bool]) -> Cover | None:
        """
        Follow a robot to now.

        Parameters
        ----------
        snapshot : Snapshot
            In the plane.
        robot : int
            It has odometry, and observed anchors, or they it.
        stopped : callable
            Asked between knots; once it is true, the readings that are left cut nothing.

        Returns
        -------
        Cover or None
            Of its poses among the anchors now, empty where its observations contradict each other.
            None where all readings of the window together tell more than a filter.

        """
        if snapshot.config.memory_s < LEAST_FOLLOWED_S:
            return None
        self._before[robot] = self._filters.get(robot, ())
        walk = _Walk(snapshot, robot, stopped, self._steps.get(robot, ()))
        filters = [walk.settled(c) for c in self._filters.get(robot, ()) if walk.goes_on(c)]
        kept = [pose_filter for pose_filter in filters if pose_filter is not None]
        kept += walk.started(kept[-1].since_s if kept else -math.inf)
        self._filters[robot] = tuple(kept)
        place = walk.place(kept) if kept else None
        self._steps[robot] = tuple(walk.steps)
        return place

    def set_back(self, pair: Pair) -> None:
        """Undo the last `place` of a robot among anchors: what it measured since is in doubt."""
        world, robot = pair
        if world == WORLD and robot in self._before:
            self._filters[robot] = self._before[robot]

    def forget(self, config: FleetConfig, forgotten: Iterable[Forgotten]) -> None:
        """Drop the filters that know of observations that are forgotten."""
        for item in forgotten:
            for robot, filters in self._filters.items():
                if _are_with_anchors(config, config.robots[robot], item.ends):
                    self._filters[robot] = tuple(
                        known
                        for known in filters
                        if known.since_s >= item.before_s or known.knot_s <= item.after_s
                    )


def _are_with_anchors(config: FleetConfig, robot: str, ends: Iterable[Ends]) -> bool:
    """Return whether any of some ends are those of a robot and an anchor."""
    bodies = ({config.robot_of(point) for point in pair} for pair in ends)
    return any(robot in pair and not pair.isdisjoint(config.anchors) for pair in bodies)


class _Walk:
    """
    The way of one robot to the time of a snapshot.

    Parameters
    ----------
    snapshot : Snapshot
    robot : int
    stopped : callable
    steps_before : sequence of Step
        Those of the estimate before.

    Attributes
    ----------
    steps : list of Step
        Those from knot to knot.

    """

    def __init__(
        self,
        snapshot: Snapshot,
        robot: int,
        stopped: Callable[[], bool],
        steps_before: Sequence[Step] = (),
    ) -> None:
        self.steps: list[Step] = []
        self._steps_before = steps_before
        self._config, self._now_s = snapshot.config, snapshot.stamp_s
        self._carried, self._robot = snapshot.carried, robot
        self._path = snapshot.carried.path(robot)
        self._stopped = stopped
        self._oldest_s = self._now_s - self._config.memory_s
        # No reading of before will be accepted any more.
        self._settled_s = self._now_s - self._config.max_age_s

    def goes_on(self, pose_filter: PoseFilter) -> bool:
        """Return whether a filter is in memory, and at a sample that is known."""
        in_memory = self._oldest_s <= pose_filter.since_s and pose_filter.knot_s <= self._now_s
        return in_memory and bool(np.any(self._path.stamps_s == pose_filter.knot_s))

    def settled(self, pose_filter: PoseFilter) -> PoseFilter | None:
        """Return a filter at its last knot before which no reading can come any more."""
        found: PoseFilter | None = pose_filter
        while found is not None and not self._stopped():
            knot_s = self._next_knot_s(found)
            if knot_s > self._settled_s:
                break
            found = self._to_knot(found, knot_s)
        return found

    def started(self, newest_since_s: float) -> list[PoseFilter]:
        """Return a filter that starts now, if it is time for one and if it can."""
        config = self._config
        known_s = self._path.stamps_s[self._path.stamps_s <= self._settled_s]
        if not len(known_s) or self._stopped():
            return []
        knot_s = float(known_s[-1])
        since_s = knot_s - START_SHARE * config.memory_s
        if since_s < max(self._oldest_s, newest_since_s + config.memory_s / FILTERS):
            return []
        readings = self._carried.readings_between(self._robot, since_s, knot_s)
        if readings is None or len(readings) <= config.window_outliers:
            return []
        options = PairOptions(config.window_outliers, max_boxes=MOST_BOXES)
        cover = CountedCover.started(readings, options, stopped=self._stopped)
        if cover is None or cover.empty or self._stopped():
            return []
        return [PoseFilter(since_s, knot_s, cover)]

    def place(self, filters: Sequence[PoseFilter]) -> Cover | None:
        """Return what the oldest of some filters tells now."""
        oldest = filters[0]
        if any(pose_filter.cover.empty for pose_filter in filters):
            return NOWHERE
        span_s = self._carried.span_s((WORLD, self._robot))
        least_s = max(YOUNG_SHARE * span_s, LEAST_SHARE * self._config.memory_s)
        if self._now_s - oldest.since_s < least_s:
            return None
        return self._arrived(oldest)

    def _arrived(self, pose_filter: PoseFilter) -> Cover | None:
        """Return where the robot is now."""
        found: PoseFilter | None = pose_filter
        while found is not None and not self._stopped():
            knot_s = self._next_knot_s(found)
            if knot_s >= self._now_s:
                break
            found = self._to_knot(found, knot_s)
        found = None if found is None else self._to(found, self._now_s)
        if found is None:
            return None
        off = self._path.off_track(self._now_s)
        moved = found.cover.uncounted.carried(off.pose, off.ball_m)
        return None if moved is None else moved.cover

    def _next_knot_s(self, pose_filter: PoseFilter) -> float:
        """Return the stamp of the next knot; infinite where there is none yet."""
        stamps_s = self._path.stamps_s
        step_s = max(self._config.memory_s / KNOTS, LEAST_STEP_S)
        after = np.searchsorted(stamps_s, pose_filter.knot_s, side='right')
        last = np.searchsorted(stamps_s, pose_filter.knot_s + step_s, side='right') - 1
        knot = max(int(after), int(last))
        return float(stamps_s[knot]) if knot < len(stamps_s) else math.inf

    def _to_knot(self, pose_filter: PoseFilter, knot_s: float) -> PoseFilter | None:
        """Return a filter at its next knot, as it was at the estimate before if it can be."""
        seen = self._carried.seen_between(self._robot, pose_filter.knot_s, knot_s)
        ends = np.searchsorted(self._path.stamps_s, [pose_filter.knot_s, knot_s])
        samples = int(ends[1] - ends[0])
        for step in self._steps_before:
            if step.is_of(pose_filter, knot_s, seen, samples):
                self.steps.append(step)
                return step.after
        after = self._to(pose_filter, knot_s)
        if after is not None and not self._stopped():
            self.steps.append(Step(pose_filter, after, seen, samples))
        return after

    def _to(self, pose_filter: PoseFilter, until_s: float) -> PoseFilter | None:
        """Return a filter at a later time; None where odometry does not bound the way."""
        step = self._path.track_step(pose_filter.knot_s, until_s)
        cover = pose_filter.cover.carried(step.pose, step.ball_m)
        if cover is None:
            return None
        readings = None
        if not self._stopped():
            readings = self._carried.readings_between(self._robot, pose_filter.knot_s, until_s)
        if readings is not None:
            cover = cover.cut(readings)
        return PoseFilter(pose_filter.since_s, until_s, cover)
