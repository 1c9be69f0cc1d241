# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a window says at the time of a snapshot, and what it leaves of an answer of the moment."""

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

PROVED_CONTRADICTS = 'what an earlier estimate proved contradicts what is measured now'
CONTRADICTS_NOW = 'what was measured before contradicts what is measured now'

MOST_LATE = 3.0
"""How many times the span may pass on the clock, where the processors are busy with other work."""

MOST_PARTNERS = 4
"""
Of each robot: near ones tell most of its heading, since errors of ranges grow with them. With all
of them and the anchors it has as many observations as are kept of one pair.
"""


CHAIN_SHARE = 0.5
"""Of the time that a chain of estimates counts: then the next begins, to be ready at its end."""

JOINT_RESOLUTION_M = 0.05
COARSE_BOXES, PROGRAM_BOXES = 32, 96
"""
Boxes of the poses of a few robots together: few to rule out what is impossible, more to bound
what is left where outliers are tolerated, and few with linear programs where not.
"""

MOST_REFINED = 16
"""Of more placements than these, the others get coarse headings only, and none a new best point:
none of them is the answer yet."""

Refit = Callable[[FramePlan, Placement], Placement]


class Allowance:
    """
    A span of processor time of this thread from now on, to be divided among tasks.

    On the clock other threads would use it up: what is left of a busy machine is needed. `cancel`
    ends the time when set.
    """

    def __init__(self, seconds: float, cancel: Cancel | None) -> None:
        self._cancel = cancel
        self._left_s, self._left_on_clock_s = seconds, MOST_LATE * seconds
        self.resume()

    def pause(self) -> None:
        """Let no time pass until `resume`."""
        self._left_s = max(0.0, self._end_s - time.thread_time())
        self._left_on_clock_s = max(0.0, self._end_on_clock_s - time.monotonic())

    def resume(self) -> None:
        """Go on where it was paused."""
        self._end_s = time.thread_time() + self._left_s
        self._end_on_clock_s = time.monotonic() + self._left_on_clock_s

    def part(self, tasks: int) -> Callable[[], bool]:
        """Return what tells the first of some tasks that its equal part of the rest is used up."""
        now_s = time.thread_time()
        end_s = now_s + max(0.0, self._end_s - now_s) / tasks

        def stopped() -> bool:
            cancelled = self._cancel is not None and self._cancel.is_set()
            late = time.monotonic() > self._end_on_clock_s
            return cancelled or late or time.thread_time() > end_s

        return stopped


