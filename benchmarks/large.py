# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Large fleets of neighbors in range: time, memory, and whether the truth is in the answer.

Every seed counts, whatever its fleet falls into. Each fleet is solved in a process of its own, so
that its memory is its own::

    python -m benchmarks.large [--sizes 30 100 300 1000] [--seeds 3] [--seconds 2]
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
import resource
import time

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.pieces import SPACING_M
from benchmarks.problems import known_to, squared_distances
from dg_localization import Problem, Result, SolverOptions, Verdict, solve
from dg_localization.solver.solve import load_kernels

FloatArray = NDArray[np.float64]

DEGREES, ERRORS = (8, 10), (0.01, 0.03)
ROUNDING = 1e-12

MOST_LOOKED_AT = 200
"""Of a piece of more points the pairs of so many are compared with the truth."""


@dataclass(frozen=True)
class Measured:
    """What came of one fleet."""

    verdict: Verdict
    holds_truth: bool
    seconds: float
    cpu_seconds: float
    overrun: float
    memory_mb: float
    largest: int
    n_patches: int
    n_ambiguous: int
    proved: bool


def fleet(n_points: int, degree: int, error: float, seed: int) -> tuple[Problem, FloatArray]:
    """Return a fleet whose closest pairs are measured to a relative error, and its placement."""
    positions = np.random.default_rng(seed).random((n_points, 2)) * SPACING_M * n_points**0.5
    n_pairs = n_points * degree // 2
    radius_m, pairs = 0.5 * SPACING_M * degree**0.5, np.empty((0, 2), dtype=np.int64)
    while len(pairs) < n_pairs:
        radius_m *= 1.1
        pairs = cKDTree(positions).query_pairs(radius_m, output_type='ndarray')
    squared = ((positions[pairs[:, 0]] - positions[pairs[:, 1]]) ** 2).sum(axis=1)
    nearest = np.argsort(squared)[:n_pairs]
    lower, upper = known_to(error, squared[nearest])
    first, second = pairs[nearest].T
    return Problem.from_pairs(n_points, first, second, lower, upper), positions


def holds(result: Result, positions: FloatArray) -> bool:
    """Tell whether each piece, and each of its patches, has a hypothesis that holds the truth."""
    for piece in result.pieces:
        for part in (piece, *piece.patches):
            # All pairs of a large piece would not fit into the memory that is measured.
            rng = np.random.default_rng(len(part.points))
            n_looked = min(len(part.points), MOST_LOOKED_AT)
            looked = np.sort(rng.choice(len(part.points), n_looked, replace=False))
            squared = squared_distances(positions[[part.points[x] for x in looked]])
            low, high = (1 - ROUNDING) * squared, (1 + ROUNDING) * squared
            bounds = (h.bounds_among(looked.tolist()) for h in part.hypotheses)
            if not any(((lower <= high) & (low <= upper)).all() for lower, upper in bounds):
                return False
    return True


def measure(n_points: int, degree: int, error: float, seed: int, seconds: float) -> Measured:
    """Solve one fleet."""
    load_kernels()
    problem, positions = fleet(n_points, degree, error, seed)
    before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    start, cpu_start = time.perf_counter(), time.process_time()
    result = solve(problem, SolverOptions(max_boxes=10**9, max_seconds=seconds))
    taken, cpu = time.perf_counter() - start, time.process_time() - cpu_start
    after_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    largest = max(result.pieces, key=lambda piece: len(piece.points))
    return Measured(
        result.verdict,
        holds(result, positions),
        taken,
        cpu,
        max(0.0, taken - seconds),
        after_mb - before_mb,
        len(largest.points),
        len(largest.patches),
        sum(len(patch.hypotheses) > 1 for patch in largest.patches),
        all(h.proved for piece in result.pieces for h in piece.hypotheses),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--sizes', type=int, nargs='+', default=[30, 100, 300, 1000])
    parser.add_argument('--seeds', type=int, default=3, help='fleets of each kind')
    parser.add_argument('--seconds', type=float, default=2.0, help='the time of one fleet')
    arguments = parser.parse_args()
    print(
        '| fleet | covered | truth held | time: median, longest | of the processor | overrun '
        '| memory | largest piece | patches, ambiguous | placement proved |'
    )
    print('|---|---|---|---|---|---|---|---|---|---|')
    seeds = range(arguments.seeds)
    for n_points in arguments.sizes:
        for degree in DEGREES:
            for error in ERRORS:
                row = []
                for seed in seeds:
                    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
                        task = (n_points, degree, error, seed, arguments.seconds)
                        row.append(pool.submit(measure, *task).result())
                _print_row(f'n = {n_points}, degree {degree}, ±{error:.0%}', row)


def _print_row(name: str, row: list[Measured]) -> None:
    """Print what came of the fleets of one kind."""
    times = [found.seconds for found in row]
    middle = {
        key: np.median([getattr(found, key) for found in row])
        for key in ('cpu_seconds', 'largest', 'n_patches', 'n_ambiguous')
    }
    print(
        f'| {name} | {sum(found.verdict is Verdict.COVERED for found in row)} of {len(row)} '
        f'| {sum(found.holds_truth for found in row)} of {len(row)} '
        f'| {np.median(times):.2f}, {max(times):.2f} s | {middle["cpu_seconds"]:.2f} s '
        f'| {1e3 * max(found.overrun for found in row):.0f} ms '
        f'| {max(found.memory_mb for found in row):.0f} MB | {middle["largest"]:.0f} '
        f'| {middle["n_patches"]:.0f}, {middle["n_ambiguous"]:.0f} '
        f'| {sum(found.proved for found in row)} of {len(row)} |',
        flush=True,
    )


if __name__ == '__main__':
    main()
