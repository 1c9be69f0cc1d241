# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Wrong readings: whether the truth is in the answer, and whether culprits are named.

    python -m benchmarks.liars window [--runs 10] [--robots 6 9] [--wrong 1 2 5]
    python -m benchmarks.liars landmarks [--runs 20]
    python -m benchmarks.liars mrclam [--data ../shared/data/mrclam]

Simulated robots drive in a square of 10 m and range each other to 3 %. Some readings lie by 1 to
4 m. Every seed counts.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product
import math
from pathlib import Path
import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.fleet_in_time import (
    ODOMETRY_ERROR,
    RANGE_ERROR,
    START_S,
    Event,
    Excerpt,
    answers,
    driving_config,
    feed_odometry,
    holds,
    mrclam_config,
    ticks_s,
    truth_in_frame,
)
from benchmarks.robots import (
    BEARING_ERROR_RAD,
    RANGE_ERROR as SEEN_RANGE_ERROR,
    STEP_S,
    SimulatedRobot,
)
from dg_localization import SolverOptions, Verdict
from dg_localization.fleet import (
    Anchor,
    Estimate,
    FixedFrame,
    FleetConfig,
    Localizer,
    RangeErrorModel,
)

FloatArray = NDArray[np.float64]
Pair = tuple[int, int]
Lie = tuple[int, Pair]
"""A step, and who is ranged then."""

SECONDS = 5.0
EVERY = round(0.3 / STEP_S)
"""A range of each measured pair every 0.3 s."""
MEMORY_MAX_SECONDS = 1.0
MOST_PLACEMENTS = 2000
GRAPHS = ('hinged', 'sparse', 'full')
LIES = ('agreeing', 'in a row', 'scattered')


def pairs_of(graph: str, places: FloatArray) -> list[Pair]:
    """
    Return who ranges whom.

    A hinged fleet is two full ones that share a robot; in a sparse one each robot ranges its three
    nearest.
    """
    count = len(places)
    everybody = list(combinations(range(count), 2))
    if graph == 'full':
        return everybody
    if graph == 'hinged':
        joint = count // 2
        return [(i, j) for i, j in everybody if j <= joint or i >= joint]
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    near = [set(np.argsort(row)[1:4].tolist()) for row in apart]
    return [(i, j) for i, j in everybody if j in near[i] or i in near[j]]