@dataclass(frozen=True)
class Recollection:
    """
    A window, carried to the time of a snapshot.

    Attributes
    ----------
    snapshot : Snapshot
        Without what contradicts itself.
    allowance : Allowance
    readings : mapping of (int, int) to PairReadings
        What pairs of robots observed of each other.
    spans_s : mapping of (int, int) to float
        The age of the oldest observation that counts, the world and a robot included.
    pose_sets : PoseSets
    replaced : frozenset of LinkKey
        The links of the moment that the pose sets stand for: any of them may be an outlier.
    forgotten : tuple of Forgotten
        What contradicts itself.
    chains : tuple of CarriedPlacements, or None
        What the estimate before proved, the oldest chain first; None for one that begins now.
    tilts : mapping of int to Tilt
        Of the robots with pose sets, in space.
    in_doubt : tuple of str
        The robots of which nothing is said until newer measurements agree with the anchors.

    """

    snapshot: Snapshot
    allowance: Allowance
    readings: Mapping[Pair, PairReadings] = field(default_factory=dict)
    spans_s: Mapping[Pair, float] = field(default_factory=dict)
    pose_sets: PoseSets = NO_POSE_SETS
    replaced: frozenset[LinkKey] = frozenset()
    forgotten: tuple[Forgotten, ...] = ()
    chains: tuple[CarriedPlacements | None, ...] = (None,)
    tilts: Mapping[int, Tilt] = field(default_factory=dict)
    in_doubt: tuple[str, ...] = ()

    def without_pose_sets(self) -> Recollection:
        """Return this without the pose sets, which contradict the moment, and forget them."""
        ends = ends_of(self.snapshot.config, self.pose_sets.sets)
        forgotten = self.forgetting(ends, CONTRADICTS_NOW)
        return replace(self, pose_sets=NO_POSE_SETS, replaced=frozenset(), forgotten=forgotten)

    def forgetting(self, ends: frozenset[Ends], text: str) -> tuple[Forgotten, ...]:
        """Return what is forgotten, with all observations of some points."""
        return (*self.forgotten, Forgotten(ends, self.snapshot.stamp_s, text))

    @property
    def empty(self) -> bool:
        """Whether there is nothing to narrow placements with."""
        known = self.readings or self.pose_sets.sets or self.pose_sets.of_moment
        return not (known or any(self.chains))

    def narrow(
        self, placements: Sequence[Placement], frame: FixedFrame, chain: int = 0
    ) -> Remaining:
        """
        Return what the window and one chain of earlier estimates leave of placements in one frame.

        The chains after it have their shares of the time that is left.
        """
        config, sets = self.snapshot.config, self.pose_sets
        stopped = self.allowance.part(len(self.chains) - chain)

        def narrow(options: PairOptions, placement: Placement) -> Placement | str:
            if config.dimension == 3:
                found = narrow_in_space(placement, frame.kind, sets, self.tilts)
            else:
                found = narrow_in_plane(
                    placement, frame, config.robots, self.readings, sets, options, stopped
                )
            return found if isinstance(found, Placement) else self._over(found)

        coarse = PairOptions(config.window_outliers, JOINT_RESOLUTION_M, COARSE_BOXES)
        boxes = MOST_BOXES if config.window_outliers else COARSE_BOXES
        fine = replace(coarse, max_boxes=boxes, max_programs=PROGRAM_BOXES)
        left = _carried_on(placements, frame, self.chains[chain])
        sentences = left.ruled_out
        best, others = parted(left.placements, MOST_REFINED)
        if others:
            left = sifted(left.placements, partial(narrow, coarse))
            sentences += left.ruled_out
            best, others = parted(left.placements, MOST_REFINED)
        refined = sifted(best, partial(narrow, fine))
        return Remaining((*refined.placements, *others), sentences + refined.ruled_out)

    def _over(self, pair: Pair) -> str:
        """Return the name of a pair and for how long it has measured, if not just now."""
        first, second = pair
        robots = self.snapshot.config.robots
        names = f'{"anchors" if first == WORLD else robots[first]} - {robots[second]}'
        return f'{names} over {self.spans_s[pair]:.0f} s' if pair in self.spans_s else names


