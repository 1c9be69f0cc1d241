# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a window says at the time of a snapshot, and what it leaves of an answer of the moment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.estimate import FixedFrame, Placement
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.fleet.window.allowance import Allowance
from dg_localization.fleet.window.carry import WORLD, Pair, Tilt
from dg_localization.fleet.window.earlier_sets import EarlierSets
from dg_localization.fleet.window.forgetting import Forgotten, ends_between, without
from dg_localization.fleet.window.in_space import narrow_in_space
from dg_localization.fleet.window.memory import Ends
from dg_localization.fleet.window.pose_sets import (
    NO_POSE_SETS,
    PoseSets,
    place_by_moment,
    place_robots,
)
from dg_localization.fleet.window.proved import CarriedPlacements, Proved
from dg_localization.fleet.window.shape_headings import (
    narrow_placement,
    within_bounds,
)
from dg_localization.fleet.window.sifting import Left, parted, sifted
from dg_localization.poses import PairOptions, PairReadings
from dg_localization.solver.options import Cancel

PROVED_CONTRADICTS = 'what an earlier estimate proved contradicts what is measured now'
CONTRADICTS_NOW = 'what was measured before contradicts what is measured now'

MOST_PARTNERS = 4
"""Of each robot: near ones tell most of its heading, since errors of ranges grow with them."""

MOST_IN_TABLE = 40
MOST_IN_TABLES = 225
"""
Observations of a pair, and of all, that narrow headings: a pair has more of them where pairs are
few. More cost time and tell little more.
"""

WINDOW_SHARE = 0.5
"""
Of the memory, for what robots measured of each other. An estimate proves something of the next
one for the rest of it: nothing older than the memory has any effect.
"""

CHAIN_SHARE = 0.5
"""Of the time that a chain of estimates counts: then the next begins, to be ready at its end."""

JOINT_RESOLUTION_M = 0.05
COARSE_BOXES, FINE_BOXES, PROGRAM_BOXES = 32, 1000, 96
"""
Boxes of the poses of a few robots together: few to rule out what is impossible, more to bound
what is left where outliers are tolerated, and few with linear programs where not.
"""

MOST_REFINED = 16
"""Of more placements than these, the others get coarse headings only."""


