# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Fleets that fall into pieces, with the time that their answers take.

Random fleets of neighbors in range, ten seeds each: with UWB bounds, with relative errors in the
plane and in space; networks of 50 to 150 points in space, many of whose distances are exact; two
rigid fours that share a robot; strips of rigid fours::

    python -m benchmarks.pieces [uwb] [plane] [space] [networks] [chains] [--seeds 10]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from itertools import combinations
import math
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.problems import ROUNDING, known_to, problem_of, squared_distances
from dg_localization import Problem, Result, SolverOptions, Verdict, solve

FloatArray = NDArray[np.float64]

SPACING_M = 5.0
"""The side of the square, or cube, that every point has to itself on average."""

SHORTEST_ERROR_M, LONGEST_ERROR_M = -0.05, 1.3
"""By how much a UWB radio reads too long."""


NETWORK_WIDTH_M = 0.1
"""How wide a distance of a network is known that is not exact."""

NETWORK_SECONDS = 10.0
"""The time that each network may take."""


class Row(NamedTuple):
    """Fleets of one kind, and the time that each of them may take."""

    n_points: int
    degree: int
    dimension: int
    seconds: float
    relative_error: float | None
    """None for the errors of UWB radios."""

    def __str__(self) -> str:
        error = '' if self.relative_error is None else f', ±{100 * self.relative_error:g} %'
        return f'n = {self.n_points}, degree {self.degree}{error}'

    def problem(self, seed: int) -> Problem:
        """Return one of the fleets."""
        if self.relative_error is None:
            return uwb_fleet(self.n_points, self.degree, seed, self.dimension)
        positions, pairs = neighbors(self.n_points, self.degree, self.dimension, seed)
        true_m = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)
        # A reading errs at random, and its bounds are around it.
        errors = np.random.default_rng([seed, 2]).uniform(-1.0, 1.0, len(pairs))
        read_m = true_m / (1.0 + self.relative_error * errors)
        ranges = {
            (i, j): known_to(self.relative_error, distance**2)
            for (i, j), distance in zip(pairs.tolist(), read_m.tolist(), strict=True)
        }
        return problem_of(ranges, self.n_points, self.dimension)


TABLES = {
    'uwb': [Row(n, degree, 2, 1.0, None) for n in (10, 15, 20, 30) for degree in (4, 5, 6, 8)],
    'plane': [
        *(
            Row(20, degree, 2, 1.0, e)
            for e in (0.001, 0.01, 0.03, 0.1)
            for degree in (4, 6, 8, 10)
        ),
        *(Row(50, degree, 2, 2.0, e) for e in (0.001, 0.01, 0.03, 0.1) for degree in (6, 8, 10)),
    ],
    'space': [
        Row(n, degree, 3, seconds, 0.01)
        for n, seconds in ((10, 1.0), (20, 1.0), (30, 3.0))
        for degree in (6, 8, 10, 12)
        if degree < n - 1
    ],
}


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


def network(number: int) -> tuple[Problem, FloatArray]:
    """
    Return a network of points in a unit cube, as of atoms, and its placement in m.

    From the first to the last of ten it grows from 50 to 150 points and from 3.4 to 17 measured
    pairs a point. Each point has exact distances to its two nearest earlier points; all other
    distances are known to an interval of 0.1 m.
    """
    n_points = 50 + 100 * (number % 10) // 9
    n_pairs = round(n_points * 3.4 * (17.0 / 3.4) ** (number % 10 / 9.0))
    rng = np.random.default_rng([number, 3])
    positions = rng.random((n_points, 3))
    squared = squared_distances(positions)
    exact = {
        (int(i), point)
        for point in range(1, n_points)
        for i in np.argsort(squared[point, :point])[:2]
    }
    ranges = {pair: (squared[pair], squared[pair]) for pair in exact}
    rows, columns = np.triu_indices(n_points, 1)
    for x in np.argsort(squared[rows, columns]):
        if len(ranges) >= n_pairs:
            break
        pair = int(rows[x]), int(columns[x])
        if pair not in exact:
            low_m = max(0.0, math.sqrt(squared[pair]) - NETWORK_WIDTH_M * rng.random())
            ranges[pair] = low_m**2, (low_m + NETWORK_WIDTH_M) ** 2
    return problem_of(ranges, n_points, 3), positions


