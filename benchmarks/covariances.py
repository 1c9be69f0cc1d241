# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Covariances beside the truth: how many deviations best points are off, in simulation.

    python -m benchmarks.covariances [--seeds 20] [--answers 8] [--only memory latency]

Robots drive among anchors, measure ranges to some of them and see one or two. Every error stays in
its bounds, which is all that the localizer is told: a share of it is a bias that stays, the rest
is drawn anew for each reading. Only answers with one hypothesis count. A row of the table gives
the share of answers beyond three deviations in x, y and yaw, the root mean square of the
deviations, and the median of the normalized squared error per degree of freedom (NEES; 0.79 for a
normal distribution).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    Localizer,
    OdometryErrorModel,
    Placement,
    RangeErrorModel,
)
from dg_localization.fleet.rotations import yaw_of

FloatArray = NDArray[np.float64]

START_S = 100.0
STEP_S = 0.05
SPEED_M_S, TURN_RATE_RAD_S = 1.0, 1.0
HALF_M = 5.0
"""Of the side of the arena."""

PLACES_M = ((-6.0, -5.0), (6.0, -5.5), (5.5, 6.0), (-5.5, 5.0), (0.5, 6.5), (-7.0, 0.5))


@dataclass(frozen=True)
class Case:
    """A world; error models are half widths, `bias` is the share of each error that stays."""

    memory_s: float = 20.0
    robots: int = 1
    anchors: int = 5
    range_m: float = 0.1
    bearing_rad: float = 0.05
    bias: float = 0.0
    per_round: int = 3
    round_s: float = 0.25
    odometry: float = 0.05
    odometry_bias: float = 1.0
    latency_s: float = 0.0
    silent_s: float = 0.0
    rays: bool = True
    ranged_s: float = math.inf
    """From then on rays come without ranges."""

    straight: bool = False
    """Away from two anchors; odometry states the way too long or short by all that is allowed."""


CASES = {
    'moment': Case(memory_s=0.0, per_round=5),
    'moment-bias': Case(memory_s=0.0, per_round=5, bias=1.0),
    'moment-two': Case(memory_s=0.0, per_round=5, robots=2),
    'memory': Case(),
    'memory-bias': Case(bias=0.5),
    'memory-all-bias': Case(bias=1.0),
    'memory-noise': Case(odometry_bias=0.0),
    'memory-exact': Case(range_m=0.02, bearing_rad=0.01),
    'memory-coarse': Case(range_m=0.4, bearing_rad=0.15),
    'memory-sparse': Case(per_round=1, round_s=0.5, anchors=3),
    'memory-rare': Case(per_round=1, round_s=2.0, anchors=3),
    'memory-drift': Case(odometry=0.15),
    'memory-long': Case(memory_s=60.0),
    'memory-two': Case(robots=2, per_round=2),
    'latency': Case(latency_s=0.15),
    'latency-exact': Case(latency_s=0.3, range_m=0.03),
    'ranges': Case(rays=False),
    'ranges-bias': Case(rays=False, bias=0.5),
    'ranges-exact': Case(rays=False, range_m=0.02),
    'ranges-latency': Case(rays=False, latency_s=0.15),
    'ranges-sparse': Case(rays=False, per_round=1, round_s=0.5, anchors=4),
    'ranges-drift': Case(rays=False, odometry=0.15),
    'ranges-coarse': Case(rays=False, range_m=0.5, odometry=0.3, anchors=3, per_round=1),
    'ranges-silence': Case(rays=False, silent_s=2.0),
    'silence': Case(silent_s=2.0),
    'silence-sparse': Case(silent_s=4.0, per_round=1, round_s=1.0),
    'silence-exact': Case(silent_s=1.5, range_m=0.02, bearing_rad=0.01),
    'straight': Case(straight=True, anchors=2, memory_s=8.0, odometry=0.1),
    'straight-rays': Case(straight=True, anchors=2, memory_s=8.0, odometry=0.1, ranged_s=4.0),
}


@dataclass(frozen=True)
class Drive:
    """True poses and the poses that odometry states, shape (n, 3) each, x, y and yaw."""

    true: FloatArray
    stated: FloatArray