@dataclass
class Case:
    """A simulated fleet, what it measures, and which of that is wrong."""

    members: list[SimulatedRobot]
    pairs: list[Pair]
    ranges_m: dict[Lie, float]
    lies: list[Lie]

    @classmethod
    def draw(cls, seed: Sequence[int], graph: str, kind: str, robots: int, wrong: int) -> Case:
        """Return the case of a seed."""
        rng = np.random.default_rng(seed)
        members = [SimulatedRobot.drive(rng, SECONDS, ODOMETRY_ERROR) for _robot in range(robots)]
        steps = range(0, round(SECONDS / STEP_S) + 1, EVERY)
        pairs = pairs_of(graph, np.array([member.positions_m[-1] for member in members]))
        case = cls(members, pairs, {}, [])
        for step, pair in product(steps, pairs):
            error = rng.uniform(-RANGE_ERROR, RANGE_ERROR)
            case.ranges_m[step, pair] = case.apart_m(step, pair) / (1.0 + error)
        case.lie(rng, kind, list(steps), wrong)
        return case

    def apart_m(self, step: int, pair: Pair) -> float:
        """Return the true distance of two robots."""
        first, second = (self.members[robot].positions_m[step] for robot in pair)
        return float(np.linalg.norm(second - first))

    def lie(self, rng: np.random.Generator, kind: str, steps: list[int], wrong: int) -> None:
        """
        Make some readings wrong.

        Liars in a row are those of one pair that follow each other, off by the same. Liars that
        agree are of one time and one robot, as if it were at another place; where it has too few
        partners, they go on at the next time.
        """
        off_m = rng.uniform(1.0, 4.0) * rng.choice([-1.0, 1.0])
        if kind == 'scattered':
            chosen = rng.choice(len(self.ranges_m), wrong, replace=False)
            self.lies = [list(self.ranges_m)[index] for index in chosen]
        elif kind == 'in a row':
            pair = self.pairs[rng.integers(len(self.pairs))]
            first = rng.integers(len(steps) - wrong + 1)
            self.lies = [(step, pair) for step in steps[first : first + wrong]]
        else:
            robot = int(rng.integers(len(self.members)))
            own = [pair for pair in self.pairs if robot in pair]
            first = rng.integers(len(steps) - wrong + 1)
            self.lies = list(product(steps[first:], own))[:wrong]
            angle = rng.uniform(-math.pi, math.pi)
            elsewhere = abs(off_m) * np.array([math.cos(angle), math.sin(angle), 0.0])
        for step, pair in self.lies:
            if kind == 'agreeing':
                other = pair[0] + pair[1] - robot
                place = self.members[robot].positions_m[step] + elsewhere
                apart_m = self.members[other].positions_m[step] - place
                reading = float(np.linalg.norm(apart_m))
            else:
                each = rng.uniform(1.0, 4.0) if kind == 'scattered' else abs(off_m)
                reading = self.ranges_m[step, pair] + math.copysign(each, off_m)
            self.ranges_m[step, pair] = max(0.05, reading)

    @property
    def wrong(self) -> set[Lie]:
        """The lies that are outside the bounds of the error: others are none."""
        return {
            lie
            for lie in self.lies
            if abs(self.apart_m(*lie) / self.ranges_m[lie] - 1.0) > RANGE_ERROR
        }

    def redundancy(self, lie: Lie) -> tuple[float, int]:
        """Return by how much a lie is beyond its bound in m, and how many lies its pair tells."""
        apart_m, range_m = self.apart_m(*lie), self.ranges_m[lie]
        beyond_m = abs(apart_m - range_m) - RANGE_ERROR * range_m
        return beyond_m, sum(other[1] == lie[1] for other in self.wrong)

    def localize(self, outliers: int) -> tuple[Estimate, float]:
        """Return the answer at the end, with so many outliers, and what it took in s."""
        localizer, now_s = self.told(outliers)
        snapshot = localizer.snapshot(now_s)
        start_s = time.process_time()
        estimate = localizer.estimate(snapshot)
        return estimate, time.process_time() - start_s

    def told(self, outliers: int) -> tuple[Localizer, float]:
        """Return a localizer that was told all of it, with so many outliers, and the time then."""
        config = replace(
            driving_config(len(self.members), 2.0 * SECONDS),
            memory_max_seconds=MEMORY_MAX_SECONDS,
            window_outliers=outliers,
            max_hypotheses=MOST_PLACEMENTS,
            solver=SolverOptions(max_boxes=500),
        )
        localizer = Localizer(config)
        for step in range(round(SECONDS / STEP_S) + 1):
            now_s = START_S + step * STEP_S
            feed_odometry(localizer, self.members, step, now_s)
            for i, j in self.pairs:
                if (step, (i, j)) in self.ranges_m:
                    range_m = self.ranges_m[step, (i, j)]
                    localizer.add_range(f'r{i}', f'r{j}', range_m, now_s, now_s)
        return localizer, now_s

    def truth_is_in(self, estimate: Estimate) -> bool:
        """Return whether some placement holds the truth."""
        if estimate.frame is None or len(estimate.frame.points) < 2:
            return estimate.verdict is not Verdict.INFEASIBLE
        truth = self.truth(estimate.frame)
        return any(holds(placement, *truth) for placement in estimate.placements)

    def truth(self, frame: FixedFrame) -> tuple[FloatArray, FloatArray]:
        """Return positions (n, 2) and yaws (n,) at the end, in the frame of an estimate."""
        origin, towards = (int(name[1:]) for name in frame.points)
        return truth_in_frame(self.members, -1, origin, towards)


@dataclass
class Tally:
    """Figures of many runs."""

    runs: int = 0
    inside: int = 0
    wrong: int = 0
    named: int = 0
    suspects: list[int] = field(default_factory=list)
    detections: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


def window_tally(seeds: range, graph: str, kind: str, robots: int, wrong: int) -> Tally:
    """Return how fleets stand wrong readings in a window that tolerates as many."""
    tally = Tally()
    for seed in seeds:
        case = Case.draw([seed, robots, wrong], graph, kind, robots, wrong)
        estimate, seconds = case.localize(wrong)
        tally.runs += 1
        tally.inside += case.truth_is_in(estimate)
        tally.seconds.append(seconds)
    return tally


