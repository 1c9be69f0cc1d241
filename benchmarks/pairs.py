# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Pair sets: how wide, how fast, and whether the truth is inside; the figures of docs/pairs.md.

    python -m benchmarks.pairs mrclam [--data ../shared/data/mrclam] [--every 5]
    python -m benchmarks.pairs carried
    python -m benchmarks.pairs two [--runs 100]
    python -m benchmarks.pairs picture docs/pairs.png
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
import math
from pathlib import Path
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import robots
from benchmarks.robots import (
    BEARING_ERROR_RAD,
    EXCERPT,
    RANGE_ERROR,
    ROBOTS,
    SPEED_M_S,
    STEP_S,
    TURN_RATE_RAD_S,
    SimulatedRobot,
    odometry_error,
    rotation,
)
from dg_localization.fleet.odometry import MotionLimits, OdometryPath
from dg_localization.fleet.odometry_error import OdometryErrorModel
from dg_localization.interval.arrays import Interval
from dg_localization.pairs import Cover, PairOptions, PairReadings, PastPoses, cover_poses

FloatArray = NDArray[np.float64]

WINDOW_S = 90.0
LIMITS = MotionLimits(speed_m_s=SPEED_M_S, turn_rate_rad_s=TURN_RATE_RAD_S)

RESOLUTIONS_M = (0.1, 0.25, 0.5)


class Recording(robots.Recording):
    """One robot of the excerpt, and what it saw as readings of a pair."""

    def readings(
        self, now_s: float, error: OdometryErrorModel, window_s: float = WINDOW_S
    ) -> PairReadings:
        """Return what the robot saw in the window before `now_s`."""
        times = self.sightings[:, 0]
        seen = self.sightings[(times > now_s - window_s) & (times <= now_s)]
        poses = self.past_poses(seen[:, 0], now_s, error, window_s)
        bearings, ranges = seen[:, 3], seen[:, 2]
        directions = np.stack([np.cos(bearings), np.sin(bearings), 0.0 * bearings], axis=-1)
        places = np.array([[*self.landmarks[int(subject)], 0.0] for subject in seen[:, 1]])
        return PairReadings.of(
            Interval.point(places.reshape(-1, 3)),
            poses.points_now(Interval.point(np.zeros((len(seen), 3)))),
            Interval(ranges * (1.0 - RANGE_ERROR), ranges * (1.0 + RANGE_ERROR)),
            *poses.rays_now(directions, np.full(len(seen), BEARING_ERROR_RAD)),
            True,
        )

    def past_poses(
        self, times_s: FloatArray, now_s: float, error: OdometryErrorModel, window_s: float
    ) -> PastPoses:
        """Return where the robot was at some times, seen from now."""
        stamps, positions, yaws = self.track
        used = slice(
            max(0, np.searchsorted(stamps, now_s - window_s) - 1),
            np.searchsorted(stamps, now_s, side='right') + 1,
        )
        rotations = [rotation(yaw) for yaw in yaws[used]]
        path = OdometryPath(stamps[used], positions[used], rotations, error, LIMITS)
        return path.past_poses(times_s, now_s)


@dataclass
class Tally:
    """Figures of many covers."""

    widths_m: list[float]
    yaws_rad: list[float]
    off_m: list[float]
    milliseconds: list[float]
    inside: list[bool]
    boxes: list[int]
    components: list[int]

    @classmethod
    def empty(cls) -> Tally:
        """Return a tally of nothing."""
        return cls([], [], [], [], [], [], [])

    def add(self, cover: Cover, seconds: float, position_m: FloatArray, yaw_rad: float) -> None:
        """Count a cover and its truth."""
        self.inside.append(cover.contains(position_m, yaw_rad))
        self.milliseconds.append(1000.0 * seconds)
        self.boxes.append(len(cover))
        if not cover.empty:
            hull = cover.hull
            self.widths_m.append(float(hull.widths_m.max()))
            self.yaws_rad.append(hull.yaw_width_rad)
            middle = 0.5 * (hull.lower_m + hull.upper_m)
            self.off_m.append(float(np.linalg.norm(middle - position_m)))
            self.components.append(len(cover.components))

    def row(self) -> str:
        """Return the figures as cells of a table."""

        def quantiles(values: list[Any]) -> str:
            low, middle, high = np.percentile(values, [5, 50, 95])
            return f'{middle:.2f} ({low:.2f} to {high:.2f})'

        return ' | '.join(
            [
                f'{sum(self.inside)} of {len(self.inside)}',
                quantiles(self.widths_m),
                f'{np.median(self.off_m):.2f}',
                quantiles(self.yaws_rad),
                f'{np.median(self.components):.0f}',
                f'{np.median(self.boxes):.0f}',
                quantiles(self.milliseconds),
            ]
        )


