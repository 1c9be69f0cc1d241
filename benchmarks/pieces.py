# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Fleets that fall into pieces, with the time that their answers take.

Random fleets of neighbors in range with UWB bounds, ten seeds each; two rigid fours that share a
robot; strips of rigid fours::

    python -m benchmarks.pieces [--seconds 1.0] [--seeds 10]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from itertools import combinations
import math
import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.problems import known_to, problem_of, squared_distances
from dg_localization import Problem, SolverOptions, Verdict, solve

FloatArray = NDArray[np.float64]

SPACING_M = 5.0
"""The side of the square, or cube, that every point has to itself on average."""

SHORTEST_ERROR_M, LONGEST_ERROR_M = -0.05, 1.3
"""By how much a UWB radio reads too long."""

SIZES, DEGREES = (10, 15, 20, 30), (4, 5, 6, 8)


def neighbors(n_points: int, degree: int, dimension: int, seed: int) -> tuple[FloatArray, NDArray]:
    """Return random points in m and their closest pairs, so many that the mean degree results."""
    rng = np.random.default_rng(seed)
    positions = rng.random((n_points, dimension)) * SPACING_M * n_points ** (1.0 / dimension)
    squared = squared_distances(positions)
    pairs = np.stack(np.triu_indices(n_points, 1), axis=1)
    nearest = np.argsort(squared[pairs[:, 0], pairs[:, 1]])[: n_points * degree // 2]
    return positions, pairs[nearest]


def uwb_fleet(n_points: int, degree: int, seed: int, dimension: int = 2) -> Problem:
    """Return a fleet whose ranges are read by UWB radios."""
    positions, pairs = neighbors(n_points, degree, dimension, seed)
    true_m = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)
    errors_m = np.random.default_rng([seed, 1]).uniform(
        SHORTEST_ERROR_M, LONGEST_ERROR_M, len(pairs)
    )
    ranges = {}
    for (i, j), read_m in zip(pairs.tolist(), (true_m + errors_m).tolist(), strict=True):
        nearest_m = max(read_m - LONGEST_ERROR_M, 0.0)
        ranges[i, j] = nearest_m**2, (read_m - SHORTEST_ERROR_M) ** 2
    return problem_of(ranges, n_points, dimension)


def _known(
    positions: FloatArray, bodies: Iterable[Iterable[int]], relative_error: float
) -> Problem:
    """Return the problem in which all distances within bodies are known to a relative error."""
    squared = squared_distances(positions)
    pairs = {pair for body in bodies for pair in combinations(sorted(body), 2)}
    ranges = {pair: known_to(relative_error, squared[pair]) for pair in sorted(pairs)}
    return problem_of(ranges, len(positions), positions.shape[1])


def two_fours(relative_error: float = 0.01) -> Problem:
    """Return two rigid fours that share a robot."""
    positions = np.random.default_rng(3).random((7, 2)) * 10.0
    return _known(positions, [(0, 1, 2, 3), (3, 4, 5, 6)], relative_error)


def strip(length: int, relative_error: float = 0.01) -> Problem:
    """Return so many rigid fours, each of which shares two robots with the next."""
    grid = np.array([[x // 2, x % 2] for x in range(2 * length + 2)]) * SPACING_M
    positions = grid + np.random.default_rng(0).uniform(-1.0, 1.0, grid.shape)
    return _known(positions, [range(2 * x, 2 * x + 4) for x in range(length)], relative_error)


def _timed(problem: Problem, options: SolverOptions) -> tuple[float, Verdict, int, int]:
    """Return the milliseconds of a solve, its verdict, its pieces and its hypotheses."""
    start = time.perf_counter()
    result = solve(problem, options)
    milliseconds = 1e3 * (time.perf_counter() - start)
    return milliseconds, result.verdict, len(result.pieces), result.n_hypotheses


def fleets(seconds: float, n_seeds: int) -> None:
    """Print how many fleets run out of time, and how long they take."""
    options = SolverOptions(max_boxes=10**9, max_seconds=seconds)
    print('| fleet | out of budget | median | longest | pieces |\n|---|---|---|---|---|')
    for n_points in SIZES:
        for degree in DEGREES:
            problems = [uwb_fleet(n_points, degree, seed) for seed in range(n_seeds)]
            answers = [_timed(problem, options) for problem in problems]
            taken_ms = sorted(answer[0] for answer in answers)
            out = [seed for seed, a in enumerate(answers) if a[1] is Verdict.OUT_OF_BUDGET]
            pieces = np.median([answer[2] for answer in answers])
            print(
                f'| n = {n_points}, degree {degree} | {len(out)} of {n_seeds} {out or ""} '
                f'| {np.median(taken_ms):.1f} ms | {taken_ms[-1]:.0f} ms | {pieces:.0f} |',
                flush=True,
            )


def chains() -> None:
    """Print what known chains of pieces take."""
    print('\n| chain | time | pieces | hypotheses |\n|---|---|---|---|')
    cases = {'two fours, hinged': two_fours()}
    cases |= {f'strip of {length} fours': strip(length) for length in (10, 20, 40)}
    for name, problem in cases.items():
        best = min(_timed(problem, SolverOptions()) for _ in range(5))
        taken_ms, _, n_pieces, n_hypotheses = best
        power = math.log2(n_hypotheses)
        print(f'| {name} | {taken_ms:.1f} ms | {n_pieces} | 2^{power:g} |')


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--seconds', type=float, default=1.0, help='the time of one fleet')
    parser.add_argument('--seeds', type=int, default=10, help='fleets of each kind')
    arguments = parser.parse_args()
    solve(two_fours())
    fleets(arguments.seconds, arguments.seeds)
    chains()


if __name__ == '__main__':
    main()