def drive(case: Case, rng: np.random.Generator, steps: int) -> Drive:
    """Return a drive that turns back at the walls; odometry errs within its bounds."""
    staying, wide = rng.uniform(-1.0, 1.0, 3), case.odometry
    true = np.array([*rng.uniform(-0.6, 0.6, 2) * HALF_M, rng.uniform(-math.pi, math.pi)])
    stated = np.array([*rng.uniform(-50.0, 50.0, 2), rng.uniform(-math.pi, math.pi)])
    track = []
    speed, rate = (0.7, 0.0) if case.straight else (0.0, 0.0)
    if case.straight:
        true[1:] = -0.6 * HALF_M, 0.5 * math.pi
        staying[0] = math.copysign(1.0, staying[0])
    for step in range(steps):
        if step % 20 == 0 and not case.straight:
            speed = float(rng.choice([0.0, 0.4, 0.9], p=[0.15, 0.35, 0.5]))
            off = math.remainder(math.atan2(-true[1], -true[0]) - true[2], math.tau)
            is_out = math.hypot(*true[:2]) > 0.7 * HALF_M
            rate = float(np.clip(off, -0.8, 0.8) if is_out else rng.uniform(-0.8, 0.8))
        way_m, turn_rad = speed * STEP_S, rate * STEP_S
        anew = rng.uniform(-1.0, 1.0, 3)
        errors = wide * (case.odometry_bias * staying + (1.0 - case.odometry_bias) * anew)
        track.append((true, stated))
        true = _moved(true, way_m, turn_rad)
        # The bounds hold for the stated way.
        stated_way_m = way_m / (1.0 + errors[0])
        stated_turn_rad = (turn_rad - 0.2 * errors[2] * stated_way_m) / (1.0 + errors[1])
        stated = _moved(stated, stated_way_m, stated_turn_rad)
    return Drive(*np.array(track).transpose(1, 0, 2))


def _moved(pose: FloatArray, way_m: float, turn_rad: float) -> FloatArray:
    """Return a pose (x, y, yaw) after a step."""
    middle_rad = pose[2] + 0.5 * turn_rad
    return pose + [way_m * math.cos(middle_rad), way_m * math.sin(middle_rad), turn_rad]


def config_of(case: Case) -> FleetConfig:
    """Return what the localizer is told."""
    wide = case.odometry
    return FleetConfig(
        robots=tuple(f'r{row}' for row in range(case.robots)),
        anchors={f'a{row}': Anchor(place) for row, place in enumerate(PLACES_M[: case.anchors])},
        range_error=RangeErrorModel(-case.range_m, case.range_m, 0.0, 0.0),
        bearing_half_width_rad=case.bearing_rad,
        max_speed_m_s=SPEED_M_S,
        max_turn_rate_rad_s=TURN_RATE_RAD_S,
        memory_s=case.memory_s,
        odometry_error=OdometryErrorModel(
            translation_per_m=wide,
            rotation_per_m=0.2 * wide,
            rotation_per_rad=wide,
            constant_m=0.005,
            constant_rad=0.005,
            latency_s=case.latency_s,
        ),
    )


