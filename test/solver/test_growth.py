# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rigid pieces in space, placed point by point: what is found, and that nothing is lost."""

from joined_cases import FIRST_SEED, PROBLEMS, grown_case, missing
import numpy as np
import pytest
from solver_cases import squared_distances
from test_pieces_never_lose import first_and_last

from dg_localization import Problem, SolverOptions, Verdict, solve
from dg_localization.solver.assemble import growing as solver

CHUNK = 100
GROWN_PROBLEMS = max(1, PROBLEMS // 10)
END = FIRST_SEED + GROWN_PROBLEMS
CHUNKS = [range(seed, min(seed + CHUNK, END)) for seed in range(FIRST_SEED, END, CHUNK)]


@pytest.fixture
def grows_everything(monkeypatch):
    """Place point by point whatever is in space, however small or well held it is."""
    monkeypatch.setattr(solver, 'LEAST_GROWN', 5)
    monkeypatch.setattr(solver, 'ONE_BOX_SHARE', 0.0)


def neighbors_in_space(n_points, degree, seed, relative_error=0.01):
    """Return random points and the problem of their closest pairs."""
    positions = np.random.default_rng(seed).uniform(0.0, 5.0 * n_points ** (1 / 3), (n_points, 3))
    squared = squared_distances(positions)
    rows, columns = np.triu_indices(n_points, 1)
    nearest = np.argsort(squared[rows, columns])[: n_points * degree // 2]
    measured = np.eye(n_points, dtype=bool)
    measured[rows[nearest], columns[nearest]] = measured[columns[nearest], rows[nearest]] = True
    lower = np.where(measured, squared * (1.0 - relative_error) ** 2, 0.0)
    upper = np.where(measured, squared * (1.0 + relative_error) ** 2, np.inf)
    return positions, Problem(lower, upper, 3)


def test_weakly_held_points_do_not_keep_a_piece_from_an_answer():
    """Fleets of neighbors in space on which halves of boxes were split without end."""
    for seed in range(3):
        positions, problem = neighbors_in_space(20, 8, seed)
        result = solve(problem, SolverOptions(max_boxes=8000))
        assert result.verdict is Verdict.COVERED
        assert not missing(result, positions, squared_distances(positions))


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('seeds', CHUNKS, ids=first_and_last)
@pytest.mark.usefixtures('grows_everything')
def test_no_truth_is_lost(seeds):
    for seed in seeds:
        case = grown_case(seed)
        result = solve(case.problem, case.options)
        assert result.verdict is not Verdict.INFEASIBLE, seed
        assert not missing(result, case.positions, case.squared), seed
        done = result.statistics
        boxes = sum(len(h.boxes) for piece in result.pieces for h in piece.hypotheses)
        assert done.processed == done.empty + done.split + done.kept, seed
        assert done.kept + done.pending == boxes, seed
