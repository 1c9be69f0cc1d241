# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Which wrong readings of a window are named, where redundancy allows it; docs/wrong_readings.md.

    python -m benchmarks.culprits [--runs 10] [--first 0] [--robots 6 9] [--wrong 1 2 5]

The fleets and lies are those of `benchmarks.liars window`, with all time for the suspects. These
are found pair by pair, so the pairs that lie are looked at alone. Redundancy does not allow to
name a lie where some motion of the two robots within the bounds of their odometries agrees with
it and with all readings of the pair that are right: then the other lies of the pair explain
everything (`benchmarks.other_motions`). What no such motion is found for counts as redundant.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
import math

import numpy as np
from numpy.typing import NDArray

from benchmarks.fleet_in_time import ODOMETRY_ERROR, START_S, driving_config
from benchmarks.liars import GRAPHS, LIES, Case, Pair
from benchmarks.other_motions import RangedPair, Way
from benchmarks.pairs import STEP_S, SimulatedRobot, rotation
from dg_localization.fleet import Snapshot
from dg_localization.fleet.contradictions.window_suspects import (
    explain_window,
    suspects_in_window,
)
from dg_localization.fleet.error_models import distance_bounds_m
from dg_localization.fleet.window.pose_sets import MOST_BOXES, RESOLUTION_M, PoseSets
from dg_localization.pairs import Cover, PairOptions, cover_poses

FloatArray = NDArray[np.float64]

STARTS = 20
"""Poses that a search for another motion starts from, besides the true motion."""
STARTS_OF_NAMED = 1
"""The same for a lie that is named, where little is expected."""

LEAST_BEYOND_M = (0.0, 0.25, 0.5, 1.0)


@dataclass(frozen=True)
class Culprit:
    """
    A lie that is outside the bounds of its error.

    Parameters
    ----------
    beyond_m : float
        By how much.
    lies : int
        Of its pair.
    is_shown : bool
        Whether the pose set of its pair makes it suspect.
    is_named : bool
        Whether it is among the suspects.
    suspects : int
        Of its pair.
    redundant : bool
        Whether no other motion is found that agrees with it and with all that is right.

    """

    beyond_m: float
    lies: int
    is_shown: bool
    is_named: bool
    suspects: int
    redundant: bool


def culprits_of(case: Case, outliers: int) -> Iterator[Culprit]:
    """Yield the culprits of a case, with so many outliers tolerated."""
    localizer, now_s = case.told(outliers)
    snapshot = localizer.snapshot(now_s)
    unlimited = replace(
        snapshot.config,
        memory_max_seconds=math.inf,
        max_conflict_solves=10_000,
        max_conflict_seconds=math.inf,
    )
    snapshot = replace(snapshot, config=unlimited)
    for pair in sorted({pair for _, pair in case.wrong}):
        cover, shown, named = suspects_of(snapshot, pair)
        steps = sorted(step for step, other in case.ranges_m if other == pair)
        wrong = {step for step, other in case.wrong if other == pair}
        ranged = ranged_pair(case, pair, steps)
        for step in sorted(wrong):
            beyond_m, lies = case.redundancy((step, pair))
            count = STARTS_OF_NAMED if step in named else STARTS
            others = motions_in(case, pair, ranged, cover, count)
            starts = [true_motion(case, pair, ranged), *others]
            obeyed = np.array([other not in wrong or other == step for other in steps])
            other_motion = ranged.find_motion(starts, obeyed)
            yield Culprit(
                beyond_m, lies, step in shown, step in named, len(named), other_motion is None
            )


def suspects_of(snapshot: Snapshot, pair: Pair) -> tuple[Cover, set[int], set[int]]:
    """Return where two robots have each other, and the steps of suspects by that and of all."""
    carried = snapshot.carried
    options = PairOptions(snapshot.config.window_outliers, RESOLUTION_M, MOST_BOXES)
    cover = cover_poses(carried.readings_on_tracks(pair), options).moved(*carried.tracks(pair))
    pose_sets = PoseSets(relative={pair: cover})
    shown = suspects_in_window(snapshot, pose_sets, lambda: False)
    explained = explain_window(snapshot, shown, lambda: False)
    by_poses, by_ranges = (
        {round((one.stamp_s - START_S) / STEP_S) for one in found[pair]}
        for found in (shown, explained)
    )
    return cover, by_poses, by_ranges


def ranged_pair(case: Case, pair: Pair, steps: list[int]) -> RangedPair:
    """Return the motions and ranges of two robots."""
    at = np.array(steps)
    model = driving_config(2, 1.0).range_error
    bounds_m = np.array([distance_bounds_m(model, case.ranges_m[step, pair]) for step in steps])
    first, second = (
        Way.of(member.stated_m, member.stated_rad, ODOMETRY_ERROR, at)
        for member in (case.members[robot] for robot in pair)
    )
    return RangedPair(first, second, at, bounds_m[:, 0], bounds_m[:, 1])


def true_motion(case: Case, pair: Pair, ranged: RangedPair) -> FloatArray:
    """Return how two robots truly moved, as near to it as the errors of their odometries allow."""
    first, second = (case.members[robot] for robot in pair)
    at = ranged.at
    turn_rad = float(first.stated_rad[at[0]] - first.yaws_rad[at[0]])
    between_m = (second.positions_m - first.positions_m)[at] @ rotation(turn_rad).T
    stated_rad = second.yaws_rad[at[0]] + turn_rad - second.stated_rad[at[0]]
    shares = [_share(first, ranged.first, at), _share(second, ranged.second, at)]
    motion = np.concatenate([between_m[0, :2], [stated_rad], *shares, np.zeros(2 * ranged.groups)])
    off_m = np.diff(between_m[:, :2] - ranged.places_m(motion), axis=0)
    lengths_m = np.maximum(np.linalg.norm(off_m, axis=-1), 1e-12)
    off_m *= np.minimum(1.0, ranged.inner_m / lengths_m)[:, None]
    motion[-off_m.size :] = off_m.ravel()
    return motion