@dataclass(frozen=True)
class Recollection:
    """
    A window, carried to the time of a snapshot.

    Parameters
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

    @property
    def config(self) -> FleetConfig:
        """The configuration of the snapshot."""
        return self.snapshot.config

    @property
    def stamp_s(self) -> float:
        """The time of the snapshot."""
        return self.snapshot.stamp_s

    def without_pose_sets(self) -> Recollection:
        """Return this without the pose sets, which contradict the moment, and forget them."""
        ends = _ends_of(self.config, [(WORLD, robot) for robot in self.pose_sets.covers])
        ends |= _ends_of(self.config, self.pose_sets.relative)
        forgotten = (*self.forgotten, Forgotten(ends, self.stamp_s, CONTRADICTS_NOW))
        return replace(self, pose_sets=NO_POSE_SETS, replaced=frozenset(), forgotten=forgotten)

    def without_chains(self) -> Recollection:
        """Return this without what an earlier estimate proved, which contradicts the moment."""
        forgotten = (*self.forgotten, Forgotten(frozenset(), self.stamp_s, PROVED_CONTRADICTS))
        return replace(self, chains=(None,), forgotten=forgotten)

    def without_anything(self) -> tuple[Forgotten, ...]:
        """Return what is forgotten where the window leaves no placement of the moment."""
        ends = _ends_of(self.config, self.spans_s)
        return (*self.forgotten, Forgotten(ends, self.stamp_s, CONTRADICTS_NOW))

    @property
    def empty(self) -> bool:
        """Whether there is nothing to narrow placements with."""
        known = self.readings or self.pose_sets.any or self.pose_sets.of_moment
        return not (known or any(self.chains))

    def narrow(self, placements: Sequence[Placement], frame: FixedFrame, chain: int = 0) -> Left:
        """
        Return what the window and an earlier estimate leave of placements in one frame.

        Parameters
        ----------
        placements : sequence of Placement
        frame : FixedFrame
        chain : int
            Which one of the chains; those after it have their shares of the time that is left.

        Returns
        -------
        Left

        """
        if self.config.dimension == 3:
            return self._narrowed_in_space(placements, frame)
        stopped = self.allowance.part(len(self.chains) - chain)
        gone_on = _carried_on(placements, frame, self.chains[chain])
        outliers = self.config.window_outliers
        most, others = parted(gone_on.placements, MOST_REFINED)
        sentences = gone_on.ruled_out
        if others:
            coarse = PairOptions(outliers, JOINT_RESOLUTION_M, COARSE_BOXES)
            possible = self._tried(gone_on.placements, frame, coarse, stopped)
            most, others = parted(possible.placements, MOST_REFINED)
            sentences += possible.ruled_out
        boxes = FINE_BOXES if outliers else COARSE_BOXES
        options = PairOptions(outliers, JOINT_RESOLUTION_M, boxes, PROGRAM_BOXES)
        refined = self._tried(most, frame, options, stopped)
        return Left((*refined.placements, *others), sentences + refined.ruled_out)

    def _narrowed_in_space(self, placements: Sequence[Placement], frame: FixedFrame) -> Left:
        """Return the placements of robots among anchors; others are left as they are."""

        def narrow(placement: Placement) -> tuple[Placement | None, str]:
            narrowed = narrow_in_space(placement, frame.kind, self.pose_sets, self.tilts)
            pair = narrowed.ruled_out_by
            return narrowed.placement, '' if pair is None else self._over(pair)

        return sifted(placements, narrow)

    def _tried(
        self,
        placements: Sequence[Placement],
        frame: FixedFrame,
        options: PairOptions,
        stopped: Callable[[], bool],
    ) -> Left:
        """Return placements narrowed, those that are impossible left out."""
        robots = self.config.robots

        def narrow(placement: Placement) -> tuple[Placement | None, str]:
            narrowed = narrow_placement(
                placement,
                frame,
                robots,
                self.readings,
                self.pose_sets,
                options,
                stopped,
            )
            pair = narrowed.ruled_out_by
            return narrowed.placement, '' if pair is None else self._over(pair)

        return sifted(placements, narrow)

    def _over(self, pair: Pair) -> str:
        """Return the name of a pair and for how long it has measured."""
        first, second = pair
        robots = self.config.robots
        names = f'{"anchors" if first == WORLD else robots[first]} - {robots[second]}'
        return f'{names} over {self.spans_s[pair]:.0f} s'


def _carried_on(
    placements: Sequence[Placement], frame: FixedFrame, carried: CarriedPlacements | None
) -> Left:
    """Return the placements that can go on from an earlier estimate."""
    if carried is None:
        return Left(tuple(placements), ())

    def go_on(placement: Placement) -> tuple[Placement | None, str]:
        bounds = carried.around(placement, frame)
        if bounds is None:
            return None, f'the estimate {carried.age_s:.1f} s ago'
        return within_bounds(placement, bounds), ''

    return sifted(placements, go_on)


def _ends_of(config: FleetConfig, pairs: Iterable[Pair]) -> frozenset[Ends]:
    """Return the points that pairs of bodies observe each other by."""
    robots = config.robots
    found: frozenset[Ends] = frozenset()
    for first, second in pairs:
        others = config.anchors if first == WORLD else (robots[first],)
        found |= ends_between(config, robots[second], others)
    return found


def chain_seconds(config: FleetConfig) -> float:
    """Return for how long an estimate proves something of later ones."""
    return (1.0 - WINDOW_SHARE) * config.memory_s


def _chains(snapshot: Snapshot, proved: Sequence[Proved]) -> tuple[CarriedPlacements | None, ...]:
    """Return what was proved, carried on; a chain begins where the youngest is half as old."""
    begins_s = snapshot.stamp_s - CHAIN_SHARE * chain_seconds(snapshot.config)
    begins = all(one.since_s <= begins_s for one in proved)
    chains = [CarriedPlacements(one, snapshot) for one in proved]
    return (*chains, None) if begins else tuple(chains)


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
    pose_sets, forgotten = place_robots(snapshot, carried, allowance, newest_s, earlier)
    spans_s = {pair: carried.span_s(pair) for pair in earlier.pairs.union(carried.pairs)}
    snapshot = without(snapshot, forgotten)
    carried = snapshot.carried
    # What a robot in doubt measures now may be what is wrong.
    placed = pose_sets.covers.keys() | earlier.doubts.robots
    pose_sets = replace(pose_sets, of_moment=place_by_moment(snapshot, placed))
    recalled = Recollection(
        snapshot,
        allowance,
        spans_s=spans_s,
        pose_sets=pose_sets,
        replaced=replaced,
        forgotten=forgotten,
        in_doubt=tuple(config.robots[robot] for robot in sorted(earlier.doubts.robots)),
    )
    if config.dimension == 3:
        return replace(recalled, tilts={robot: carried.tilt(robot) for robot in pose_sets.covers})
    near = carried.near_pairs(MOST_PARTNERS, newest_s)
    most = max(MOST_IN_TABLE, MOST_IN_TABLES // max(1, len(near)))
    return replace(
        recalled,
        spans_s=spans_s | {pair: carried.span_s(pair, newest_s) for pair in near},
        readings={
            pair: carried.readings(pair, most, newest_s)
            for pair in near
            if not pose_sets.covers.keys() >= {*pair} and earlier.doubts.robots.isdisjoint(pair)
        },
        chains=_chains(snapshot, proved),
    )