def report_window(seeds: range, robots: list[int], wrong: list[int]) -> None:
    """Print how fleets stand wrong readings in a window that tolerates as many."""
    print('| graph | lies | robots | k | truth inside | s (95 %) |\n|---|---|---|---|---|---|')
    for graph, kind, count, k in product(GRAPHS, LIES, robots, wrong):
        tally = window_tally(seeds, graph, kind, count, k)
        fast, slow = np.percentile(tally.seconds, [50, 95])
        print(
            f'| {graph} | {kind} | {count} | {k} | {tally.inside} of {tally.runs} '
            f'| {fast:.2f} ({slow:.2f}) |',
            flush=True,
        )


REACHES_M = (4.0, 6.0, math.inf)


def landmarks_tally(runs: int, reach_m: float, wrong: int, most: int) -> Tally:
    """Return what the search for the cause finds with five robots among 15 landmarks."""
    tally = Tally()
    for seed in range(runs):
        scene = Landmarks(seed, reach_m, wrong, most)
        start_s = time.process_time()
        estimate = scene.localizer.step(START_S)
        tally.seconds.append(time.process_time() - start_s)
        named = {
            pair
            for pair in scene.pairs
            for one in estimate.suspects
            if (one.target and (one.name, one.target) == pair)
            or (not one.target and one.name in pair)
        }
        tally.runs += 1
        tally.inside += scene.truth_is_in(estimate)
        tally.wrong += wrong
        tally.named += len(set(scene.liars) & named)
        tally.suspects.append(len(named))
        tally.detections.append(len(scene.pairs))
    return tally


def report_landmarks(runs: int) -> None:
    """Print how long the search for the cause takes with five robots among 15 landmarks."""
    print(
        '| reach (m) | detections | k wrong | dropped at most | truth inside | culprits among the '
        'suspects | suspects | s (95 %) | longest |\n|---|---|---|---|---|---|---|---|---|'
    )
    for reach_m, wrong, most in product(REACHES_M, (1, 2), (0, 1, 2)):
        tally = landmarks_tally(runs, reach_m, wrong, most)
        inside = f'{tally.inside} of {runs}' if most >= wrong else ''
        fast, slow = np.percentile(tally.seconds, [50, 95])
        print(
            f'| {reach_m:g} | {np.median(tally.detections):.0f} | {wrong} | {most} | {inside} '
            f'| {tally.named} of {tally.wrong} | {np.mean(tally.suspects):.1f} '
            f'| {fast:.2f} ({slow:.2f}) | {max(tally.seconds):.2f} |',
            flush=True,
        )


class Landmarks:
    """Five robots among 15 landmarks that see each other and these, some detections wrong."""

    def __init__(self, seed: int, reach_m: float, wrong: int, max_outliers: int) -> None:
        rng = np.random.default_rng(seed)
        self.robots = tuple(f'r{i}' for i in range(5))
        names = [*self.robots, *(f'l{i}' for i in range(15))]
        self.places = {name: rng.uniform(-6.0, 6.0, 2) for name in names}
        yaws = {name: rng.uniform(-math.pi, math.pi) for name in self.robots}
        config = FleetConfig(
            robots=self.robots,
            anchors={name: Anchor(tuple(self.places[name])) for name in names[5:]},
            range_error=RangeErrorModel(min_error_relative=-0.15, max_error_relative=0.15),
            bearing_half_width_rad=0.12,
            max_speed_m_s=0.0,
            max_outliers=max_outliers,
            max_conflict_solves=10_000,
            max_conflict_seconds=math.inf,
        )
        self.localizer = Localizer(config)
        self.pairs = [
            (a, b)
            for a, b in product(self.robots, names)
            if a != b and np.linalg.norm(self.places[b] - self.places[a]) < reach_m
        ]
        chosen = rng.choice(len(self.pairs), wrong, replace=False)
        self.liars = [self.pairs[index] for index in chosen]
        for a, b in self.pairs:
            way = self.places[b] - self.places[a]
            range_m = float(np.linalg.norm(way)) * rng.uniform(0.9, 1.1)
            angle = math.atan2(way[1], way[0]) - yaws[a] + rng.uniform(-0.1, 0.1)
            if (a, b) in self.liars:
                range_m = max(0.1, range_m + rng.choice([-4.0, 4.0]))
                angle += 1.5
            ray = [math.cos(angle), math.sin(angle), 0.0]
            self.localizer.add_range(a, b, range_m, START_S, START_S)
            self.localizer.add_bearing(a, b, ray, START_S, START_S)

    def truth_is_in(self, estimate: Estimate) -> bool:
        """Return whether some placement holds the true positions."""
        truth = np.array([self.places[name] for name in self.robots])
        return any(
            np.all((p.enclosure_m[:, 0] - 1e-9 <= truth) & (truth <= p.enclosure_m[:, 1] + 1e-9))
            for p in estimate.placements
        )


