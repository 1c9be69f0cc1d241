# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Multidimensional scaling as the paper compares it (Section 5.1).

Distances are drawn in the measured ranges, the missing ones are the shortest paths, and the
nearest Gram matrix of rank q gives the points. One run gives one placement.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from scipy.sparse.csgraph import shortest_path

from benchmarks.cases import Case
from benchmarks.contest import Effort, Row, Score, measure
from benchmarks.exact import measured_pairs
from benchmarks.problems import FloatArray, placement_of, squared_distances

NAME = 'mds'
TRIALS = 100


def missing() -> str | None:
    """Say what is missing, if anything."""
    return None


def placement(case: Case, random: np.random.Generator) -> FloatArray:
    """Return the placement of one run, in m."""
    drawn = np.zeros(case.problem.lower.shape)
    for pair in measured_pairs(case.problem):
        drawn[pair] = np.sqrt(random.uniform(case.problem.lower[pair], case.problem.upper[pair]))
    return placement_of(shortest_path(drawn, directed=False) ** 2, case.problem.dimension)


def rows(case: Case, effort: Effort) -> Iterator[Row]:
    """Run the method many times; a run hits when its placement agrees with every range."""
    random = np.random.default_rng(0)
    trials, timing = measure(lambda: [placement(case, random) for _ in range(TRIALS)], effort)
    distances = [np.sqrt(squared_distances(trial)) for trial in trials]
    pairs = list(combinations(range(case.problem.n_points), 2))
    rows_, columns = np.array(pairs).T
    errors = np.array(
        [
            [
                np.abs(trial - np.sqrt(squared_distances(known)))[rows_, columns].max()
                for known in case.placements
            ]
            for trial in distances
        ]
    )
    low, high = np.sqrt(case.problem.lower), np.sqrt(case.problem.upper)
    hits = np.array([((trial >= low) & (trial <= high)).all() for trial in distances])
    found = len(set(errors.argmin(axis=1)[hits]))
    remark = (
        f'{hits.sum()} of {TRIALS} runs agree with the ranges; '
        f'the best is {errors.min():.2f} m off in some distance'
    )
    yield Row('classical MDS', timing, score=Score(found), remark=remark)
