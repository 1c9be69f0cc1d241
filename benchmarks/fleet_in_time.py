# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Fleets over time: what ranges and odometry tell of robots that move.

    python -m benchmarks.fleet_in_time simulated [--runs 10] [--robots 2 3 4 6] [--seconds 15]
        [--limit 0.15]
    python -m benchmarks.fleet_in_time mrclam [--data ../shared/data/mrclam] [--outliers 0]
        [--fitted readings|half|whole] [--keep 0.95] [--margin 0.1]
    python -m benchmarks.fleet_in_time rate [--data ../shared/data/mrclam] [--outliers 0]
        [--start 95]
    python -m benchmarks.fleet_in_time robots [--data ../shared/data/mrclam] [--outliers 0]
    python -m benchmarks.fleet_in_time kalman [--data ../shared/data/mrclam] [--memory 30]

Simulated robots range each other at 5 Hz to 3 %; odometry errs by 5 % of the way and of the turn,
there are no cameras and no anchors. MRCLAM: five robots among 15 landmarks, which serve as
anchors; `rate` answers at 5 Hz for some seconds; `robots` leaves the landmarks out; `kalman`
compares the published point with an extended Kalman filter that starts at the truth. With
`--fitted` the bounds of ranges and bearings are those that were learned of the recording, and with
`half` and `whole` scale and bounds of the odometry of each robot, too, which were learned of its
first half or of the whole, hold the share `--keep` of its windows, and are widened by `--margin`.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
import math
from pathlib import Path
import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.kalman_filter import Deviations, KalmanFilter
from benchmarks.robots import (
    BEARING_ERROR_RAD,
    EXCERPT,
    RANGE_ERROR as SEEN_RANGE_ERROR,
    ROBOTS,
    SPEED_M_S,
    STEP_S,
    TURN_RATE_RAD_S,
    Recording,
    SimulatedRobot,
    odometry_error,
    rotation,
)
from dg_localization import SolverOptions
from dg_localization.fleet import (
    Anchor,
    Estimate,
    FixedFrame,
    FleetConfig,
    Localizer,
    OdometryErrorModel,
    Placement,
    RangeErrorModel,
)

FloatArray = NDArray[np.float64]

START_S = 1000.0
RANGE_ERROR = 0.03
ODOMETRY_ERROR = 0.05
EVERY = 2
"""A range at every second sample of the odometry."""
ARC_RAD = 1.0
"""A heading counts as bounded in less than this."""


def driving_config(robots: int, memory_s: float) -> FleetConfig:
    """Return what a localizer is told of robots that drive about."""
    return FleetConfig(
        robots=tuple(f'r{i}' for i in range(robots)),
        range_error=RangeErrorModel(
            min_error_relative=-RANGE_ERROR, max_error_relative=RANGE_ERROR
        ),
        max_speed_m_s=0.9,
        max_turn_rate_rad_s=0.9,
        odometry_error=OdometryErrorModel(
            translation_per_m=ODOMETRY_ERROR, rotation_per_rad=ODOMETRY_ERROR
        ),
        memory_s=memory_s,
    )


def feed_odometry(
    localizer: Localizer, members: Sequence[SimulatedRobot], step: int, now_s: float
) -> None:
    """Give a localizer the odometry of all robots at a step."""
    for name, member in zip(localizer.config.robots, members, strict=True):
        yaw = float(member.stated_rad[step])
        orientation = [0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)]
        localizer.add_odometry(name, member.stated_m[step], orientation, now_s, now_s)


def truth_in_frame(
    members: Sequence[SimulatedRobot], step: int, origin: int, towards: int
) -> tuple[FloatArray, FloatArray]:
    """Return positions (n, 2) and yaws (n,) with one robot at the origin and x to another."""
    places = np.array([member.positions_m[step] for member in members])
    yaws = np.array([member.yaws_rad[step] for member in members])
    edge = places[towards] - places[origin]
    angle = math.atan2(edge[1], edge[0])
    return ((places - places[origin]) @ rotation(angle))[:, :2], yaws - angle


