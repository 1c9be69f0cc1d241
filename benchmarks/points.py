# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The published point: how far it is from the truth, as any placement and as the best one.

    python -m benchmarks.points mrclam [--every 5] [--excerpt excerpt_D7_t200_440] [--memory 30]
    python -m benchmarks.points tiers [--every 20]
    python -m benchmarks.points lias

MRCLAM (UTIAS, Leung et al., IJRR 30(8), 2011): five robots with cameras, the landmarks as anchors,
readings of the last two seconds and, with --memory, of the time before; the same readings go to an
extended Kalman filter that knows where the robots start. TIERS: four robots that range by
ultra-wideband, one epoch at a time; their shape is laid on the true one, as its mirror image where
that fits better. LIAS: three tags on a trolley among eight anchors.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator
import csv
from dataclasses import dataclass, field, replace
import json
import math
from pathlib import Path
import time
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.kalman_filter import Deviations, KalmanFilter
from dg_localization import SolverOptions
from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    Localizer,
    OdometryErrorModel,
    Placement,
    RangeErrorModel,
    Snapshot,
    warm_up,
)
from dg_localization.fleet.best_point.best_point import BestPoint, BestPointFinder
from dg_localization.fleet.best_point.past import past_of
from dg_localization.fleet.best_point.readings import terms_of
from dg_localization.fleet.best_point.terms import Term
from dg_localization.fleet.directions import best_rotation
from dg_localization.fleet.frames import finders, placer
from dg_localization.fleet.rotations import yaw_of

FloatArray = NDArray[np.float64]

NUMBERS = range(1, 6)
LATE_S = 0.05
"""Measurement stamps of MRCLAM are late by about this much."""


@dataclass
class Tally:
    """Figures of many answers."""

    off_m: list[FloatArray] = field(default_factory=list)
    off_rad: list[float] = field(default_factory=list)
    deviations: list[FloatArray] = field(default_factory=list)
    proved: list[bool] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def row(self, name: str) -> str:
        """Return a row of the table."""
        off_m = np.concatenate(self.off_m)
        middle, most = np.percentile(off_m, [50, 95])
        yaw, most_yaw = np.percentile(self.off_rad or [math.nan], [50, 95])
        milliseconds = 1e3 * np.median(self.seconds or [math.nan])
        within = np.mean(np.concatenate(self.deviations) < 2.0) if self.deviations else math.nan
        return (
            f'| {name} | {len(off_m)} | {middle:.3f} | {most:.3f} | {yaw:.3f} | {most_yaw:.3f} | '
            f'{_share(self.proved)} | {within:.0%} | {milliseconds:.2f} |'
        )


def _share(values: list[bool]) -> str:
    return f'{np.mean(values):.0%}' if values else ''


HEAD = (
    '| point | positions | off by (m) | 95 % (m) | yaw off by (rad) | 95 % (rad) | proved '
    '| coordinates within two deviations | ms |\n|---|---|---|---|---|---|---|---|---|'
)


class Points:
    """
    The points of snapshots: any placement, and the best one.

    Parameters
    ----------
    config : FleetConfig

    """

    def __init__(self, config: FleetConfig) -> None:
        self.localizer = Localizer(config)
        self.tallies = {'any placement': Tally(), 'best point': Tally()}

    def answers(self, snapshot: Snapshot) -> Iterator[tuple[Tally, tuple[Placement, ...]]]:
        """Yield the placements of a snapshot, as any ones and as the best ones."""
        for name, tally in self.tallies.items():
            # Without readings to fit, the point is the placement that the fit starts from.
            is_any = name == 'any placement'
            of_now, of_before = (no_terms, no_past) if is_any else (terms_of, past_of)
            with (
                patch.object(finders, 'terms_of', of_now),
                patch.object(finders, 'past_of', of_before),
                patch.object(placer, 'past_of', of_before),
                patch.object(BestPointFinder, 'find', timed(tally.seconds)),
            ):
                yield tally, self.localizer.estimate(snapshot).placements

    def table(self) -> str:
        """Return the figures."""
        return '\n'.join([HEAD, *(tally.row(name) for name, tally in self.tallies.items())])


def no_terms(*_: object) -> Iterator[Term]:
    """Yield nothing."""
    return iter(())


def no_past(*_: object) -> None:
    """Return nothing."""


def timed(seconds: list[float]) -> Callable[..., BestPoint]:
    """Return a method that finds the best point and notes how long that takes."""
    find = BestPointFinder.find

    def measured(*arguments: Any) -> BestPoint:
        begin = time.process_time()
        found = find(*arguments)
        seconds.append(time.process_time() - begin)
        return found

    return measured