def report_mrclam(folder: Path, outliers: int, memory_s: float, tick_s: float) -> None:
    """Print which readings of the recording are wrong by its ground truth, and named as such."""
    excerpt = Excerpt(folder)
    named: set[tuple[str, str, float]] = set()
    ticks = inside = 0
    last_s = 0.0
    config = mrclam_config(excerpt, outliers, memory_s)
    for now_s, estimate, _ in answers(excerpt, config, ticks_s(excerpt, tick_s)):
        places, yaws = excerpt.truth(now_s)
        ticks += 1
        last_s = now_s
        inside += any(holds(placement, places, yaws) for placement in estimate.placements)
        named |= {(one.name, one.target, one.stamp_s) for one in estimate.suspects_in_window}
    truth_off = {
        (event.robot, event.target, event.stamp_s): beyond_bounds(excerpt, event)
        for event in excerpt.events
        if event.target and event.stamp_s <= last_s
    }
    wrong = {key for key, off in truth_off.items() if off > 1.0}
    gross = {key for key, off in truth_off.items() if off > GROSS}
    print(
        '| truth inside | detections | outside their bounds | of these named | off by more than '
        f'{GROSS:g} times the bound | of these named | named though right |\n'
        '|---|---|---|---|---|---|---|\n'
        f'| {inside} of {ticks} | {len(truth_off)} | {len(wrong)} | {len(wrong & named)} | '
        f'{len(gross)} | {len(gross & named)} | {len(named - wrong)} |'
    )


GROSS = 3.0
"""An error of so many times its bound is a gross one."""


def beyond_bounds(excerpt: Excerpt, event: Event) -> float:
    """Return the greater error of a detection over its bound."""
    places, yaws = excerpt.truth(event.stamp_s)
    robot = excerpt.names.index(event.robot)
    target = (
        places[excerpt.names.index(event.target)]
        if event.target in excerpt.names
        else np.array(excerpt.anchors[event.target].coordinates_m)
    )
    way = target - places[robot]
    range_m, bearing = event.values
    off_range = abs(float(np.linalg.norm(way)) / range_m - 1.0) / SEEN_RANGE_ERROR
    off_rad = math.remainder(math.atan2(way[1], way[0]) - yaws[robot] - bearing, 2.0 * math.pi)
    return max(off_range, abs(off_rad) / BEARING_ERROR_RAD)


def main() -> None:
    """Read the command line and print what was asked for."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.liars', description=__doc__)
    parser.add_argument('study', choices=['window', 'landmarks', 'mrclam'])
    parser.add_argument('--runs', type=int, default=10)
    parser.add_argument('--first', type=int, default=0, metavar='SEED')
    parser.add_argument('--robots', type=int, nargs='+', default=[6, 9])
    parser.add_argument('--wrong', type=int, nargs='+', default=[1, 2, 5])
    parser.add_argument('--data', type=Path, default=Path('../shared/data/mrclam'))
    parser.add_argument('--outliers', type=int, default=5)
    parser.add_argument('--memory', type=float, default=30.0, metavar='SECONDS')
    parser.add_argument('--every', type=float, default=4.0, metavar='SECONDS')
    arguments = parser.parse_args()
    if arguments.study == 'window':
        seeds = range(arguments.first, arguments.first + arguments.runs)
        report_window(seeds, arguments.robots, arguments.wrong)
    elif arguments.study == 'landmarks':
        report_landmarks(arguments.runs)
    else:
        report_mrclam(arguments.data, arguments.outliers, arguments.memory, arguments.every)


if __name__ == '__main__':
    main()