@dataclass
class SimulatedFleet:
    """Robots that drive about, and what they measure, given to a localizer step by step."""

    members: list[SimulatedRobot]
    localizer: Localizer
    rng: np.random.Generator

    @classmethod
    def draw(
        cls, seed: int, robots: int, seconds: float, memory_s: float, limit_s: float = math.inf
    ) -> SimulatedFleet:
        """Return a fleet of a seed."""
        rng = np.random.default_rng([seed, robots])
        members = [SimulatedRobot.drive(rng, seconds, ODOMETRY_ERROR) for _robot in range(robots)]
        config = replace(
            driving_config(robots, memory_s),
            memory_max_seconds=limit_s,
            solver=SolverOptions(max_seconds=1.0),
        )
        return cls(members, Localizer(config), rng)

    def feed(self, step: int) -> float:
        """Give the localizer what is measured at a step; return its time."""
        now_s = START_S + step * STEP_S
        names = self.localizer.config.robots
        feed_odometry(self.localizer, self.members, step, now_s)
        if step % EVERY == 0:
            for (a, first), (b, second) in combinations(zip(names, self.members, strict=True), 2):
                apart = np.linalg.norm(second.positions_m[step] - first.positions_m[step])
                reading = apart / (1.0 + self.rng.uniform(-RANGE_ERROR, RANGE_ERROR))
                self.localizer.add_range(a, b, float(reading), now_s, now_s)
        return now_s

    def truth(self, step: int, frame: FixedFrame) -> tuple[FloatArray, FloatArray]:
        """Return positions (n, 2) and yaws (n,) in the frame of an estimate."""
        names = self.localizer.config.robots
        origin, towards = (names.index(name) for name in frame.points)
        return truth_in_frame(self.members, step, origin, towards)


def holds(placement: Placement, places_m: FloatArray, yaws_rad: FloatArray) -> bool:
    """Return whether a truth lies in a placement."""
    low, high = placement.enclosure_m[:, 0] - 1e-9, placement.enclosure_m[:, 1] + 1e-9
    if not np.all((low <= places_m) & (places_m <= high)):
        return False
    for row in np.flatnonzero(placement.heading_known):
        _, _, z, w = placement.orientations_xyzw[row]
        off = math.remainder(2.0 * math.atan2(z, w) - yaws_rad[row], math.tau)
        if abs(off) > placement.heading_half_width_rad[row] + 1e-9:
            return False
    return True


@dataclass(frozen=True)
class Event:
    """A line of MRCLAM: odometry, or what a camera saw."""

    stamp_s: float
    robot: str
    target: str
    values: tuple[float, ...]