@dataclass(frozen=True)
class Drive:
    """An excerpt of MRCLAM: what happened when, and where the robots truly were."""

    truth: dict[int, FloatArray]
    landmarks: dict[str, FloatArray]
    events: list[tuple[float, int, str, FloatArray, float]]

    @classmethod
    def load(cls, folder: Path) -> Drive:
        """Read the files of an excerpt."""
        rows = {path.name: np.loadtxt(path, ndmin=2) for path in folder.glob('*.dat')}
        landmarks = {f'm{int(row[0])}': row[1:3] for row in rows['Landmark_Groundtruth.dat']}
        names = {
            int(barcode): f'r{int(subject)}' if subject in NUMBERS else f'm{int(subject)}'
            for subject, barcode in rows['Barcodes.dat']
        }
        events = []
        for k in NUMBERS:
            for stamp_s, barcode, range_m, bearing_rad in rows[f'Robot{k}_Measurement.dat']:
                target = names.get(int(barcode), f'r{k}')
                if target != f'r{k}':
                    reading = np.array([range_m, 0.0])
                    events.append((stamp_s - LATE_S, k, target, reading, bearing_rad))
            events += dead_reckoning(k, rows[f'Robot{k}_Odometry.dat'])
        events.sort(key=lambda event: event[0])
        truth = {k: rows[f'Robot{k}_Groundtruth.dat'] for k in NUMBERS}
        return cls(truth, landmarks, events)

    def poses(self, stamp_s: float) -> FloatArray:
        """Return x, y and yaw of all robots."""
        columns = [(t[:, 0], *t[:, 1:3].T, np.unwrap(t[:, 3])) for t in self.truth.values()]
        return np.array([[np.interp(stamp_s, c[0], v) for v in c[1:]] for c in columns])


def dead_reckoning(
    robot: int, rows: FloatArray
) -> Iterator[tuple[float, int, str, FloatArray, float]]:
    """Yield odometry poses from speeds and turn rates."""
    position_m, yaw = np.zeros(2), 0.0
    for (before_s, speed, rate), (stamp_s, *_) in zip(rows[:-1], rows[1:], strict=True):
        step_s = stamp_s - before_s
        middle = yaw + rate * step_s / 2.0
        position_m = position_m + speed * step_s * np.array([math.cos(middle), math.sin(middle)])
        yaw += rate * step_s
        yield stamp_s, robot, '', position_m, yaw


def feed(localizer: Localizer, event: tuple[float, int, str, FloatArray, float]) -> None:
    """Hand an event on."""
    stamp_s, number, target, values, angle = event
    robot = f'r{number}'
    if not target:
        orientation = [0.0, 0.0, math.sin(angle / 2.0), math.cos(angle / 2.0)]
        localizer.add_odometry(robot, [*values, 0.0], orientation, stamp_s, stamp_s)
        return
    localizer.add_range(robot, target, values[0], stamp_s, stamp_s)
    ray = [math.cos(angle), math.sin(angle), 0.0]
    localizer.add_bearing(robot, target, ray, stamp_s, stamp_s)


def mrclam(arguments: argparse.Namespace) -> None:
    """Print the figures of an excerpt."""
    drive = Drive.load(arguments.data / 'mrclam' / arguments.excerpt)
    error = RangeErrorModel(
        min_error_relative=-0.15,
        max_error_relative=0.15,
        expected_error_m=arguments.expected_error,
    )
    config = FleetConfig(
        robots=tuple(f'r{k}' for k in NUMBERS),
        anchors={name: Anchor(tuple(xy), 0.01) for name, xy in drive.landmarks.items()},
        max_age_s=2.0,
        memory_s=arguments.memory,
        memory_max_seconds=math.inf,
        odometry_error=OdometryErrorModel(
            translation_per_m=0.1, rotation_per_rad=0.2, constant_m=0.04, constant_rad=0.12
        ),
        window_outliers=5,
        max_speed_m_s=0.2,
        max_turn_rate_rad_s=0.6,
        range_error=error,
        bearing_half_width_rad=0.12,
        max_outliers=1,
        solver=SolverOptions(resolution=0.1, max_boxes=200),
    )
    points, start_s = Points(config), drive.events[0][0]
    peer = KalmanFilter(drive.poses(start_s), config.robots, drive.landmarks, Deviations())
    filtered = Tally()
    events = iter(drive.events)
    event = next(events, None)
    for now_s in np.arange(start_s + arguments.skip, drive.events[-1][0], arguments.every):
        while event is not None and event[0] <= now_s:
            feed(points.localizer, event)
            _feed_peer(peer, event)
            event = next(events, None)
        poses = drive.poses(now_s)
        _tally_peer(filtered, peer.poses, poses)
        for tally, placements in points.answers(points.localizer.snapshot(now_s)):
            if len(placements) == 1:
                _tally_poses(tally, placements[0], poses)
    print(points.table())
    print(filtered.row('Kalman filter, true start'))
    ours, theirs = (
        np.percentile(np.concatenate(tally.off_m), [50, 95])
        for tally in (points.tallies['best point'], filtered)
    )
    print('best point / Kalman filter: {:.2f} (95 %: {:.2f})'.format(*ours / theirs))


