# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Compare with filters and smoothers on recordings: errors, and how often each was confidently wrong.

    python -m benchmarks.beside [--data ../shared/data] [--only plaza1] [--answers 100]

Every method gets the same readings with the same affine correction, learned on the first quarter
of a recording, and is measured on the rest. The extended Kalman filter and the factor graph start
at the true pose; least squares and ours get no start. A method is confidently wrong where the true
error is beyond three of its stated deviations (by the Mahalanobis distance, 99.73 %). For ours the
guaranteed enclosure is counted too. Of MRCLAM, each of five robots is a recording of its ranges to
landmarks and of its bearings, which all methods use. The factor graph needs `pip install gtsam`
(extra `compare`).
"""

from __future__ import annotations

import argparse
import cmath
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
import math
from pathlib import Path
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from benchmarks import robots
from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    Localizer,
    OdometryErrorModel,
    RangeErrorModel,
    warm_up,
)
from dg_localization.fleet.rotations import rotation_of_quaternion

FloatArray = NDArray[np.float64]

MARGIN = 1.2
"""Bounds are those of the first quarter times this."""

GROSS = 6.0
"""A reading that many robust deviations off is gross, and teaches no bound."""

SQUARED_3_SIGMA = {2: 11.829, 3: 14.156}
"""Squared Mahalanobis distance that 99.73 % of the errors stay below, by dimension."""

WINDOW_S = 30.0
MOST_BEARING_RAD = 1.5

RECORDINGS = (
    *('plaza1', 'labyrinth', 'rcv2', 'rcv5', 'rcv6', 'starloc_v2_s5'),
    *(f'mrclam/{robot}' for robot in robots.ROBOTS),
    *(f'mrclam5a/{robot}' for robot in 'ABCDE'),
)
"""TIERS has no anchors, and the tags of lias_uwb stand."""


@dataclass(frozen=True)
class Recording:
    """One robot among anchors: events in order of time, and the truth."""

    name: str
    anchors: Mapping[str, FloatArray]
    ranges: list[tuple[float, str, float]]
    odometry: FloatArray
    truth: FloatArray
    max_speed_m_s: float
    dimension: int
    bearings: list[tuple[float, str, float]] = field(default_factory=list)
    odometry_error: OdometryErrorModel = OdometryErrorModel(
        translation_per_m=0.05,
        rotation_per_rad=0.05,
        rotation_per_m=0.002,
        constant_m=0.05,
        constant_rad=0.01,
    )

    @property
    def learned_until_s(self) -> float:
        """The end of the first quarter of the ranges."""
        return float(np.quantile([row[0] for row in self.ranges], 0.25))

    def place_m(self, stamp_s: FloatArray | float) -> FloatArray:
        """Return the true position at a time."""
        columns = self.truth[:, 1 : 1 + self.dimension].T
        return np.array([np.interp(stamp_s, self.truth[:, 0], column) for column in columns]).T


@dataclass(frozen=True)
class Bounds:
    """What the first quarter says: the affine part of range errors, and bounds of the rest."""

    constant_m: float
    slope: float
    low_m: float
    high_m: float
    deviation_m: float
    bearing_half_width_rad: float = math.pi
    bearing_deviation_rad: float = math.pi

    def corrected_m(self, range_m: float) -> float:
        """Return a reading without the affine part of its error."""
        return range_m - self.constant_m - self.slope * range_m


@dataclass(frozen=True)
class Answer:
    """A position with its covariance, and whether the claimed set holds the truth."""

    position_m: FloatArray
    covariance_m2: FloatArray
    inside: bool | None = None
    heading_known: bool = False


Method = Callable[[Recording, Bounds, FloatArray], Iterator[Answer | None]]


def read(data: Path, name: str) -> Recording:
    """Read a recording, or what one of its robots measured."""
    folder, _, robot = name.partition('/')
    if folder == 'mrclam':
        return read_mrclam(data / folder, int(robot))
    return read_factor_graph(data / folder, robot) if robot else read_tables(data / folder)


def read_tables(folder: Path) -> Recording:
    """Read a recording of one robot, or of one tag on it, from comma-separated tables."""
    rows = [line.split(',') for line in (folder / 'ranges.csv').read_text().split()[1:]]
    ranged = {row[-2] for row in rows}
    anchors = {
        row[0]: np.array([float(x) for x in row[1:]])
        for row in (line.split(',') for line in (folder / 'anchors.csv').read_text().split()[1:])
        if row[0] in ranged
    }
    odometry, mounts = folder / 'odometry.csv', folder / 'mounts.csv'
    dimension = len(next(iter(anchors.values())))
    truth = np.loadtxt(folder / 'truth.csv', delimiter=',', skiprows=1)
    if mounts.exists():
        # The first sensor is the tag: its place is what ranges alone can tell.
        tag_m = np.loadtxt(mounts, delimiter=',', skiprows=1, usecols=(1, 2, 3))[0]
        truth[:, 1:4] += rotation_of_quaternion(truth[:, 4:8]) @ tag_m
    steps = np.diff(truth[:, 1 : 1 + dimension], axis=0)
    speeds_m_s = np.linalg.norm(steps, axis=1) / np.maximum(np.diff(truth[:, 0]), 0.02)
    return Recording(
        folder.name,
        anchors,
        sorted((float(row[0]), row[-2], float(row[-1])) for row in rows),
        np.loadtxt(odometry, delimiter=',', skiprows=1) if odometry.exists() else np.empty((0, 4)),
        truth,
        1.2 * float(np.quantile(speeds_m_s, 0.999)),
        dimension,
    )


def read_mrclam(folder: Path, number: int) -> Recording:
    """Read what one of five robots measured of the landmarks."""
    robot = robots.Recording.load(folder / robots.EXCERPT, number)
    stamps_s, places_m, yaws_rad = robot.track
    return Recording(
        f'{folder.name}/{number}',
        {str(landmark): place_m for landmark, place_m in robot.landmarks.items()},
        [(row[0], str(int(row[1])), row[2]) for row in robot.sightings],
        np.column_stack([stamps_s, places_m[:, :2], yaws_rad]),
        robot.truth,
        robots.SPEED_M_S,
        2,
        [(row[0], str(int(row[1])), row[3]) for row in robot.sightings],
        robots.odometry_error(0.2),
    )


def read_factor_graph(folder: Path, letter: str) -> Recording:
    """Read what one of five robots measured of the landmarks."""
    path = folder / f'{folder.name}.pyfg'
    rows = [line.split() for line in path.read_text().splitlines()]
    mine = [row for row in rows if len(row) > 2 and row[2].startswith(letter)]
    truth = np.array([row[1:2] + row[3:6] for row in mine if row[0] == 'VERTEX_SE2'], float)
    pose, way = np.zeros(3), [[truth[0, 0], 0.0, 0.0, 0.0]]
    for row in mine:
        if row[0] == 'EDGE_SE2':
            dx, dy, turn = map(float, row[4:7])
            c, s = math.cos(pose[2]), math.sin(pose[2])
            pose = pose + [c * dx - s * dy, s * dx + c * dy, turn]
            way.append([float(row[1]), *pose])
    seen = [
        (float(row[1]), row[3], complex(float(row[4]), float(row[5])))
        for row in mine
        if row[0] == 'EDGE_SE2_XY'
    ]
    return Recording(
        f'{folder.name}/{letter}',
        {row[1]: np.array(row[2:4], float) for row in rows if row[0] == 'VERTEX_XY'},
        [(stamp_s, name, abs(way_m)) for stamp_s, name, way_m in seen],
        np.array(way),
        truth,
        robots.SPEED_M_S,
        2,
        [(stamp_s, name, cmath.phase(way_m)) for stamp_s, name, way_m in seen],
        robots.odometry_error(0.2),
    )


def learn(recording: Recording) -> Bounds:
    """Learn an affine range error and bounds of what it leaves, without gross readings."""
    rows = [row for row in recording.ranges if row[0] <= recording.learned_until_s]
    readings_m = np.array([row[2] for row in rows])
    centers = np.array([recording.anchors[row[1]] for row in rows])
    places = recording.place_m(np.array([row[0] for row in rows]))
    errors_m = readings_m - np.linalg.norm(places - centers, axis=1)
    kept = np.abs(errors_m - np.median(errors_m)) < 0.3 * np.median(readings_m)
    for _ in range(10):
        slope, constant_m = np.polyfit(readings_m[kept], errors_m[kept], 1)
        rest_m = errors_m - constant_m - slope * readings_m
        deviation_m = 1.4826 * float(np.median(np.abs(rest_m[kept])))
        kept = np.abs(rest_m) < GROSS * deviation_m
    low_m, high_m = MARGIN * rest_m[kept].min(), MARGIN * rest_m[kept].max()
    spread_m = float(rest_m[kept].std())
    bounds = Bounds(float(constant_m), float(slope), float(low_m), float(high_m), spread_m)
    if not recording.bearings:
        return bounds
    errors_rad = np.array(
        [
            _off_rad(recording, recording.place_m(stamp_s), _true_yaw(recording, stamp_s), seen)
            for stamp_s, *seen in recording.bearings
            if stamp_s <= recording.learned_until_s
        ]
    )
    kept = np.abs(errors_rad) < GROSS * 1.4826 * np.median(np.abs(errors_rad))
    return replace(
        bounds,
        bearing_half_width_rad=float(MARGIN * np.abs(errors_rad[kept]).max()),
        bearing_deviation_rad=float(errors_rad[kept].std()),
    )


def _off_rad(recording: Recording, place_m: FloatArray, yaw_rad: float, seen: Sequence) -> float:
    """Return a bearing minus the one expected at a pose."""
    name, bearing_rad = seen
    x, y = recording.anchors[name] - place_m
    return math.remainder(bearing_rad - (math.atan2(y, x) - yaw_rad), 2.0 * math.pi)


def events(recording: Recording) -> list[tuple[float, str, tuple[Any, ...]]]:
    """Return ranges, bearings and odometry in order of time."""
    found: list[tuple[float, str, tuple[Any, ...]]] = []
    found += [(stamp_s, 'range', (anchor, r)) for stamp_s, anchor, r in recording.ranges]
    found += [(stamp_s, 'bearing', tuple(seen)) for stamp_s, *seen in recording.bearings]
    found += [(row[0], 'odometry', tuple(row[1:])) for row in recording.odometry]
    return sorted(found, key=lambda event: (event[0], event[1]))


def ours(recording: Recording, bounds: Bounds, ticks_s: FloatArray) -> Iterator[Answer | None]:
    """Answer by the localizer; none where several hypotheses are left."""
    config = FleetConfig(
        ('robot',),
        dimension=recording.dimension,
        anchors={name: Anchor(tuple(place)) for name, place in recording.anchors.items()},
        range_error=RangeErrorModel(bounds.low_m, bounds.high_m, 0.0, 0.0),
        max_speed_m_s=recording.max_speed_m_s,
        max_turn_rate_rad_s=2.0,
        odometry_error=recording.odometry_error,
        memory_s=WINDOW_S if len(recording.odometry) else 0.0,
        memory_max_seconds=math.inf,
        window_outliers=1,
        max_outliers=1,
        bearing_half_width_rad=min(bounds.bearing_half_width_rad, MOST_BEARING_RAD),
    )
    localizer, pending = Localizer(config), iter(events(recording))
    event = next(pending, None)
    for tick_s in ticks_s:
        while event is not None and event[0] <= tick_s:
            stamp_s, kind, values = event
            if kind == 'range':
                corrected_m = bounds.corrected_m(float(values[1]))
                localizer.add_range('robot', str(values[0]), corrected_m, stamp_s, stamp_s)
            elif kind == 'bearing':
                ray = math.cos(values[1]), math.sin(values[1]), 0.0
                localizer.add_bearing('robot', str(values[0]), ray, stamp_s, stamp_s)
            else:
                x, y, yaw = (float(value) for value in values)
                turn = (0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0))
                localizer.add_odometry('robot', (x, y, 0.0), turn, stamp_s, stamp_s, 'odom')
            event = next(pending, None)
        placements = localizer.step(float(tick_s)).placements
        if len(placements) != 1 or placements[0].covariances is None:
            yield None
            continue
        place = recording.place_m(float(tick_s))
        low, high = placements[0].enclosure_m[0]
        q = recording.dimension
        yield Answer(
            placements[0].positions_m[0],
            placements[0].covariances[0, :q, :q],
            bool(np.all((low <= place) & (place <= high))),
            bool(placements[0].heading_known[0]),
        )


def kalman(recording: Recording, bounds: Bounds, ticks_s: FloatArray) -> Iterator[Answer | None]:
    """Answer by an extended Kalman filter that starts at the true pose, with a gate of 3 sigma."""
    q, start_s = recording.dimension, float(ticks_s[0])
    has_odometry = bool(len(recording.odometry))
    # With odometry x, y and yaw; without it a position and a velocity.
    state = np.zeros(3 if has_odometry else 2 * q)
    state[:q] = recording.place_m(start_s)
    if has_odometry:
        state[2] = _true_yaw(recording, start_s)
    covariance = np.diag([0.05**2] * q + [0.02**2 if has_odometry else 0.5**2] * (len(state) - q))
    previous: tuple[Any, ...] | None = None
    now_s = start_s
    pending = [event for event in events(recording) if event[0] >= start_s]
    for tick_s in ticks_s:
        while pending and pending[0][0] <= tick_s:
            stamp_s, kind, values = pending.pop(0)
            if not has_odometry:
                state, covariance = _coasted(state, covariance, stamp_s - now_s, q)
            if kind == 'odometry':
                if previous is not None:
                    noise = recording.odometry_error
                    state, covariance = _moved(state, covariance, previous, values, noise)
                previous = values
            else:
                line = state[:q] - recording.anchors[str(values[0])]
                away_m = max(float(np.linalg.norm(line)), 1e-6)
                slope = np.zeros(len(state))
                if kind == 'range':
                    slope[:q] = line / away_m
                    off, deviation = bounds.corrected_m(values[1]) - away_m, bounds.deviation_m
                else:
                    slope[:3] = [-line[1] / away_m**2, line[0] / away_m**2, -1.0]
                    off = _off_rad(recording, state[:q], state[2], values)
                    deviation = bounds.bearing_deviation_rad
                variance = float(slope @ covariance @ slope) + deviation**2
                if off**2 < 9.0 * variance:
                    gain = covariance @ slope / variance
                    state = state + gain * off
                    covariance = covariance - np.outer(gain, gain) * variance
            now_s = stamp_s
        yield Answer(state[:q].copy(), covariance[:q, :q].copy(), heading_known=has_odometry)


def _coasted(
    state: FloatArray, covariance: FloatArray, step_s: float, q: int
) -> tuple[FloatArray, FloatArray]:
    """Move a position on by its velocity, with white accelerations of 1 m/s^2."""
    change = np.eye(2 * q)
    change[:q, q:] = step_s * np.eye(q)
    noise = np.kron([[step_s**3 / 3.0, step_s**2 / 2.0], [step_s**2 / 2.0, step_s]], np.eye(q))
    return change @ state, change @ covariance @ change.T + noise


def _moved(
    state: FloatArray,
    covariance: FloatArray,
    before: tuple,
    after: tuple,
    error: OdometryErrorModel,
) -> tuple[FloatArray, FloatArray]:
    """Move a pose in the plane on by a step of odometry."""
    dx, dy = after[0] - before[0], after[1] - before[1]
    c, s = math.cos(state[2] - before[2]), math.sin(state[2] - before[2])
    step = np.array([c * dx - s * dy, s * dx + c * dy, after[2] - before[2]])
    change = np.eye(3)
    change[:2, 2] = -step[1], step[0]
    way2 = error.translation_per_m**2 * math.hypot(dx, dy) + 1e-6
    noise = np.diag([way2, way2, error.rotation_per_rad**2 * abs(step[2]) + 1e-7])
    return state + step, change @ covariance @ change.T + noise


def _true_yaw(recording: Recording, stamp_s: float) -> float:
    """Return the true yaw at a time; from the direction of motion where it was not recorded."""
    if recording.truth.shape[1] > 1 + recording.dimension:
        yaws = np.unwrap(recording.truth[:, 3])
        return float(np.interp(stamp_s, recording.truth[:, 0], yaws))
    return _yaw_of_track(recording, stamp_s)


def _yaw_of_track(recording: Recording, stamp_s: float) -> float:
    """Return the yaw that turns a minute of odometry onto the true track."""
    rows = recording.odometry[np.abs(recording.odometry[:, 0] - stamp_s) < 60.0]
    end = recording.place_m(rows[:, 0])
    start = rows[:, 1:3] - rows[:, 1:3].mean(axis=0)
    end = end - end.mean(axis=0)
    turn = math.atan2(
        float(start[:, 0] @ end[:, 1] - start[:, 1] @ end[:, 0]), float((start * end).sum())
    )
    yaws = np.unwrap(recording.odometry[:, 3])
    return turn + float(np.interp(stamp_s, recording.odometry[:, 0], yaws))


def least_squares(
    recording: Recording, bounds: Bounds, ticks_s: FloatArray
) -> Iterator[Answer | None]:
    """Answer by the best of several starts for the readings of the last second (SciPy)."""
    rng, q = np.random.default_rng(0), recording.dimension
    places = np.array([*recording.anchors.values()])
    n_unknowns = q + bool(recording.bearings)
    for tick_s in ticks_s:
        newest_m = _newest(recording.ranges, tick_s)
        ranges_m = {name: bounds.corrected_m(range_m) for name, range_m in newest_m.items()}
        bearings_rad = _newest(recording.bearings, tick_s)
        if len(ranges_m) + len(bearings_rad) <= n_unknowns:
            yield None
            continue
        off = partial(_normalized, recording, bounds, ranges_m, bearings_rad)
        low, high = places.min(axis=0) - 5.0, places.max(axis=0) + 5.0
        turns = np.full(n_unknowns - q, math.pi)
        low, high = np.append(low, -turns), np.append(high, turns)
        fits = [optimize.least_squares(off, rng.uniform(low, high)) for _ in range(10)]
        best = min(fits, key=lambda fit: float(fit.cost))
        normal = best.jac.T @ best.jac + 1e-9 * np.eye(n_unknowns)
        yield Answer(best.x[:q], np.linalg.inv(normal)[:q, :q])


def _newest(rows: Sequence[tuple[float, str, float]], tick_s: float) -> dict[str, float]:
    """Return the newest readings of the last second by anchor."""
    return {name: value for stamp_s, name, value in rows if tick_s - 1.0 <= stamp_s < tick_s}


def _normalized(
    recording: Recording,
    bounds: Bounds,
    ranges_m: Mapping[str, float],
    bearings_rad: Mapping[str, float],
    at: FloatArray,
) -> FloatArray:
    """Return residuals at a place, and a yaw with bearings, over their deviations."""
    place_m, yaws_rad = at[: recording.dimension], at[recording.dimension :]
    off = [
        (range_m - float(np.linalg.norm(place_m - recording.anchors[name]))) / bounds.deviation_m
        for name, range_m in ranges_m.items()
    ]
    off += [
        _off_rad(recording, place_m, yaws_rad[0], seen) / bounds.bearing_deviation_rad
        for seen in bearings_rad.items()
    ]
    return np.array(off)


def smoother(recording: Recording, bounds: Bounds, ticks_s: FloatArray) -> Iterator[Answer | None]:
    """Answer by a factor graph of all readings (iSAM2 of GTSAM) that starts at the true pose."""
    import gtsam

    if not len(recording.odometry):
        return
    start_s, solver = float(ticks_s[0]), gtsam.ISAM2()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    pose = gtsam.Pose2(*recording.place_m(start_s), _true_yaw(recording, start_s))
    start = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.05, 0.05, 0.02]))
    graph.add(gtsam.PriorFactorPose2(0, pose, start))
    values.insert(0, pose)
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(3.0)
    robust, robust_bearing = (
        gtsam.noiseModel.Robust.Create(cauchy, gtsam.noiseModel.Isotropic.Sigma(1, deviation))
        for deviation in (bounds.deviation_m, bounds.bearing_deviation_rad)
    )
    landmarks = {name: gtsam.symbol('l', k) for k, name in enumerate(recording.anchors)}
    for name, key in landmarks.items():
        exact, place = gtsam.noiseModel.Isotropic.Sigma(2, 1e-4), recording.anchors[name]
        graph.add(gtsam.PriorFactorPoint2(key, gtsam.Point2(*place), exact))
        values.insert(key, gtsam.Point2(*place))
    number, before = 0, None
    way: list[tuple[Any, ...]] = []
    seen: list[tuple[str, tuple[Any, ...]]] = []
    pending = [event for event in events(recording) if event[0] >= start_s]
    for tick_s in ticks_s:
        while pending and pending[0][0] <= tick_s:
            _, kind, event = pending.pop(0)
            if kind != 'odometry':
                seen.append((kind, event))
                continue
            way.append(event)
            if seen or len(way) >= 5:
                step = (number, before, way, pose, recording.odometry_error)
                number, before, pose = _add_step(gtsam, graph, values, *step)
                for kind, (name, value) in seen:
                    ends = number, landmarks[name]
                    if kind == 'range':
                        range_m = bounds.corrected_m(value)
                        graph.add(gtsam.RangeFactor2D(*ends, range_m, robust))
                    else:
                        turn = gtsam.Rot2(value)
                        graph.add(gtsam.BearingFactor2D(*ends, turn, robust_bearing))
                way, seen = [], []
        for _ in range(3):
            solver.update(graph, values)
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        pose = solver.calculateEstimatePose2(number)
        turn = np.array(pose.rotation().matrix())
        covariance = turn @ solver.marginalCovariance(number)[:2, :2] @ turn.T
        yield Answer(np.array([pose.x(), pose.y()]), covariance, heading_known=True)


def _add_step(gtsam, graph, values, number, before, way, pose, error) -> tuple:  # type: ignore[no-untyped-def]
    """Add a pose and the odometry since the pose before."""
    first = gtsam.Pose2(*(way[0] if before is None else before))
    step = first.between(gtsam.Pose2(*way[-1]))
    way_m = max(math.hypot(step.x(), step.y()), 1e-3)
    turned = error.rotation_per_rad * abs(step.theta()) + 2e-3
    noise = np.array([error.translation_per_m * way_m + 1e-3] * 2 + [turned])
    model = gtsam.noiseModel.Diagonal.Sigmas(noise)
    graph.add(gtsam.BetweenFactorPose2(number, number + 1, step, model))
    moved = pose.compose(step)
    values.insert(number + 1, moved)
    return number + 1, way[-1], moved


METHODS: dict[str, Method] = {
    'ours, no start': ours,
    'EKF, true start': kalman,
    'least squares, no start': least_squares,
    'factor graph, true start': smoother,
}


def off_truth(recording: Recording, tick_s: float, answer: Answer) -> tuple[float, float]:
    """Return how far an answer is off in m, and its squared Mahalanobis distance."""
    off_m = answer.position_m - recording.place_m(tick_s)
    return float(np.linalg.norm(off_m)), float(
        off_m @ np.linalg.solve(answer.covariance_m2, off_m)
    )


def measure(recording: Recording, bounds: Bounds, method: Method, n_answers: int) -> str:
    """Return one row of the table."""
    end_s = recording.truth[-1, 0]
    ticks_s = np.linspace(recording.learned_until_s, end_s, n_answers + 1)[1:]
    errors_m, wrong, outside, headed = [], 0, 0, 0
    start_s = time.process_time()
    for tick_s, answer in zip(ticks_s, method(recording, bounds, ticks_s), strict=False):
        if answer is None or not np.isfinite(answer.position_m).all():
            continue
        error_m, distance2 = off_truth(recording, float(tick_s), answer)
        errors_m.append(error_m)
        wrong += distance2 > SQUARED_3_SIGMA[recording.dimension]
        outside += answer.inside is False
        headed += answer.heading_known
    spent_ms = 1e3 * (time.process_time() - start_s) / len(ticks_s)
    if not errors_m:
        return f'0 of {len(ticks_s)} | | | | | | {spent_ms:.0f} |'
    n = len(errors_m)
    set_claimed = f'{outside}' if method is ours else ''
    return (
        f'{n} of {len(ticks_s)} | {np.median(errors_m):.2f} | {np.quantile(errors_m, 0.95):.2f} | '
        f'{max(errors_m):.1f} | {100.0 * wrong / n:.1f} % | {set_claimed} | '
        f'{100.0 * headed / n:.0f} % | {spent_ms:.0f} |'
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--only', action='append', help='a recording; may be repeated')
    parser.add_argument('--answers', type=int, default=100, help='answers per recording')
    arguments = parser.parse_args()
    warm_up()
    print('| recording | method | answers | error (m) | 95 % | greatest ', end='')
    print('| confidently wrong | outside the set | heading | ms |')
    print('|' + '---|' * 10)
    for name in arguments.only or RECORDINGS:
        recording = read(arguments.data, name)
        bounds = learn(recording)
        for title, method in METHODS.items():
            try:
                row = measure(recording, bounds, method, arguments.answers)
            except ImportError as error:
                row = f'{error} | | | | | | |'
            print(f'| {name} | {title} | {row}', flush=True)


if __name__ == '__main__':
    main()