class Excerpt:
    """Five robots among landmarks, and where they truly were."""

    def __init__(self, folder: Path, name: str = EXCERPT) -> None:
        self.robots = [Recording.load(folder / name, robot) for robot in ROBOTS]
        self.names = tuple(f'r{robot}' for robot in ROBOTS)
        landmarks = self.robots[0].landmarks
        self.anchors = {f'm{number}': Anchor(tuple(xy), 0.01) for number, xy in landmarks.items()}
        events = [event for index in range(len(self.names)) for event in self._events(index)]
        self.events = sorted(events, key=lambda event: event.stamp_s)

    def _events(self, index: int) -> Iterator[Event]:
        """Yield what a robot measured."""
        robot, name = self.robots[index], self.names[index]
        for stamp_s, (x, y, _), yaw in zip(*robot.track, strict=True):
            yield Event(float(stamp_s), name, '', (float(x), float(y), float(yaw)))
        for stamp_s, subject, range_m, bearing in robot.all_sightings:
            target = f'r{subject:.0f}' if subject in ROBOTS else f'm{subject:.0f}'
            if target != name:
                yield Event(stamp_s - LATE_S, name, target, (range_m, bearing))

    def truth(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Return positions (n, 2) and yaws (n,)."""
        poses = [robot.pose(time_s) for robot in self.robots]
        return np.array([pose[0][:2] for pose in poses]), np.array([pose[1] for pose in poses])

    def feed(self, localizer: Localizer, event: Event) -> None:
        """Give one event to a localizer."""
        now_s = event.stamp_s
        if not event.target:
            x, y, yaw = event.values
            orientation = [0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)]
            localizer.add_odometry(event.robot, [x, y, 0.0], orientation, now_s, now_s)
            return
        range_m, bearing = event.values
        ray = [math.cos(bearing), math.sin(bearing), 0.0]
        localizer.add_range(event.robot, event.target, range_m, now_s, now_s)
        localizer.add_bearing(event.robot, event.target, ray, now_s, now_s)


LATE_S = 0.05
"""Stamps of sightings are late by about this."""

RATE_HZ, RATE_FROM_S, RATE_TICKS = 5.0, 95.0, 50
"""Of `rate`; before that there is an answer every 4 s."""

FITTED_RANGE_ERROR = RangeErrorModel(min_error_relative=-0.15, max_error_relative=0.092)
FITTED_BEARING_ERROR_RAD = 0.060
"""What `fit_bounds --per all --keep 0.99` learns of the excerpt."""


def fitted_odometry(
    excerpt: Excerpt, part: str, keep: float, margin: float
) -> dict[str, OdometryErrorModel]:
    """Return what `fit_bounds` learns of the odometry of each robot, of a part of the excerpt."""
    from dg_localization.calibration.bounds import Choice
    from dg_localization.calibration.odometry import fit_odometry, odometry_windows
    from dg_localization.calibration.truth import TrueTrack

    errors = {}
    for name, robot in zip(excerpt.names, excerpt.robots, strict=True):
        stamps, places, yaws = robot.truth[:, 0], robot.truth[:, 1:3], robot.truth[:, 3]
        zeros = np.zeros(len(stamps))
        truth = TrueTrack(
            stamps,
            np.column_stack([places, zeros]),
            np.column_stack([zeros, zeros, np.sin(yaws / 2.0), np.cos(yaws / 2.0)]),
        )
        stamps_s, positions_m, yaws_rad = robot.track
        end_s = np.mean(stamps_s[[0, -1]]) if part == 'half' else np.inf
        rows = np.flatnonzero(stamps_s <= end_s)
        turns = np.array([rotation(yaw) for yaw in yaws_rad[rows]])
        windows = odometry_windows(stamps_s[rows], positions_m[rows], turns, truth)
        errors[name] = fit_odometry(windows, Choice(keep, margin))
    return errors


def mrclam_config(excerpt: Excerpt, outliers: int, memory_s: float) -> FleetConfig:
    """Return what the localizer is told of the excerpt."""
    return FleetConfig(
        robots=excerpt.names,
        anchors=excerpt.anchors,
        max_age_s=2.0,
        range_error=RangeErrorModel(
            min_error_relative=-SEEN_RANGE_ERROR, max_error_relative=SEEN_RANGE_ERROR
        ),
        bearing_half_width_rad=BEARING_ERROR_RAD,
        max_speed_m_s=SPEED_M_S,
        max_turn_rate_rad_s=TURN_RATE_RAD_S,
        odometry_error=odometry_error(0.2),
        memory_s=memory_s,
        memory_max_seconds=math.inf,
        window_outliers=outliers,
        max_outliers=1,
        solver=SolverOptions(resolution=0.1, max_boxes=200),
    )


def ticks_s(excerpt: Excerpt, tick_s: float) -> FloatArray:
    """Return the times to answer at, from 20 s on."""
    return np.arange(excerpt.events[0].stamp_s + 20.0, excerpt.events[-1].stamp_s, tick_s)


def answers(
    excerpt: Excerpt, config: FleetConfig, times_s: FloatArray
) -> Iterator[tuple[float, Estimate, float]]:
    """Yield times, estimates, and how many milliseconds of the processor each took."""
    localizer = Localizer(config)
    pending = iter(excerpt.events)
    event = next(pending, None)
    for now_s in times_s:
        while event is not None and event.stamp_s <= now_s:
            excerpt.feed(localizer, event)
            event = next(pending, None)
        start = time.process_time()
        estimate = localizer.step(float(now_s))
        yield float(now_s), estimate, 1000.0 * (time.process_time() - start)


def fitted_config(
    excerpt: Excerpt, config: FleetConfig, part: str, keep: float, margin: float
) -> FleetConfig:
    """Return a configuration with bounds of readings, and of odometry, that were learned."""
    config = replace(
        config, range_error=FITTED_RANGE_ERROR, bearing_half_width_rad=FITTED_BEARING_ERROR_RAD
    )
    if part == 'readings':
        return config
    return replace(config, robot_odometry_error=fitted_odometry(excerpt, part, keep, margin))


@dataclass
class Drive:
    """Figures of a recorded drive: of each answer, and of each robot in each answer."""

    inside: list[bool] = field(default_factory=list)
    width_m: list[float] = field(default_factory=list)
    bounded: list[bool] = field(default_factory=list)
    off_m: list[float] = field(default_factory=list)
    milliseconds: list[float] = field(default_factory=list)
    forgotten: int = 0

    @classmethod
    def of(cls, excerpt: Excerpt, config: FleetConfig, tick_s: float) -> Drive:
        """Localize the robots of the excerpt."""
        drive = cls()
        for now_s, estimate, milliseconds in answers(excerpt, config, ticks_s(excerpt, tick_s)):
            drive.milliseconds.append(milliseconds)
            drive.forgotten += bool(estimate.forgotten)
            places, yaws = excerpt.truth(now_s)
            held = [holds(placement, places, yaws) for placement in estimate.placements]
            drive.inside.append(any(held))
            if estimate.placements:
                best = estimate.placements[0]
                wide = np.ptp(best.enclosure_m, axis=1).max(axis=1)
                drive.width_m += list(wide[np.isfinite(wide)])
                drive.bounded += list(np.isfinite(wide))
                errors = np.linalg.norm(best.positions_m - places, axis=1)
                drive.off_m += list(errors[np.isfinite(errors)])
        return drive


def report_mrclam(excerpt: Excerpt, config: FleetConfig, tick_s: float) -> None:
    """Print the figures of the four-minute excerpt as a row of a table."""
    drive = Drive.of(excerpt, config, tick_s)
    fast, slow = np.percentile(drive.milliseconds, [50, 95])
    print(
        f'| {config.memory_s:.0f} | {config.window_outliers} '
        f'| {sum(drive.inside)} of {len(drive.inside)} | {1.0 - np.mean(drive.bounded):.1%} '
        f'| {_median_and_95(drive.width_m)} | {_median_and_95(drive.off_m)} '
        f'| {fast:.0f} ({slow:.0f}) | {drive.forgotten} |'
    )


def report_kalman(excerpt: Excerpt, config: FleetConfig, tick_s: float) -> None:
    """Print how far the published point and a Kalman filter are from the truth."""
    places, yaws = excerpt.truth(excerpt.events[0].stamp_s)
    landmarks = {name: np.array(anchor.coordinates_m) for name, anchor in excerpt.anchors.items()}
    poses = np.column_stack([places, yaws])
    peer = KalmanFilter(poses, excerpt.names, landmarks, Deviations())
    events, filtered_m = iter(excerpt.events), []
    event = next(events, None)
    for now_s in ticks_s(excerpt, tick_s):
        while event is not None and event.stamp_s <= now_s:
            if event.target:
                peer.correct(event.robot, event.target, *event.values)
            else:
                peer.predict(event.robot, np.array(event.values), event.stamp_s)
            event = next(events, None)
        off_m = np.linalg.norm(peer.poses[:, :2] - excerpt.truth(float(now_s))[0], axis=1)
        filtered_m += list(off_m)
    found_m = Drive.of(excerpt, config, tick_s).off_m
    ratio = np.percentile(found_m, [50, 95]) / np.percentile(filtered_m, [50, 95])
    print(
        f'| {_median_and_95(found_m)} | {_median_and_95(filtered_m)} '
        f'| {ratio[0]:.2f} (95 %: {ratio[1]:.2f}) |'
    )


def report_rate(folder: Path, outliers: int, memory_s: float, from_s: float) -> None:
    """Print what an answer takes at 5 Hz, once the memory is full."""
    excerpt = Excerpt(folder)
    config = mrclam_config(excerpt, outliers, memory_s)
    begin_s = excerpt.events[0].stamp_s + from_s
    often_s = begin_s + np.arange(RATE_TICKS) / RATE_HZ
    before_s = ticks_s(excerpt, 4.0)
    inside, spent = 0, []
    times_s = np.concatenate([before_s[before_s < begin_s], often_s])
    for now_s, estimate, milliseconds in answers(excerpt, config, times_s):
        if now_s >= begin_s:
            spent.append(milliseconds)
            places, yaws = excerpt.truth(now_s)
            inside += any(holds(placement, places, yaws) for placement in estimate.placements)
    fast, slow = np.percentile(spent, [50, 95])
    print(f'| {memory_s:.0f} | {outliers} | {inside} of {len(spent)} | {fast:.0f} ({slow:.0f}) |')


def report_robots(folder: Path, outliers: int, memory_s: float, tick_s: float) -> None:
    """Print the figures of the four-minute excerpt without landmarks as a row of a table."""
    excerpt = Excerpt(folder)
    config = replace(mrclam_config(excerpt, outliers, memory_s), anchors={})
    seen = [event for event in excerpt.events if not event.target.startswith('m')]
    excerpt.events[:] = seen
    frames: Counter[str] = Counter()
    hypotheses, inside, widths, spent = [], [], [], []
    for now_s, estimate, milliseconds in answers(excerpt, config, ticks_s(excerpt, tick_s)):
        spent.append(milliseconds)
        frames[estimate.frame.kind.value if estimate.frame else 'none'] += 1
        hypotheses.append(estimate.n_hypotheses)
        places, _ = excerpt.truth(now_s)
        apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
        parts = [*estimate.placements]
        if parts:
            held = [np.all((p.lower_m <= apart) & (apart <= p.upper_m)) for p in parts]
            inside.append(any(held))
            wide = (parts[0].upper_m - parts[0].lower_m)[np.triu_indices(len(apart), 1)]
            widths += list(wide)
    single = np.mean(np.array(hypotheses) == 1)
    bounded = np.array(widths)[np.isfinite(widths)]
    fast, slow = np.percentile(spent, [50, 95])
    print(
        f'| {memory_s:.0f} | {outliers} | {len(hypotheses)} | {dict(frames)} | {single:.0%} | '
        f'{sum(inside)} of {len(inside)} | {np.median(bounded):.2f} | '
        f'{1.0 - len(bounded) / len(widths):.0%} | {fast:.0f} ({slow:.0f}) |'
    )


@dataclass
class Runs:
    """Figures of many simulated fleets."""

    answers: int = 0
    inside: int = 0
    single: int = 0
    headed: int = 0
    settled: int = 0
    bounded_before: int = 0
    settled_before: int = 0
    runs: int = 0
    widths_rad: list[float] = field(default_factory=list)
    off_m: list[float] = field(default_factory=list)
    wide_m: list[float] = field(default_factory=list)
    milliseconds: list[float] = field(default_factory=list)

    def run(self, fleet: SimulatedFleet, seconds: float, tick_s: float) -> None:
        """Localize a fleet for some seconds."""
        steps = round(seconds / STEP_S)
        estimate, bounded, settled = None, False, False
        for step in range(steps + 1):
            now_s = fleet.feed(step)
            if step == 0 or step % round(tick_s / STEP_S):
                continue
            start = time.process_time()
            estimate = fleet.localizer.step(now_s)
            self.milliseconds.append(1000.0 * (time.process_time() - start))
            assert estimate.frame is not None
            truth = fleet.truth(step, estimate.frame)
            self.answers += 1
            self.inside += any(holds(place, *truth) for place in estimate.placements)
            single, arcs = estimate.n_hypotheses == 1, _arcs_rad(estimate)
            if single:
                (place,) = estimate.placements
                self.off_m.append(np.linalg.norm(place.positions_m - truth[0], axis=1).max())
                self.wide_m.append(np.ptp(place.enclosure_m, axis=1).max())
            bounded |= single and bool(np.all(arcs < math.pi))
            settled |= single and bool(np.median(arcs) < ARC_RAD)
        assert estimate is not None
        self.bounded_before += bounded
        self.settled_before += settled
        self.runs += 1
        self.single += single
        self.settled += single and bool(np.median(arcs) < ARC_RAD)
        self.widths_rad += list(arcs)
        self.headed += single and bool(np.all(arcs < math.pi))

    def row(self, robots: int, seconds: float) -> str:
        """Return the figures as a row of a table."""
        runs = self.runs
        low, middle, high = np.percentile(self.widths_rad, [5, 50, 95])
        fast, slow = np.percentile(self.milliseconds, [50, 95])
        at_end = self.single, self.headed, self.settled
        before = self.bounded_before, self.settled_before
        counts = [f'{count} of {runs}' for count in (*at_end, *before)]
        return (
            f'| {robots} | {seconds:.0f} | {self.inside} of {self.answers} | '
            f'{" | ".join(counts)} | {middle:.2f} ({low:.2f} to {high:.2f}) | '
            f'{_median_and_95(self.off_m)} | {_median_and_95(self.wide_m)} | '
            f'{fast:.0f} ({slow:.0f}) |'
        )


def _median_and_95(values: Sequence[float]) -> str:
    """Return two percentiles as a cell of a table."""
    if not len(values):
        return '-'
    return '{:.2f} (95 %: {:.2f})'.format(*np.percentile(values, [50, 95]))


def _arcs_rad(estimate: Estimate) -> FloatArray:
    """Return the widths of the headings of the first placement."""
    return np.minimum(2.0 * estimate.placements[0].heading_half_width_rad, 2.0 * math.pi)


def simulated(
    robots: int, runs: int, seconds: float, memory_s: float, limit_s: float = math.inf
) -> Runs:
    """Return the figures of simulated fleets of a size."""
    figures = Runs()
    for seed in range(runs):
        fleet = SimulatedFleet.draw(seed, robots, seconds, memory_s, limit_s)
        figures.run(fleet, seconds, 1.0)
    return figures


def report_simulated(
    robots: list[int], runs: int, seconds: float, memory_s: float, limit_s: float
) -> None:
    """Print the table of simulated fleets."""
    print(
        '| robots | seconds | truth inside | one hypothesis | with all headings '
        '| and below 1 rad in the median | all headings, before | below 1 rad, before '
        '| heading width (rad) | farthest point off by (m) | widest enclosure (m) | ms (95 %) |'
    )
    for count in robots:
        print(simulated(count, runs, seconds, memory_s, limit_s).row(count, seconds), flush=True)


def main() -> None:
    """Read the command line and print what was asked for."""
    name = 'python -m benchmarks.fleet_in_time'
    parser = argparse.ArgumentParser(prog=name, description=__doc__)
    parser.add_argument('study', choices=['simulated', 'mrclam', 'rate', 'robots', 'kalman'])
    parser.add_argument('--runs', type=int, default=10)
    parser.add_argument('--robots', type=int, nargs='+', default=[2, 3, 4, 6])
    parser.add_argument('--seconds', type=float, default=15.0)
    parser.add_argument('--memory', type=float, default=30.0, metavar='SECONDS')
    parser.add_argument(
        '--limit',
        type=float,
        default=math.inf,
        metavar='SECONDS',
        help='memory.max_seconds of simulated fleets',
    )
    parser.add_argument('--data', type=Path, default=Path('../shared/data/mrclam'))
    parser.add_argument('--outliers', type=int, default=0)
    parser.add_argument('--every', type=float, default=5.0, metavar='SECONDS')
    parser.add_argument('--start', type=float, default=RATE_FROM_S, metavar='SECONDS')
    parser.add_argument(
        '--fitted',
        choices=['readings', 'half', 'whole'],
        help='bounds learned by fit_bounds: of ranges and bearings alone, or of odometry, too',
    )
    parser.add_argument('--keep', type=float, default=0.95, metavar='SHARE')
    parser.add_argument('--margin', type=float, default=0.1, metavar='SHARE')
    arguments = parser.parse_args()
    if arguments.study == 'simulated':
        report_simulated(
            arguments.robots,
            arguments.runs,
            arguments.seconds,
            arguments.memory,
            arguments.limit,
        )
    elif arguments.study == 'rate':
        print('| memory (s) | outliers | truth inside | ms (95 %) |')
        report_rate(arguments.data, arguments.outliers, arguments.memory, arguments.start)
    elif arguments.study == 'kalman':
        print('| published point off by (m) | Kalman filter off by (m) | ratio |')
        excerpt = Excerpt(arguments.data)
        config = mrclam_config(excerpt, arguments.outliers, arguments.memory)
        report_kalman(excerpt, config, arguments.every)
    elif arguments.study == 'robots':
        print(
            '| memory (s) | outliers | ticks | frames | one hypothesis | true distances inside '
            '| width of a distance (m) | not bounded | ms (95 %) |'
        )
        report_robots(arguments.data, arguments.outliers, arguments.memory, arguments.every)
    else:
        print(
            '| memory (s) | outliers | truth inside | infinite | width (m) | point off by (m) '
            '| ms (95 %) | forgot |'
        )
        excerpt = Excerpt(arguments.data)
        config = mrclam_config(excerpt, arguments.outliers, arguments.memory)
        if arguments.fitted:
            learned = arguments.fitted, arguments.keep, arguments.margin
            config = fitted_config(excerpt, config, *learned)
        report_mrclam(excerpt, config, arguments.every)


if __name__ == '__main__':
    main()
