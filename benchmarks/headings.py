# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Shape first, then headings: what ranges and odometry tell fleets that move.

    python -m benchmarks.headings [--runs 50] [--cells 128] [--robots 2 3 4 6]

Every pair of robots ranges at 5 Hz to 3 %; odometry errs by 5 % of the way and of the turn. The
places now are known to 0.1 m in a frame of their own, of which the mirror image is as good.
"""

from __future__ import annotations

import argparse
from itertools import combinations
import math
import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.pairs import SimulatedRobot, rotation
from dg_localization.interval.arrays import Interval
from dg_localization.pairs import HeadingOptions, PairReadings, narrow_headings

FloatArray = NDArray[np.float64]

RANGE_ERROR = 0.03
ODOMETRY_ERROR = 0.05
EVERY = 2
"""A range at every second sample of the odometry."""
PLACE_ERROR_M = 0.1
MIRROR = np.array([1.0, -1.0, 1.0])


def fleet(
    seed: int, robots: int, seconds: float
) -> tuple[dict[tuple[int, int], PairReadings], FloatArray, FloatArray]:
    """Simulate a fleet; return readings by pair, and places and headings at the end."""
    rng = np.random.default_rng([seed, robots])
    members = [SimulatedRobot.drive(rng, seconds, ODOMETRY_ERROR) for _robot in range(robots)]
    count = len(members[0].yaws_rad)
    picked = np.arange(count - 1, -1, -EVERY)[::-1]
    stamps = picked * 0.1
    origin = Interval.point(np.zeros((len(stamps), 3)))
    points = [member.path.past_poses(stamps, stamps[-1]).points_now(origin) for member in members]
    readings = {}
    for a, b in combinations(range(robots), 2):
        ranges = np.linalg.norm(members[b].positions_m - members[a].positions_m, axis=-1)[picked]
        ranges *= 1.0 + rng.uniform(-RANGE_ERROR, RANGE_ERROR, len(ranges))
        bounds = Interval(ranges / (1.0 + RANGE_ERROR), ranges / (1.0 - RANGE_ERROR))
        readings[a, b] = PairReadings.of(points[a], points[b], bounds)
    places = np.array([member.positions_m[-1] for member in members])
    headings = np.array([member.yaws_rad[-1] for member in members])
    # Any frame: that of the simulation, turned.
    angle = rng.uniform(-math.pi, math.pi)
    return readings, places @ rotation(angle).T, headings + angle


def bounds_of(places_m: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return bounds of places that hold them anywhere."""
    flat = np.array([1.0, 1.0, 0.0])
    middle = places_m + rng.uniform(-PLACE_ERROR_M, PLACE_ERROR_M, places_m.shape) * flat
    return middle - PLACE_ERROR_M * flat, middle + PLACE_ERROR_M * flat


def study(robots: int, runs: int, seconds: float, options: HeadingOptions) -> str:
    """Return a row of figures over many fleets."""
    inside, ruled_out, widths, below, gains, seconds_used = 0, 0, [], 0, [], []
    for seed in range(runs):
        readings, places_m, headings = fleet(seed, robots, seconds)
        rng = np.random.default_rng(seed)
        lower_m, upper_m = bounds_of(places_m, rng)
        start = time.process_time()
        found = narrow_headings(lower_m, upper_m, readings, options)
        seconds_used.append(time.process_time() - start)
        cells = np.floor(np.remainder(headings, 2.0 * math.pi) / (2.0 * math.pi) * options.cells)
        inside += bool(
            found.possible
            and np.all(found.allowed[np.arange(robots), cells.astype(int)])
            and np.all((found.lower_m <= places_m) & (places_m <= found.upper_m))
        )
        if found.possible:
            arcs = [np.subtract(*found.arc_rad(body)[::-1]) for body in range(robots)]
            widths += arcs
            below += max(arcs) < 1.0
            gains.append(np.mean((found.upper_m - found.lower_m)[:, :2]) / (2.0 * PLACE_ERROR_M))
        low_m, high_m = np.sort(np.stack([lower_m * MIRROR, upper_m * MIRROR]), axis=0)
        ruled_out += not narrow_headings(low_m, high_m, readings, options).possible
    low, middle, high = np.percentile(widths, [5, 50, 95])
    fast, slow = np.percentile(seconds_used, [50, 95])
    return (
        f'| {robots} | {seconds:.0f} | {inside} of {runs} | {ruled_out} of {runs} | '
        f'{middle:.2f} ({low:.2f} to {high:.2f}) | {below} of {runs} | {np.median(gains):.2f} | '
        f'{1000.0 * fast:.0f} ({1000.0 * slow:.0f}) |'
    )


def main() -> None:
    """Read the command line and print the table."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.headings', description=__doc__)
    parser.add_argument('--runs', type=int, default=50)
    parser.add_argument('--cells', type=int, default=128)
    parser.add_argument('--seconds', type=float, nargs='+', default=[14.0])
    parser.add_argument('--robots', type=int, nargs='+', default=[2, 3, 4, 6])
    arguments = parser.parse_args()
    options = HeadingOptions(cells=arguments.cells)
    study(2, 1, 3.0, options)
    print(
        '| robots | seconds | truth inside | mirror image ruled out | heading width (rad) '
        '| all below 1 rad | width of places left | ms (95 %) |'
    )
    for robots in arguments.robots:
        for seconds in arguments.seconds:
            print(study(robots, arguments.runs, seconds, options), flush=True)


if __name__ == '__main__':
    main()
