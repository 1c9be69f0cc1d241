# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A window evaluated at the time of a snapshot, and an answer of the moment narrowed by it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
import time

from dg_localization.fleet.answers import Answer, Part
from dg_localization.fleet.estimate import FixedFrame, Placement
from dg_localization.fleet.frames.plan import FramePlan
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.fleet.window.carry import Tilt
from dg_localization.fleet.window.earlier_sets import EarlierSets
from dg_localization.fleet.window.forgetting import Forgotten, ends_of, without
from dg_localization.fleet.window.memory import MOST_OBSERVATIONS, WORLD, Ends, Pair
from dg_localization.fleet.window.pose_sets import (
    MOST_BOXES,
    NO_POSE_SETS,
    PoseSets,
    place_by_moment,
    place_robots,
)
from dg_localization.fleet.window.proved import (
    WINDOW_SHARE,
    CarriedPlacements,
    Proved,
    chain_seconds,
)
from dg_localization.fleet.window.shape_headings import (
    Remaining,
    narrow_in_plane,
    narrow_in_space,
    parted,
    sifted,
    within_bounds,
)
from dg_localization.poses import PairOptions, PairReadings
from dg_localization.solver.options import Cancel
from dg_localization.solver.search.budget import Budget

PROVED_CONTRADICTS = 'what an earlier estimate proved contradicts what is measured now'
CONTRADICTS_NOW = 'what was measured before contradicts what is measured now'

MOST_LATE = 3.0
"""Greatest ratio of time on the clock to processor time, on a machine busy with other work."""

MOST_PARTNERS = 4
"""
Limit per robot: near robots bound its heading best, since errors of ranges grow with distance.
Its partners and the anchors together share the number of observations that one pair may keep.
"""


CHAIN_SHARE = 0.5
"""Fraction of the life of a chain of estimates after which the next chain begins."""

CHAIN_STEPS = 30
"""
Steps of a chain in its life until it is the oldest. Narrowing it with every estimate takes 1.4
times as long. With 15, the recording of the tutorial has one hypothesis in 96 answers, not 134.
"""

JOINT_RESOLUTION_M = 0.05
COARSE_BOXES, PROGRAM_BOXES = 32, 96
"""
Boxes of the joint poses of a few robots: few to rule out impossible placements, more to bound the
remaining ones if outliers are tolerated, and few with linear programs otherwise.
"""

MOST_REFINED = 16
"""If there are more placements, the rest get coarse headings only and none gets a new best point:
none of them is the answer yet."""

Refit = Callable[[FramePlan, Placement], Placement]


class BusyClock:
    """
    A clock of the processor time of this thread, or a third of the wall-clock time if more.

    Wall-clock time alone would count the work of other threads. The clock can be paused.
    """

    def __init__(self) -> None:
        self._before_s = 0.0
        self.resume()

    def __call__(self) -> float:
        """Return the time so far, in s."""
        on_wall_s = time.monotonic() - self._on_wall_s
        return self._before_s + max(time.thread_time() - self._busy_s, on_wall_s / MOST_LATE)

    def pause(self) -> None:
        """Keep the time so far; `resume` leaves out what passes from now on."""
        self._before_s = self()
        self.resume()

    def resume(self) -> None:
        """Count on from now."""
        self._busy_s, self._on_wall_s = time.thread_time(), time.monotonic()


