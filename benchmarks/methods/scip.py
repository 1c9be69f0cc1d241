# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
SCIP: the exact hull of a single hypothesis by global optimisation, pair by pair.

Each unknown squared distance is minimised and maximised over the coordinates, with the sides as
products of determinants. It says nothing of a problem with several hypotheses.
"""

from __future__ import annotations

from collections.abc import Iterator
import time
from typing import Any

import numpy as np

from benchmarks.cases import Case
from benchmarks.contest import Effort, Hull, Row, Timing, compared_pairs, score
from benchmarks.exact import measured_pairs
from benchmarks.methods.algebra import determinant
from benchmarks.problems import Pair

try:
    import pyscipopt
except ImportError:
    pyscipopt = None

NAME = 'scip'


def missing() -> str | None:
    """Say what is missing, if anything."""
    return None if pyscipopt else 'SCIP is not installed (pip install pyscipopt)'


def _bound(case: Case, pair: Pair, sense: str, max_seconds: float) -> tuple[float, int]:
    """Return the proved bound of a squared distance, and the nodes of the search."""
    problem = case.problem
    q = problem.dimension
    model = pyscipopt.Model()
    model.hideOutput()
    model.setParam('limits/time', max_seconds)
    model.setParam('parallel/maxnthreads', 1)
    reach = float(np.sqrt(problem.upper[np.isfinite(problem.upper)]).sum() / 2.0)
    frame = list(range(q))
    p = [
        [
            0.0
            if point in frame and axis >= point
            else model.addVar(lb=0.0 if point in frame and axis == point - 1 else -reach, ub=reach)
            for axis in range(q)
        ]
        for point in range(problem.n_points)
    ]

    def edge(a: int, b: int) -> list[Any]:
        return [p[b][axis] - p[a][axis] for axis in range(q)]

    def squared(a: int, b: int) -> Any:
        return sum(step * step for step in edge(a, b))

    for i, j in measured_pairs(problem):
        model.addCons(squared(i, j) <= problem.upper[i, j])
        model.addCons(squared(i, j) >= problem.lower[i, j])
    for side in problem.sides:
        first, second = (
            determinant([edge(side.face[0], point) for point in (*side.face[1:], apex)])
            for apex in (side.first, side.second)
        )
        model.addCons(int(side.side) * first * second <= 0.0)
    target = model.addVar(lb=0.0, ub=4.0 * reach**2)
    model.addCons(target == squared(*pair))
    model.setObjective(target, sense)
    model.optimize()
    return model.getDualbound(), model.getNNodes()


def rows(case: Case, effort: Effort) -> Iterator[Row]:
    """Bound every compared pair from both sides."""
    started = time.perf_counter()
    hull = Hull(case.problem.lower.copy(), case.problem.upper.copy())
    nodes = 0
    for pair in compared_pairs(case):
        for bounds, sense in ((hull.lower, 'minimize'), (hull.upper, 'maximize')):
            left = started + effort.others - time.perf_counter()
            if left <= 0.0:
                yield Row('SCIP', boxes=nodes, remark=f'unfinished after {effort.others:g} s')
                return
            bound, searched = _bound(case, pair, sense, left)
            bounds[pair] = bounds[pair[::-1]] = bound
            nodes += searched
    seconds = time.perf_counter() - started
    timing = Timing(seconds, seconds, 1)
    yield Row('SCIP', timing, boxes=nodes, hypotheses=1, score=score(case, [hull]))