HEADER = (
    '| truth inside | width (m) | center off by (m) | yaw width (rad) | components | boxes | ms |'
)


def timed(*arguments: Any, **keywords: Any) -> tuple[Cover, float]:
    """Cover poses; return the cover and the seconds of the processor it took."""
    start = time.process_time()
    cover = cover_poses(*arguments, **keywords)
    return cover, time.process_time() - start


def windows(
    folder: Path, every_s: float, longest_s: float = math.inf
) -> Iterator[tuple[Recording, float]]:
    """Yield the robots at times after a full window."""
    for robot in ROBOTS:
        recording = Recording.load(folder / EXCERPT, robot)
        start_s, end_s = recording.truth[0, 0] + WINDOW_S + 5.0, recording.truth[-1, 0]
        end_s = min(end_s, start_s + longest_s)
        for now_s in np.arange(start_s, end_s, every_s):
            yield recording, float(now_s)


def report_mrclam(folder: Path, every_s: float) -> None:
    """Print the table of one robot and the landmarks as two bodies."""
    cases = list(windows(folder, every_s))
    print(f'{len(cases)} windows of {WINDOW_S:.0f} s')
    print('| odometry turn | outliers | resolution (m) ' + HEADER)
    for per_turn in (0.1, 0.2):
        counts, prepared = [], []
        for recording, now_s in cases:
            readings = recording.readings(now_s, odometry_error(per_turn))
            counts.append(len(readings))
            prepared.append((readings, recording.pose(now_s)))
        for outliers in (0, 5):
            for resolution_m in RESOLUTIONS_M:
                options = PairOptions(outliers, resolution_m, max_boxes=5000)
                cover_poses(prepared[0][0], options)
                tally = Tally.empty()
                for readings, pose in prepared:
                    tally.add(*timed(readings, options), *pose)
                print(f'| {per_turn:.0%} | {outliers} | {resolution_m} | {tally.row()} |')
    print(f'readings per window: {np.percentile(counts, [5, 50, 95])}')


def report_carried(folder: Path, tick_s: float = 1.0, start_boxes: int = 30) -> None:
    """Print what it saves to start from the cover of the tick before."""
    error = odometry_error(0.2)
    options = PairOptions(max_outliers=5)
    tallies = {name: Tally.empty() for name in ('anew', 'carried', 'carried, new readings only')}
    covers: dict[str, Cover] = {}
    robot = None
    for recording, now_s in windows(folder, tick_s, tick_s * 30):
        if recording is not robot:
            robot, covers = recording, {}
        pose = recording.pose(now_s)
        for name, tally in tallies.items():
            window_s = tick_s if 'only' in name and name in covers else WINDOW_S
            readings = recording.readings(now_s, error, window_s)
            start = time.process_time()
            within = None
            if name != 'anew' and name in covers and not covers[name].empty:
                step = recording.past_poses(np.array([now_s - tick_s]), now_s, error, 10.0)
                within = covers[name].moved(PastPoses.at_rest(1), step).coarsened(start_boxes)
            moving_s = time.process_time() - start
            covers[name], seconds = timed(readings, options, within=within)
            tally.add(covers[name], seconds + moving_s, *pose)
    print(f'a tick every {tick_s} s, {options.max_outliers} outliers')
    print('| start ' + HEADER)
    for name, tally in tallies.items():
        print(f'| {name} | {tally.row()} |')


def path_of(robot: SimulatedRobot, odometry: float) -> OdometryPath:
    """Return the odometry of a simulated robot with its bounds."""
    error = OdometryErrorModel(translation_per_m=odometry, rotation_per_rad=odometry)
    stamps = np.arange(len(robot.stated_m)) * STEP_S
    return OdometryPath(stamps, robot.stated_m, [rotation(yaw) for yaw in robot.stated_rad], error)