@dataclass(frozen=True)
class Recollection:
    """
    A window, carried to the time of a snapshot.

    Attributes
    ----------
    snapshot : Snapshot
        Without the observations that contradict each other.
    budget : Budget
        The time for the window, on `clock`.
    clock : BusyClock
    readings : mapping of (int, int) to PairReadings
        The observations between pairs of robots.
    spans_s : mapping of (int, int) to float
        The age of the oldest observation of a pair that counts; the world may be in a pair.
    pose_sets : PoseSets
    replaced : frozenset of LinkKey
        The links of the moment that the pose sets replace: any of them may be an outlier.
    forgotten : tuple of Forgotten
        The observations that contradict each other.
    chains : tuple of CarriedPlacements, or None
        Proved placements of earlier estimates, oldest chain first; None for a chain that begins.
    waiting : tuple of Proved
        The younger chains whose next step is not due.
    tilts : mapping of int to Tilt
        Tilts of the robots with pose sets, in space.
    in_doubt : tuple of str
        The robots without a pose until newer measurements agree with the anchors.

    """

    snapshot: Snapshot
    budget: Budget
    clock: BusyClock
    readings: Mapping[Pair, PairReadings] = field(default_factory=dict)
    spans_s: Mapping[Pair, float] = field(default_factory=dict)
    pose_sets: PoseSets = NO_POSE_SETS
    replaced: frozenset[LinkKey] = frozenset()
    forgotten: tuple[Forgotten, ...] = ()
    chains: tuple[CarriedPlacements | None, ...] = (None,)
    waiting: tuple[Proved, ...] = ()
    tilts: Mapping[int, Tilt] = field(default_factory=dict)
    in_doubt: tuple[str, ...] = ()

    @property
    def carried_robots(self) -> list[str]:
        """The robots that have a pose set."""
        bodies = {body for pair in self.pose_sets.sets for body in pair}
        return [self.snapshot.config.robots[body] for body in bodies - {WORLD}]

    def without_pose_sets(self) -> Recollection:
        """Return a copy without the pose sets, which contradict the moment and are forgotten."""
        ends = ends_of(self.snapshot.config, self.pose_sets.sets)
        forgotten = self.forgetting(ends, CONTRADICTS_NOW)
        return replace(self, pose_sets=NO_POSE_SETS, replaced=frozenset(), forgotten=forgotten)

    def forgetting(self, ends: frozenset[Ends], text: str) -> tuple[Forgotten, ...]:
        """Return the forgotten observations, with all observations between some points added."""
        return (*self.forgotten, Forgotten(ends, self.snapshot.stamp_s, text))

    @property
    def empty(self) -> bool:
        """Whether nothing here can narrow placements."""
        known = self.readings or self.pose_sets.sets or self.pose_sets.of_moment
        return not (known or any(self.chains))

    def narrow(
        self, placements: Sequence[Placement], frame: FixedFrame, chain: int = 0
    ) -> Remaining:
        """
        Return the placements of one frame, narrowed by the window and one chain of estimates.

        The later chains keep their shares of the remaining time.
        """
        config, sets = self.snapshot.config, self.pose_sets
        stopped = self.budget.has_passed(1.0 / (len(self.chains) - chain))

        def narrow(options: PairOptions, placement: Placement) -> Placement | str:
            if config.dimension == 3:
                found = narrow_in_space(placement, frame.kind, sets, self.tilts)
            else:
                found = narrow_in_plane(
                    placement, frame, config.robots, self.readings, sets, options, stopped
                )
            return found if isinstance(found, Placement) else self._over(found)

        coarse = PairOptions(config.window_outliers, JOINT_RESOLUTION_M, COARSE_BOXES)
        left = _carried_on(placements, frame, self.chains[chain])
        sentences = left.ruled_out
        best, others = parted(left.placements, MOST_REFINED)
        if others:
            left = sifted(left.placements, partial(narrow, coarse))
            sentences += left.ruled_out
            best, others = parted(left.placements, MOST_REFINED)
        boxes = MOST_BOXES if config.window_outliers else COARSE_BOXES
        # Of several placements, some are mirror images to be ruled out.
        alone = len(best) == 1
        fine = replace(coarse, max_boxes=boxes, max_programs=PROGRAM_BOXES, hull_only=alone)
        refined = sifted(best, partial(narrow, fine))
        return Remaining((*refined.placements, *others), sentences + refined.ruled_out)

    def _over(self, pair: Pair) -> str:
        """Return the names of a pair, with the span of its observations in the window, if any."""
        first, second = pair
        robots = self.snapshot.config.robots
        names = f'{"anchors" if first == WORLD else robots[first]} - {robots[second]}'
        return f'{names} over {self.spans_s[pair]:.0f} s' if pair in self.spans_s else names


