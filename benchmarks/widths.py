# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
How wide the answers are, over the linearized hull, and what each step of tightening costs.

Random trilaterable fleets; the pairs that were not measured, in the hypothesis that holds the
truth::

    python -m benchmarks.widths [--seeds 4]
    python -m benchmarks.widths --networks

The second line is for the networks in space of `benchmarks.pieces`, whose pairs that were measured
to an interval are compared, too.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.exact import linearized_hull, measured_pairs, unknown_pairs
from benchmarks.pieces import network
from benchmarks.problems import Pair, random_fleet, squared_distances
from dg_localization import Problem, Result, SolverOptions, solve

FloatArray = NDArray[np.float64]

FLEETS = ((10, 2, 0.01), (20, 2, 0.01), (10, 2, 0.03), (20, 2, 0.03), (10, 3, 0.01))
"""Number of points, dimension and relative error of the ranges."""

MAX_PAIRS = 40
"""Widths are compared on so many pairs of a fleet, drawn at random."""

RUNS = 3


@dataclass
class Effort:
    """What one way of solving came to: ratios of widths, and seconds, of several fleets."""

    ratios: list[float]
    seconds: list[float]

    def cells(self, base_seconds: float) -> str:
        """Return the median and largest ratio and the time, for a table."""
        if not self.ratios:
            return 'truth in no hypothesis | '
        times = np.median(self.seconds) / base_seconds
        return (
            f'{np.median(self.ratios):.2f} / {max(self.ratios):.2f} '
            f'| {1e3 * np.median(self.seconds):.1f} ms ({times:.1f}x)'
        )


def ratios_of(result: Result, problem: Problem, positions: FloatArray) -> list[float]:
    """Return the widths of unknown pairs over the linearized hull where the truth is."""
    squared = squared_distances(positions)
    slack = 1e-12 * squared.max()
    pairs = unknown_pairs(problem)
    chosen = np.random.default_rng(0).permutation(len(pairs))[:MAX_PAIRS]
    pairs = [pairs[number] for number in chosen]
    hull = linearized_hull(problem, positions, pairs)
    rows, columns = np.array(pairs).T
    for found in result.hypotheses:
        if (found.lower <= squared + slack).all() and (found.upper >= squared - slack).all():
            width = found.upper[rows, columns] - found.lower[rows, columns]
            return list(width / (hull[:, 1] - hull[:, 0]))
    return []


def networks(n_pairs: int = 20) -> None:
    """Print the median widths of some pairs of each network, in its largest piece."""
    print('Median widths in m of the linearized hull and of the answer, and the median ratio.\n')
    print('| points | unmeasured | measured to 0.1 m |\n|---|---|---|')
    options = SolverOptions(max_boxes=10**9, max_seconds=60.0)
    for number in range(10):
        problem, positions = network(number)
        result = solve(problem, options)
        inside = set(max(result.pieces, key=lambda piece: len(piece.points)).points)
        known = [pair for pair in measured_pairs(problem) if _width_m(problem, pair) > 0.0]
        cells = []
        for pairs in (unknown_pairs(problem), known):
            pairs = [pair for pair in pairs if inside.issuperset(pair)]
            chosen = np.random.default_rng(0).permutation(len(pairs))[:n_pairs]
            cells.append(_network_cell(result, problem, positions, [pairs[k] for k in chosen]))
        print(f'| {problem.n_points} | {" | ".join(cells)} |', flush=True)


def _network_cell(
    result: Result, problem: Problem, positions: FloatArray, pairs: list[Pair]
) -> str:
    """Return the median widths of some pairs of a network, for a table."""
    if not pairs:
        return ''
    hull_m = np.sqrt(np.maximum(linearized_hull(problem, positions, pairs), 0.0))
    wide_m = hull_m[:, 1] - hull_m[:, 0]
    found_m = np.array([_width_m(result, pair) for pair in pairs])
    ratio = np.median(found_m / wide_m)
    return f'{np.median(wide_m):.2f}, {np.median(found_m):.2f}: {ratio:.1f}'


def _width_m(bounds: Problem | Result, pair: Pair) -> float:
    """Return how wide the bounds of a distance are."""
    return float(np.sqrt(bounds.upper[pair]) - np.sqrt(max(bounds.lower[pair], 0.0)))


def timed(problem: Problem, options: SolverOptions) -> tuple[float, Result]:
    """Return the shortest time of a few solves in seconds, and the answer."""
    taken_s = []
    for _ in range(RUNS):
        start = time.perf_counter()
        result = solve(problem, options)
        taken_s.append(time.perf_counter() - start)
    return min(taken_s), result


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--seeds', type=int, default=4, help='fleets of each kind')
    parser.add_argument('--networks', action='store_true', help='only the networks in space')
    arguments = parser.parse_args()
    if arguments.networks:
        networks()
        return
    ways = (0.0, np.inf)
    print('Ratio: median / largest width over the linearized hull. Time: the median fleet.\n')
    print('| fleet | one pass | time | linear programs | time |')
    print('|---|---|---|---|---|')
    solve(random_fleet(10, 2, 0.01, 0)[0], SolverOptions(tighten_seconds=np.inf))
    for n_points, dimension, relative_error in FLEETS:
        efforts = [Effort([], []) for _ in ways]
        for seed in range(arguments.seeds):
            problem, positions = random_fleet(n_points, dimension, relative_error, seed)
            for effort, tighten_s in zip(efforts, ways, strict=True):
                seconds, result = timed(problem, SolverOptions(tighten_seconds=tighten_s))
                effort.seconds.append(seconds)
                effort.ratios.extend(ratios_of(result, problem, positions))
        base_s = float(np.median(efforts[0].seconds))
        cells = ' | '.join(effort.cells(base_s) for effort in efforts)
        print(f'| n = {n_points}, {dimension}D, +-{relative_error:.0%} | {cells} |', flush=True)


if __name__ == '__main__':
    main()