def _timed(problem: Problem, options: SolverOptions) -> tuple[float, Verdict, int, int]:
    """Return the milliseconds of a solve, its verdict, its pieces and its hypotheses."""
    start = time.perf_counter()
    result = solve(problem, options)
    milliseconds = 1e3 * (time.perf_counter() - start)
    return milliseconds, result.verdict, len(result.pieces), result.n_hypotheses


def fleets(rows: Iterable[Row], n_seeds: int) -> None:
    """Print how many fleets run out of time, and how long they take."""
    print('| fleet | time | out of budget | median | longest | pieces |')
    print('|---|---|---|---|---|---|')
    of_all_ms: list[float] = []
    out_of_all = 0
    for row in rows:
        options = SolverOptions(max_boxes=10**9, max_seconds=row.seconds)
        answers = [_timed(row.problem(seed), options) for seed in range(n_seeds)]
        taken_ms = [answer[0] for answer in answers]
        out = [seed for seed, a in enumerate(answers) if a[1] is Verdict.OUT_OF_BUDGET]
        pieces = np.median([answer[2] for answer in answers])
        print(
            f'| {row} | {row.seconds:g} s | {len(out)} of {n_seeds} {out or ""} '
            f'| {np.median(taken_ms):.1f} ms | {max(taken_ms):.0f} ms | {pieces:.0f} |',
            flush=True,
        )
        of_all_ms += taken_ms
        out_of_all += len(out)
    print(
        f'| all | | {out_of_all} of {len(of_all_ms)} '
        f'| {np.median(of_all_ms):.1f} ms | {max(of_all_ms):.0f} ms | |'
    )


def networks(n_seeds: int) -> None:
    """Print what becomes of each network."""
    print('| points | pairs a point | verdict | time, of the processor ', end='')
    print('| pieces, largest | proved | truth held |\n|---|---|---|---|---|---|---|')
    options = SolverOptions(max_boxes=10**9, max_seconds=NETWORK_SECONDS)
    for number in range(n_seeds):
        problem, positions = network(number)
        start, cpu_start = time.perf_counter(), time.process_time()
        result = solve(problem, options)
        taken_s, cpu_s = time.perf_counter() - start, time.process_time() - cpu_start
        sizes = [len(piece.points) for piece in result.pieces]
        proved = [any(h.proved for h in piece.hypotheses) for piece in result.pieces]
        n_pairs = (np.isfinite(problem.upper).sum() - problem.n_points) // 2
        print(
            f'| {problem.n_points} | {n_pairs / problem.n_points:.1f} | {result.verdict.value} '
            f'| {taken_s:.1f} s, {cpu_s:.1f} s | {len(sizes)}, {max(sizes)} '
            f'| {sum(proved)} of {len(proved)} | {_holds(result, positions)} |',
            flush=True,
        )


def _holds(result: Result, positions: FloatArray) -> bool:
    """Tell whether each piece has a hypothesis that holds the placement, up to rounding."""
    for piece in result.pieces:
        squared = squared_distances(positions[list(piece.points)])
        low, high = (1.0 - ROUNDING) * squared, (1.0 + ROUNDING) * squared
        if not any(((h.lower <= high) & (low <= h.upper)).all() for h in piece.hypotheses):
            return False
    return True


def chains() -> None:
    """Print what known chains of pieces take."""
    print('| chain | time | pieces | hypotheses |\n|---|---|---|---|')
    cases = {'two fours, hinged': two_fours()}
    cases |= {f'strip of {length} fours': strip(length) for length in (10, 20, 40)}
    for name, problem in cases.items():
        best = min(_timed(problem, SolverOptions()) for _ in range(5))
        taken_ms, _, n_pieces, n_hypotheses = best
        power = math.log2(n_hypotheses)
        print(f'| {name} | {taken_ms:.1f} ms | {n_pieces} | 2^{power:g} |')


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    every = [*TABLES, 'networks', 'chains']
    parser.add_argument('tables', nargs='*', choices=[*every, []], help='all of them if none')
    parser.add_argument('--seeds', type=int, default=10, help='fleets of each kind')
    arguments = parser.parse_args()
    solve(two_fours())
    for name in arguments.tables or every:
        print(f'\n{name}\n')
        if name == 'chains':
            chains()
        elif name == 'networks':
            networks(arguments.seeds)
        else:
            fleets(TABLES[name], arguments.seeds)


if __name__ == '__main__':
    main()