def recall(
    snapshot: Snapshot,
    proved: Sequence[Proved],
    cancel: Cancel | None,
    earlier: EarlierSets,
) -> Recollection:
    """
    Evaluate the window of a snapshot, with the proved placements of earlier estimates.

    In space only robots with upright odometry are placed, among anchors or relative to each other.
    """
    config, carried = snapshot.config, snapshot.carried
    clock, limits = BusyClock(), config.solver.limited(1, config.memory_max_seconds, 0.0)
    budget = Budget(limits, cancel, clock=clock)
    # The first reading of a pair may be an outlier, too.
    tolerates = config.window_outliers > 0 and config.memory_s > 0.0
    replaced = carried.links_among(snapshot.keys) if tolerates else frozenset()
    any_upright = any(map(config.is_upright, config.robots))
    if not any_upright or not (snapshot.window.observations or proved or earlier.pairs):
        pose_sets = PoseSets(of_moment=place_by_moment(snapshot, ()))
        return Recollection(snapshot, budget, clock, pose_sets=pose_sets, replaced=replaced)
    if budget.is_over():
        proved = ()
    newest_s = config.memory_s * WINDOW_SHARE
    pose_sets, forgotten = place_robots(snapshot, budget.has_passed, newest_s, earlier)
    spans_s = {pair: carried.span_s(pair) for pair in earlier.pairs.union(carried.tables)}
    snapshot = without(snapshot, forgotten)
    carried, doubtful = snapshot.carried, earlier.doubts.robots
    # The readings of now of a robot in doubt may be the wrong ones.
    of_moment = place_by_moment(snapshot, pose_sets.covers.keys() | doubtful)
    recalled = Recollection(
        snapshot,
        budget,
        clock,
        spans_s=spans_s,
        pose_sets=replace(pose_sets, of_moment=of_moment),
        replaced=replaced,
        forgotten=forgotten,
        in_doubt=tuple(config.robots[robot] for robot in sorted(doubtful)),
    )
    if config.dimension == 3:
        return replace(recalled, tilts={robot: carried.tilt(robot) for robot in pose_sets.covers})
    near = carried.near_pairs(MOST_PARTNERS, newest_s)
    # A chain begins when the youngest one has reached half its life.
    begins_s = snapshot.stamp_s - CHAIN_SHARE * chain_seconds(config)
    begins = all(one.since_s <= begins_s for one in proved)
    # A younger chain takes a step if its last one was before this time.
    after_s = snapshot.stamp_s - chain_seconds(config) / CHAIN_STEPS
    due = (*proved[:1], *(one for one in proved[1:] if one.stamp_s <= after_s))
    return replace(
        recalled,
        spans_s=spans_s | {pair: carried.span_s(pair, newest_s) for pair in near},
        readings={
            pair: carried.readings(pair, newest_s, most=MOST_OBSERVATIONS // (MOST_PARTNERS + 1))
            for pair in near
            if not pose_sets.covers.keys() >= {*pair} and doubtful.isdisjoint(pair)
        },
        chains=(
            *(CarriedPlacements(one, snapshot) for one in due),
            *([None] if begins else []),
        ),
        waiting=tuple(one for one in proved[1:] if one.stamp_s > after_s),
    )


@dataclass(frozen=True)
class NarrowedAnswer:
    """
    An answer narrowed by the window.

    Attributes
    ----------
    answer : Answer
    ruled_out : tuple of str
        One sentence per placement that is ruled out.
    forgotten : tuple of Forgotten
    proved : tuple of Proved
        Proved placements for later estimates, oldest chain first.

    """

    answer: Answer
    ruled_out: tuple[str, ...]
    forgotten: tuple[Forgotten, ...]
    proved: tuple[Proved, ...] = ()


def narrow_answer(found: Answer, recalled: Recollection, refit: Refit) -> NarrowedAnswer:
    """
    Narrow an answer by a window.

    `refit` finds new best points from the headings of the window. If the window rules out all
    hypotheses of a part, it contradicts the moment: the answer is returned unchanged. It is also
    returned unchanged if all listed placements of a part are ruled out and it has more
    hypotheses: that is no contradiction.
    """
    if recalled.empty:
        return NarrowedAnswer(found, (), recalled.forgotten)
    recalled.clock.resume()
    # The last part is the published one: it is narrowed before the separate groups.
    main_first = reversed(found.parts)
    parts = [(part, recalled.narrow(part.placements, part.plan.frame)) for part in main_first]
    parts.reverse()
    emptied = [part for part, left in parts if part.placements and not left.placements]
    if any(len(part.placements) < part.n_hypotheses for part in emptied):
        return NarrowedAnswer(found, (), recalled.forgotten)
    if emptied and any(recalled.chains):
        recalled.clock.pause()
        forgotten = recalled.forgetting(frozenset(), PROVED_CONTRADICTS)
        alone = replace(recalled, chains=(None,), waiting=(), forgotten=forgotten)
        return narrow_answer(found, alone, refit)
    if emptied:
        ends = ends_of(recalled.snapshot.config, recalled.spans_s)
        return NarrowedAnswer(found, (), recalled.forgetting(ends, CONTRADICTS_NOW))
    proved: tuple[Proved, ...] = ()
    if found.main is not None:
        chains = _what_is_proved(found.main, recalled, parts[-1][1])
        proved = tuple(sorted(chains, key=lambda one: one.since_s))
    kept = [part.leaving(_refitted(part.plan, left, recalled, refit)) for part, left in parts]
    return NarrowedAnswer(
        found.with_parts(kept),
        tuple(text for _, left in parts for text in left.ruled_out),
        recalled.forgotten,
        proved,
    )


def _refitted(
    plan: FramePlan, left: Remaining, recalled: Recollection, refit: Refit
) -> tuple[Placement, ...]:
    """Return the placements, with new best points if they are few and in the plane."""
    if recalled.snapshot.config.dimension == 3 or len(left.placements) > MOST_REFINED:
        return left.placements
    return tuple(refit(plan, placement) for placement in left.placements)


def _what_is_proved(found: Part, recalled: Recollection, oldest: Remaining) -> Iterator[Proved]:
    """
    Yield the proved placements of a part; `oldest` holds those narrowed by the oldest chain.

    Yield nothing if measurements contradict each other, or if the part uses the whole memory:
    later estimates must not depend on readings older than the memory.
    """
    listed, frame = found.placements, found.plan.frame
    complete = len(listed) == found.n_hypotheses and not any(p.dropped for p in listed)
    if not complete or recalled.forgotten or recalled.snapshot.config.dimension != 2:
        return
    if recalled.pose_sets.of_whole_memory:
        return
    yield from recalled.waiting
    stamp_s = recalled.snapshot.stamp_s
    for chain, carried in enumerate(recalled.chains):
        left = recalled.narrow(listed, frame, chain) if chain else oldest
        if left.placements:
            since_s = carried.since_s if carried else stamp_s
            yield Proved(left.placements, frame, stamp_s, since_s)


def _carried_on(
    placements: Sequence[Placement], frame: FixedFrame, carried: CarriedPlacements | None
) -> Remaining:
    """Return the placements that can continue an earlier estimate."""
    if carried is None:
        return Remaining(tuple(placements))

    def go_on(placement: Placement) -> Placement | str:
        bounds = carried.around(placement, frame)
        if bounds is None:
            return f'the estimate {carried.age_s:.1f} s ago'
        return within_bounds(placement, bounds)

    return sifted(placements, go_on)