def answers_of(case: Case, seed: int, count: int) -> Iterator[tuple[Placement, FloatArray]]:
    """Yield placements with the true poses (n, 3), where one hypothesis is left."""
    rng = np.random.default_rng(seed)
    localizer = Localizer(config_of(case))
    first = round(min(8.0, 1.0 + case.memory_s) / STEP_S)
    drives = [drive(case, rng, first + 20 * count) for _ in range(case.robots)]
    names = [*localizer.config.robots, *localizer.config.anchors]
    staying = rng.uniform(-1.0, 1.0, (3, len(names), len(names)))
    late = round(rng.uniform(-1.0, 1.0) * case.latency_s / STEP_S)
    round_steps = round(case.round_s / STEP_S)
    silent_from_s = math.inf
    for step in range(first + 20 * count):
        now_s = START_S + STEP_S * step
        true = np.array([one.true[step] for one in drives])
        places_m = np.vstack([true[:, :2], np.array(PLACES_M[: case.anchors])])
        if case.silent_s and step % 100 == 50:
            silent_from_s = now_s + rng.uniform(0.0, 1.0)
        for row, one in enumerate(drives):
            is_silent = silent_from_s <= now_s < silent_from_s + case.silent_s
            if step % 2 == 0 and not is_silent:
                x, y, yaw = one.stated[min(max(0, step - late), len(one.stated) - 1)]
                quaternion = (0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0))
                localizer.add_odometry(names[row], (x, y, 0.0), quaternion, now_s, now_s)
            if step % round_steps == 0:
                others = [other for other in range(len(names)) if other != row]
                for other in rng.choice(others, min(case.per_round, len(others)), replace=False):
                    anew = rng.uniform(-1.0, 1.0, 2)
                    errors = case.bias * staying[:2, row, other] + (1.0 - case.bias) * anew
                    line_m = places_m[other] - places_m[row]
                    range_m = math.hypot(*line_m) + case.range_m * errors[0]
                    if now_s - START_S < case.ranged_s:
                        localizer.add_range(names[row], names[other], range_m, now_s, now_s)
                    if case.rays and other - case.robots in (0, 1):
                        angle = math.atan2(line_m[1], line_m[0]) - true[row, 2]
                        angle += case.bearing_rad * errors[1]
                        ray = (math.cos(angle), math.sin(angle), 0.0)
                        localizer.add_bearing(names[row], names[other], ray, now_s, now_s)
        if step >= first and step % 20 == 0:
            estimate = localizer.step(now_s)
            if len(estimate.placements) == 1:
                yield estimate.placements[0], true


def deviations_of(
    placement: Placement, true: FloatArray
) -> Iterator[tuple[FloatArray, float, float]]:
    """Yield of each robot the deviations in x, y and yaw, the NEES, and how far it is off in m."""
    assert placement.covariances is not None
    headings, _ = placement.best_headings
    for row, pose in enumerate(true):
        off = np.array([*placement.positions_m[row], yaw_of(headings[row])]) - pose
        off[2] = math.remainder(off[2], math.tau)
        covariance = placement.covariances[row][np.ix_([0, 1, 5], [0, 1, 5])]
        fitted = np.isfinite(off) & np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0.0)
        if not fitted[:2].all():
            continue
        kept = np.flatnonzero(fitted)
        inner = covariance[np.ix_(kept, kept)]
        deviations = np.full(3, np.nan)
        deviations[kept] = np.abs(off[kept]) / np.sqrt(np.diag(inner))
        nees = float(off[kept] @ np.linalg.solve(inner, off[kept])) / len(kept)
        yield deviations, nees, math.hypot(*off[:2])


@dataclass(frozen=True)
class Row:
    """What was found of a case."""

    n_answers: int
    beyond: FloatArray
    rms: FloatArray
    median_nees: float
    median_m: float

    @classmethod
    def of(cls, case: Case, seeds: int, count: int) -> Row:
        """Run a case."""
        found = [
            one
            for seed in range(seeds)
            for placement, true in answers_of(case, seed, count)
            for one in deviations_of(placement, true)
        ]
        deviations = np.array([one[0] for one in found])
        known = np.isfinite(deviations)
        numbers = np.maximum(1, known.sum(axis=0))
        return cls(
            len(found),
            np.count_nonzero(known & (deviations > 3.0), axis=0) / numbers,
            np.sqrt(np.nansum(deviations**2, axis=0) / numbers),
            float(np.median([one[1] for one in found])),
            float(np.median([one[2] for one in found])),
        )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('--seeds', type=int, default=20)
    parser.add_argument('--answers', type=int, default=8, help='of each seed, one a second')
    parser.add_argument('--only', nargs='+', default=[], help='cases whose names begin like this')
    arguments = parser.parse_args()
    print(f'{"case":18}answers  beyond 3: x, y, yaw     rms: x, y, yaw    NEES  off (m)')
    for name, case in CASES.items():
        if arguments.only and not name.startswith(tuple(arguments.only)):
            continue
        row = Row.of(case, arguments.seeds, arguments.answers)
        beyond = '  '.join(f'{100.0 * share:5.1f} %' for share in row.beyond)
        rms = '  '.join(f'{one:4.2f}' for one in row.rms)
        print(
            f'{name:18}{row.n_answers:7}  {beyond}   {rms}   {row.median_nees:5.2f}  '
            f'{row.median_m:.3f}',
            flush=True,
        )


if __name__ == '__main__':
    main()