def _feed_peer(peer: KalmanFilter, event: tuple[float, int, str, FloatArray, float]) -> None:
    """Hand an event on to the filter."""
    stamp_s, number, target, values, angle = event
    if target:
        peer.correct(f'r{number}', target, float(values[0]), angle)
    else:
        peer.predict(f'r{number}', np.array([*values, angle]), stamp_s)


def _tally_peer(tally: Tally, found: FloatArray, poses: FloatArray) -> None:
    """Compare the poses of the filter with the truth."""
    off = found - poses
    tally.off_m.append(np.linalg.norm(off[:, :2], axis=1))
    tally.off_rad += [abs(math.remainder(turn, 2.0 * math.pi)) for turn in off[:, 2]]


def _tally_poses(tally: Tally, placement: Placement, poses: FloatArray) -> None:
    """Compare the only placement with the truth, where it has bounds."""
    bounded = np.isfinite(placement.enclosure_m).all(axis=(1, 2))
    bounded &= np.isfinite(placement.positions_m).all(axis=1)
    off = (placement.positions_m - poses[:, :2])[bounded]
    tally.off_m.append(np.linalg.norm(off, axis=1))
    tally.proved.append(placement.proved)
    if placement.covariances is not None:
        variances = np.diagonal(placement.covariances, axis1=1, axis2=2)[bounded, :2]
        tally.deviations.append((np.abs(off) / np.sqrt(variances)).ravel())
    orientations_xyzw, _ = placement.best_headings
    for row in np.flatnonzero(placement.heading_known):
        turn = yaw_of(orientations_xyzw[row]) - poses[row, 2]
        tally.off_rad.append(abs(math.remainder(turn, 2.0 * math.pi)))


def tiers(arguments: argparse.Namespace) -> None:
    """Print the figures of the epochs of TIERS."""
    error = RangeErrorModel(
        min_error_m=-0.05,
        max_error_m=1.3,
        min_error_relative=0.0,
        max_error_relative=0.0,
        expected_error_m=arguments.expected_error,
    )
    config = FleetConfig(robots=('r1', 'r3', 'r4', 'r5'), range_error=error, max_repeats=1)
    points = Points(config)
    epochs = _epochs(arguments.data / 'tiers_uwb/20221011_processed.csv')
    for stamp_s, pairs in list(epochs.items())[:: int(arguments.every)]:
        points.localizer.reset()
        squared_m2 = np.zeros((4, 4))
        for (first, second), (measured_m, apart_m) in pairs.items():
            points.localizer.add_range(first, second, measured_m, stamp_s, stamp_s)
            a, b = config.robots.index(first), config.robots.index(second)
            squared_m2[a, b] = squared_m2[b, a] = apart_m**2
        true_m = _planar(squared_m2)
        for tally, placements in points.answers(points.localizer.snapshot(stamp_s)):
            fits = [_fitted(placement.positions_m, true_m) for placement in placements]
            best = int(np.argmin([fit.sum() for fit in fits]))
            tally.off_m.append(fits[best])
            tally.proved.append(placements[best].proved)
    print(points.table())


def _epochs(path: Path) -> dict[float, dict[tuple[str, str], tuple[float, float]]]:
    """Return measured and true distances by time and pair."""
    epochs: dict[float, dict[tuple[str, str], tuple[float, float]]] = defaultdict(dict)
    with path.open() as file:
        for row in csv.DictReader(file):
            pair = tuple(f'r{float(row[node]):.0f}' for node in ('node1', 'node2'))
            distances = float(row['uwb_range']), float(row['mocap_range'])
            epochs[float(row['timestamp'])][pair[0], pair[1]] = distances
    return epochs