def two_robots(
    seed: int, seconds: float, range_error: float, odometry: float
) -> tuple[PairReadings, FloatArray, float]:
    """Simulate two robots with ranges and odometry; return readings, and the pose at the end."""
    rng = np.random.default_rng(seed)
    first, second = (SimulatedRobot.drive(rng, seconds, odometry) for _robot in range(2))
    between = second.positions_m - first.positions_m
    ranges = np.linalg.norm(between, axis=-1)
    ranges *= 1.0 + rng.uniform(-range_error, range_error, len(ranges))
    stamps = np.arange(len(ranges)) * STEP_S
    origin = Interval.point(np.zeros((len(stamps), 3)))
    first_m, second_m = (
        path_of(robot, odometry).past_poses(stamps, stamps[-1]).points_now(origin)
        for robot in (first, second)
    )
    bounds = Interval(ranges / (1.0 + range_error), ranges / (1.0 - range_error))
    turned_rad = float(second.yaws_rad[-1] - first.yaws_rad[-1])
    position = rotation(-first.yaws_rad[-1]) @ between[-1]
    return PairReadings.of(first_m, second_m, bounds), position, turned_rad


def report_two(runs: int) -> None:
    """Print what ranges and odometry alone tell two robots."""
    print('| seconds | mirror image ruled out ' + HEADER)
    options = PairOptions(resolution_m=0.1)
    for seconds in (5.0, 10.0, 14.0):
        tally, ruled_out = Tally.empty(), 0
        for seed in range(runs):
            readings, position, yaw = two_robots(seed, seconds, 0.03, 0.05)
            cover, used_s = timed(readings, options)
            tally.add(cover, used_s, position, yaw)
            ruled_out += not cover.contains(position * [1.0, -1.0, 1.0], -yaw)
        print(f'| {seconds:.0f} | {ruled_out} of {runs} | {tally.row()} |')


def draw(picture: Path) -> None:
    """Draw how the set of two robots shrinks while they move."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    figure, axes = pyplot.subplots(1, 3, figsize=(10.5, 3.9), layout='constrained')
    for axis, seconds in zip(axes, (0.0, 6.0, 14.0), strict=True):
        readings, position, yaw = two_robots(PICTURED, seconds, 0.03, 0.05)
        cover = cover_poses(readings, PairOptions(resolution_m=0.1, max_boxes=20_000))
        boxes = cover.boxes
        yaws = 0.5 * (boxes[:, 0, 3] + boxes[:, 1, 3]) / (2.0 * math.pi)
        colors = matplotlib.colormaps['hsv'](yaws % 1.0)
        if cover.hull.yaw_width_rad > 6.2 and len(cover.components) == 1:
            colors[:] = matplotlib.colors.to_rgba('0.7')
        patches = [Rectangle(low[:2], *(high - low)[:2]) for low, high in boxes]
        axis.add_collection(PatchCollection(patches, facecolors=colors))
        arrow = 0.9 * np.array([math.cos(yaw), math.sin(yaw)])
        axis.annotate(
            '', position[:2] + arrow, position[:2], arrowprops={'arrowstyle': '->', 'lw': 1.6}
        )
        axis.plot(*position[:2], 'k.', label='truth')
        axis.plot(0.0, 0.0, 'k^', label='body A')
        limits = {'xlim': (-6.2, 6.2), 'ylim': (-6.2, 6.2)}
        axis.set(xlabel='x (m)', ylabel='y (m)', aspect='equal', **limits)
        parts = len(cover.components)
        name = 'component' if parts == 1 else 'components'
        axis.set_title(f'after {seconds:.0f} s: {parts} {name}', fontsize='medium')
    axes[-1].legend(loc='lower left', fontsize='small')
    colors = matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(0.0, 2.0 * math.pi), 'hsv')
    figure.colorbar(colors, ax=axes, label='yaw of B (rad), gray: any', shrink=0.8)
    figure.savefig(picture, dpi=110)


PICTURED = 6
"""The seed of the drawn robots."""


def main() -> None:
    """Read the command line and print what was asked for."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.pairs', description=__doc__)
    parser.add_argument('study', choices=['mrclam', 'carried', 'two', 'picture'])
    parser.add_argument('file', type=Path, nargs='?', default=Path('docs/pairs.png'))
    parser.add_argument('--data', type=Path, default=Path('../shared/data/mrclam'))
    parser.add_argument('--every', type=float, default=5.0, metavar='SECONDS')
    parser.add_argument('--runs', type=int, default=100)
    arguments = parser.parse_args()
    if arguments.study == 'mrclam':
        report_mrclam(arguments.data, arguments.every)
    elif arguments.study == 'carried':
        report_carried(arguments.data)
    elif arguments.study == 'two':
        report_two(arguments.runs)
    else:
        draw(arguments.file)


if __name__ == '__main__':
    main()