def recall(
    snapshot: Snapshot,
    proved: Sequence[Proved],
    cancel: Cancel | None,
    earlier: EarlierSets | None = None,
) -> Recollection:
    """
    Return what the window of a snapshot and earlier estimates say.

    In space that is where robots are among anchors, if their odometry is upright.
    """
    config, carried = snapshot.config, snapshot.carried
    allowance = Allowance(config.memory_max_seconds, cancel)
    # A pair of which nothing is remembered yet may begin with an outlier, too.
    tolerates = config.window_outliers > 0 and config.memory_s > 0.0
    replaced = carried.links_among(snapshot.keys) if tolerates else frozenset()
    any_upright = any(map(config.is_upright, config.robots))
    earlier = earlier or EarlierSets()
    if not any_upright or not (snapshot.window.observations or proved or earlier.pairs):
        pose_sets = PoseSets(of_moment=place_by_moment(snapshot, ()))
        return Recollection(snapshot, allowance, pose_sets=pose_sets, replaced=replaced)
    if allowance.part(1)():
        proved = ()
    newest_s = config.memory_s * WINDOW_SHARE
    pose_sets, forgotten = place_robots(snapshot, allowance.part, newest_s, earlier)
    spans_s = {pair: carried.span_s(pair) for pair in earlier.pairs.union(carried.tables)}
    snapshot = without(snapshot, forgotten)
    carried, doubtful = snapshot.carried, earlier.doubts.robots
    # What a robot in doubt measures now may be what is wrong.
    of_moment = place_by_moment(snapshot, pose_sets.covers.keys() | doubtful)
    recalled = Recollection(
        snapshot,
        allowance,
        spans_s=spans_s,
        pose_sets=replace(pose_sets, of_moment=of_moment),
        replaced=replaced,
        forgotten=forgotten,
        in_doubt=tuple(config.robots[robot] for robot in sorted(doubtful)),
    )
    if config.dimension == 3:
        return replace(recalled, tilts={robot: carried.tilt(robot) for robot in pose_sets.covers})
    near = carried.near_pairs(MOST_PARTNERS, newest_s)
    # A chain begins where the youngest is half as old.
    begins_s = snapshot.stamp_s - CHAIN_SHARE * chain_seconds(config)
    begins = all(one.since_s <= begins_s for one in proved)
    return replace(
        recalled,
        spans_s=spans_s | {pair: carried.span_s(pair, newest_s) for pair in near},
        readings={
            pair: carried.readings(pair, newest_s, most=MOST_OBSERVATIONS // (MOST_PARTNERS + 1))
            for pair in near
            if not pose_sets.covers.keys() >= {*pair} and doubtful.isdisjoint(pair)
        },
        chains=(
            *(CarriedPlacements(one, snapshot) for one in proved),
            *([None] if begins else []),
        ),
    )


@dataclass(frozen=True)
class NarrowedAnswer:
    """
    An answer after the window has been heard.

    Attributes
    ----------
    answer : Answer
    ruled_out : tuple of str
        A sentence on each placement that is left out.
    forgotten : tuple of Forgotten
    proved : tuple of Proved
        What it proves of later ones, the oldest chain first.

    """

    answer: Answer
    ruled_out: tuple[str, ...]
    forgotten: tuple[Forgotten, ...]
    proved: tuple[Proved, ...] = ()


def narrow_answer(found: Answer, recalled: Recollection, refit: Refit) -> NarrowedAnswer:
    """
    Return what a window leaves of an answer.

    `refit` finds best points by the headings that the window tells. Where the window leaves no
    placement at all, it contradicts the moment: the answer stays as it is. The same holds where
    none is left of those listed, and there are others: that is no contradiction.
    """
    if recalled.empty:
        return NarrowedAnswer(found, (), recalled.forgotten)
    recalled.allowance.resume()
    # What is published, the last part, comes before groups apart.
    main_first = reversed(found.parts)
    parts = [(part, recalled.narrow(part.placements, part.plan.frame)) for part in main_first]
    parts.reverse()
    emptied = [part for part, left in parts if part.placements and not left.placements]
    if any(len(part.placements) < part.n_hypotheses for part in emptied):
        return NarrowedAnswer(found, (), recalled.forgotten)
    if emptied and any(recalled.chains):
        recalled.allowance.pause()
        forgotten = recalled.forgetting(frozenset(), PROVED_CONTRADICTS)
        alone = replace(recalled, chains=(None,), forgotten=forgotten)
        return narrow_answer(found, alone, refit)
    if emptied:
        ends = ends_of(recalled.snapshot.config, recalled.spans_s)
        return NarrowedAnswer(found, (), recalled.forgetting(ends, CONTRADICTS_NOW))
    proved: tuple[Proved, ...] = ()
    if found.main is not None:
        proved = tuple(_what_is_proved(found.main, recalled, parts[-1][1]))
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
    """Return placements, in the plane with new best points where they are few."""
    if recalled.snapshot.config.dimension == 3 or len(left.placements) > MOST_REFINED:
        return left.placements
    return tuple(refit(plan, placement) for placement in left.placements)


def _what_is_proved(found: Part, recalled: Recollection, oldest: Remaining) -> Iterator[Proved]:
    """
    Yield what a part proves of later ones; `oldest` is what the oldest chain leaves of it.

    Nothing where measurements contradict, or where it rests on all of the memory: later ones may
    not rest on what is older.
    """
    listed, frame = found.placements, found.plan.frame
    complete = len(listed) == found.n_hypotheses and not any(p.dropped for p in listed)
    if not complete or recalled.forgotten or recalled.snapshot.config.dimension != 2:
        return
    if recalled.pose_sets.of_whole_memory:
        return
    for chain, carried in enumerate(recalled.chains):
        left = recalled.narrow(listed, frame, chain) if chain else oldest
        if left.placements:
            since_s = recalled.snapshot.stamp_s if carried is None else carried.since_s
            yield Proved(left.placements, frame, recalled.snapshot.stamp_s, since_s)


def _carried_on(
    placements: Sequence[Placement], frame: FixedFrame, carried: CarriedPlacements | None
) -> Remaining:
    """Return the placements that can go on from an earlier estimate."""
    if carried is None:
        return Remaining(tuple(placements))

    def go_on(placement: Placement) -> Placement | str:
        bounds = carried.around(placement, frame)
        if bounds is None:
            return f'the estimate {carried.age_s:.1f} s ago'
        return within_bounds(placement, bounds)

    return sifted(placements, go_on)