def _planar(squared_m2: FloatArray) -> FloatArray:
    """Return the placement in the plane nearest to squared distances (classical scaling)."""
    centering = np.eye(len(squared_m2)) - 1.0 / len(squared_m2)
    values, vectors = np.linalg.eigh(-0.5 * centering @ squared_m2 @ centering)
    return np.asarray(vectors[:, -2:] * np.sqrt(values[-2:]))


def _fitted(positions_m: FloatArray, true_m: FloatArray) -> FloatArray:
    """Return how far each point is off after the best rotation, reflection and translation."""
    centered, wanted = positions_m - positions_m.mean(axis=0), true_m - true_m.mean(axis=0)
    offs = []
    for sign in (1.0, -1.0):
        imaged = centered * np.array([1.0, sign])
        turned = imaged @ best_rotation(imaged, wanted).T
        offs.append(np.linalg.norm(turned - wanted, axis=1))
    return min(offs, key=lambda off: float(off.sum()))


def lias(arguments: argparse.Namespace) -> None:
    """Print the figures of three tags on a trolley among eight anchors."""
    folder = arguments.data / 'lias_uwb'
    cart = json.loads((folder / 'geometry.json').read_text())['14']
    anchors = {f'a{k}': place for k, place in enumerate(cart['anchors'])}
    config = FleetConfig(
        robots=('cart',),
        mounts={'cart': {f't{k}': tuple(tag[:2]) for k, tag in enumerate(cart['tags'])}},
        anchors={name: Anchor(tuple(place[:2])) for name, place in anchors.items()},
        elevations_m={
            'cart': (0.96, 0.985),
            **{name: (place[2], place[2]) for name, place in anchors.items()},
        },
        range_error=RangeErrorModel(-0.05, 0.6, 0.0, 0.0),
        solver=SolverOptions(resolution=0.02),
    )
    print(
        '| readings of each pair | answers | pose inside | enclosure (m) | point off by (m) '
        '| heading bound (rad) | heading off by (rad) | ms |\n|---|---|---|---|---|---|---|---|'
    )
    for readings in (1, 8):
        rows = [
            _trolley(Localizer(replace(config, max_repeats=readings)), cart, path, readings)
            for path in sorted(folder.glob('UWB_static_*.csv'))
        ]
        inside, *others = np.array(rows).T
        width, off, bound, turn, seconds = (float(np.median(values)) for values in others)
        print(
            f'| {readings} | {len(rows)} | {int(inside.sum())} | {width:.2f} | {off:.2f} | '
            f'{bound:.2f} | {turn:.2f} | {1e3 * seconds:.0f} |'
        )


def _trolley(
    localizer: Localizer, cart: dict[str, Any], path: Path, readings: int
) -> tuple[float, ...]:
    """Return whether the pose is inside, widths, errors and the time of an answer."""
    *_, site, _, turn_deg = path.stem.split('_')
    yaw_deg, x, y = cart['poses_yawdeg_x_y'][site[-1]][int(turn_deg) // 60]
    with path.open() as file:
        rows = [row[1:25] for row, _ in zip(csv.reader(file), range(readings), strict=False)]
    for number, text in enumerate(value for row in rows for value in row):
        anchor, tag = divmod(number % 24, 3)
        if text:
            localizer.add_range(f'cart/t{tag}', f'a{anchor}', float(text), 1.0, 1.0)
    begin = time.perf_counter()
    (placement,) = localizer.step(1.0).placements
    seconds = time.perf_counter() - begin
    low, high = placement.enclosure_m[0]
    yaw_rad = yaw_of(placement.orientations_xyzw[0])
    turn = abs(math.remainder(yaw_rad - math.radians(yaw_deg), 2.0 * math.pi))
    half_width = float(placement.heading_half_width_rad[0])
    inside = bool((low <= [x, y]).all() and ([x, y] <= high).all()) and turn <= half_width
    off_m = float(np.linalg.norm(placement.positions_m[0] - [x, y]))
    return float(inside), float((high - low).max()), off_m, half_width, turn, seconds


def main() -> None:
    """Read the command line and print the table."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.points', description=__doc__)
    parser.add_argument('recording', choices=('mrclam', 'tiers', 'lias'))
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--excerpt', default='excerpt_D7_t200_440')
    parser.add_argument('--every', type=float, default=5.0)
    parser.add_argument('--skip', type=float, default=2.0, metavar='SECONDS', help='at first')
    parser.add_argument('--expected-error', type=float)
    parser.add_argument('--memory', type=float, default=0.0, metavar='SECONDS')
    arguments = parser.parse_args()
    warm_up()
    {'mrclam': mrclam, 'tiers': tiers, 'lias': lias}[arguments.recording](arguments)


if __name__ == '__main__':
    main()