def _share(robot: SimulatedRobot, way: Way, at: NDArray[np.intp]) -> FloatArray:
    """Return by which share of their bounds the turns of a robot err between ranges."""
    off_rad = np.diff((robot.yaws_rad - robot.stated_rad)[at])
    most_rad = np.maximum(way.turns_rad.sum(axis=0), 1e-12)
    return np.clip(off_rad / most_rad, -1.0, 1.0)


def motions_in(
    case: Case, pair: Pair, ranged: RangedPair, cover: Cover, count: int
) -> Iterator[FloatArray]:
    """Yield motions as odometry states them to poses far from each other in a cover of now."""
    first, second = (case.members[robot] for robot in pair)
    start = ranged.at[0]
    for x_m, y_m, yaw_rad in _far_apart(cover, count):
        turn_rad = first.stated_rad[-1]
        stated_rad = turn_rad + yaw_rad - second.stated_rad[-1]
        now_m = rotation(turn_rad) @ [x_m, y_m, 0.0]
        way_a_m = first.stated_m[-1] - first.stated_m[start]
        way_b_m = rotation(stated_rad) @ (second.stated_m[-1] - second.stated_m[start])
        then_m = (now_m - way_b_m + way_a_m)[:2]
        yield np.concatenate([then_m, [stated_rad], np.zeros(4 * ranged.groups)])


def _far_apart(cover: Cover, count: int) -> FloatArray:
    """Return x, y and yaw of middles of boxes, each far from those before it."""
    middles = cover.boxes.mean(axis=1)
    x, y, yaws_rad = middles[:, 0], middles[:, 1], middles[:, 3]
    compared = np.stack([x, y, 2.0 * np.cos(yaws_rad), 2.0 * np.sin(yaws_rad)], axis=-1)
    chosen = [0]
    apart = np.full(len(middles), math.inf)
    for _ in range(min(count, len(middles)) - 1):
        apart = np.minimum(apart, np.linalg.norm(compared - compared[chosen[-1]], axis=-1))
        chosen.append(int(np.argmax(apart)))
    return np.stack([x, y, yaws_rad], axis=-1)[chosen]


@dataclass
class Tally:
    """Culprits, counted."""

    culprits: int = 0
    named: int = 0
    redundant: int = 0
    redundant_shown: int = 0
    redundant_named: int = 0
    suspects: int = 0

    def add(self, culprit: Culprit) -> None:
        """Count a culprit."""
        self.culprits += 1
        self.named += culprit.is_named
        self.redundant += culprit.redundant
        self.redundant_shown += culprit.redundant and culprit.is_shown
        self.redundant_named += culprit.redundant and culprit.is_named
        self.suspects += culprit.suspects

    def row(self) -> str:
        """Return the figures as cells of a table."""
        share = self.redundant_named / max(1, self.redundant)
        return (
            f'{self.culprits} | {self.named} | {self.culprits - self.redundant} | '
            f'{self.redundant_shown} | '
            f'{self.redundant_named} of {self.redundant} ({share:.1%}) | '
            f'{self.suspects / max(1, self.culprits):.1f} |'
        )


HEADER = (
    'culprits | named | not redundant | named where redundant, by pose sets | and by ranges | '
    'suspects of the pair |'
)


def report(seeds: range, robots: list[int], wrong: list[int]) -> None:
    """Print which culprits are named, by fleets and lies, and by what the pair is told."""
    by_fleet: dict[tuple[str, str, int], Tally] = defaultdict(Tally)
    by_size: dict[tuple[str, str, float], Tally] = defaultdict(Tally)
    everybody = Tally()
    for seed, graph, kind, count, k in product(seeds, GRAPHS, LIES, robots, wrong):
        case = Case.draw([seed, count, k], graph, kind, count, k)
        for culprit in culprits_of(case, k):
            size = np.searchsorted(LEAST_BEYOND_M, culprit.beyond_m, side='right') - 1
            few = '1 or 2' if k <= 2 else str(k)
            lies = '3 or more' if culprit.lies > 2 else str(culprit.lies)
            by_fleet[graph, kind, k].add(culprit)
            by_size[few, lies, LEAST_BEYOND_M[size]].add(culprit)
            everybody.add(culprit)
            if culprit.redundant and not culprit.is_named:
                print(f'missed: seed {seed}, {graph}, {kind}, {count} robots, k {k}: {culprit}')
    print(f'| graph | lies | k | {HEADER}\n|{"---|" * 9}')
    for fleet, tally in by_fleet.items():
        print(f'| {" | ".join(map(str, fleet))} | {tally.row()}')
    print(f'\n| k | lies of the pair | beyond the bound (m) | {HEADER}\n|{"---|" * 9}')
    for told, tally in sorted(by_size.items()):
        print(f'| {" | ".join(map(str, told))} | {tally.row()}')
    print(f'\n| {HEADER}\n|{"---|" * 6}\n| {everybody.row()}')


def main() -> None:
    """Read the command line and print the tables."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.culprits', description=__doc__)
    parser.add_argument('--runs', type=int, default=10)
    parser.add_argument('--first', type=int, default=0, metavar='SEED')
    parser.add_argument('--robots', type=int, nargs='+', default=[6, 9])
    parser.add_argument('--wrong', type=int, nargs='+', default=[1, 2, 5])
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.runs)
    report(seeds, arguments.robots, arguments.wrong)


if __name__ == '__main__':
    main()
