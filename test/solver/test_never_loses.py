# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The promise of the solver: no placement that agrees with the measurements is ever lost.

Fleets are drawn as a whole, or of bodies that are hinged, folded or not joined. What the answers
claim is looked up in every tenth of the former.

DG_PROPERTY_PROBLEMS sets how many random fleets are tried and DG_PROPERTY_SEED the first one;
``DG_PROPERTY_PROBLEMS=1000000 pytest -n 2 test/solver/test_never_loses.py`` is the long run.
"""

from joined_cases import (
    PROBLEMS,
    check_counts,
    chunks,
    first_and_last,
    grown_case,
    joined_case,
    missing,
    solve_as_one,
)
import numpy as np
import pytest
from solver_cases import random_case
from test_result import check_claims

from dg_localization import Problem, SolverOptions, Verdict, solve
from dg_localization.interval.kernels import COMPILED
from dg_localization.solver.assemble import growing

# In plain Python kernels warn of what compiled ones do not.
pytestmark = pytest.mark.filterwarnings('error' if COMPILED else 'default')

CLAIMS_EVERY = 10
LARGE_EVERY, WITHIN_EVERY = 50, 5
"""How many problems there are for one that is large, and for one within some boxes."""

ROUNDING = 1e-9
"""The squared distances of proved positions are computed to this fraction of the largest."""


def boxes_around(case, seed):
    """Return boxes of which one holds the truth, and others do not or only just."""
    rng = np.random.default_rng([seed, 1])
    squared = case.squared
    boxes = []
    for shift in rng.choice([0.5, 0.9, 1.0, 1.1, 2.0], size=rng.integers(0, 4)):
        boxes.append((shift * 0.95 * squared, shift * 1.05 * squared))
    margin = rng.choice([0.0, 0.01, 0.5])
    boxes.insert(rng.integers(len(boxes) + 1), ((1 - margin) * squared, (1 + margin) * squared))
    return boxes


def lacking_of(case, look_up=False):
    """Return what the answer to a problem lacks; its claims are looked up if so."""
    result = case.solve()
    check_counts(result)
    if look_up:
        check_claims(case.problem, result)
    return missing(result, case.positions)


def lacking_of_joined(seed):
    """Return what the answer to a problem of joined bodies lacks, by its seed."""
    case = joined_case(seed, max_points=25 if seed % LARGE_EVERY == 0 else 9)
    within = boxes_around(case, seed) if seed % WITHIN_EVERY == 0 else None
    result = solve(case.problem, case.options, within=within)
    if result.verdict is Verdict.INFEASIBLE:
        return ['everything']
    check_counts(result)
    assert result.statistics.processed <= case.options.max_boxes
    points = {point for piece in result.pieces for point in piece.points}
    assert points == set(range(case.problem.n_points))
    assert len(result.hypotheses) <= result.n_hypotheses
    return missing(result, case.positions)


def lost(lacking, seeds):
    """Return what answers lack by the seeds of their problems."""
    found = {}
    for seed in seeds:
        try:
            if lacks := lacking(seed):
                found[seed] = lacks
        except Exception as error:
            error.add_note(f'This was seed {seed}.')
            raise
    return found


@pytest.mark.parametrize('seeds', chunks(2 * PROBLEMS, 500), ids=first_and_last)
def test_no_truth_is_lost(seeds):
    assert not lost(lambda seed: lacking_of(random_case(seed), seed % CLAIMS_EVERY == 0), seeds)


@pytest.mark.parametrize('seeds', chunks(PROBLEMS, 250), ids=first_and_last)
def test_no_truth_is_lost_where_bodies_are_joined(seeds):
    assert not lost(lacking_of_joined, seeds)


def test_pairs_that_sides_bound_join_what_was_apart():
    """Without the triangles of such a pair its points were placed as if unbounded: NaN."""
    assert not lacking_of_joined(60_714_674)


@pytest.mark.parametrize('seeds', chunks(max(1, PROBLEMS // 10), 100), ids=first_and_last)
def test_no_truth_is_lost_where_pieces_in_space_are_placed_point_by_point(seeds, monkeypatch):
    """However small or well held they are."""
    monkeypatch.setattr(growing, 'LEAST_GROWN', 5)
    monkeypatch.setattr(growing, 'ONE_BOX_SHARE', 0.0)
    assert not lost(lambda seed: lacking_of(grown_case(seed)), seeds)


def disturbed(problem, rng):
    """Return the problem with the bounds of one pair moved: most often a contradiction."""
    lower, upper = problem.lower.copy(), problem.upper.copy()
    i, j = rng.integers(problem.n_points, size=2)
    factor = rng.choice([0.5, 0.9, 1.1, 2.0])
    lower[i, j] = lower[j, i] = lower[i, j] * factor
    upper[i, j] = upper[j, i] = upper[i, j] * factor
    return Problem(lower, upper, problem.dimension, problem.sides, problem.chiralities)


@pytest.mark.parametrize('seeds', chunks(max(1, PROBLEMS // 10), 250), ids=first_and_last)
def test_answers_in_pieces_and_in_one_agree(seeds):
    """What either proves to be a placement is in the other, contradictory problems included."""
    for seed in seeds:
        case = joined_case(seed, max_points=7)
        problem = case.problem
        if seed % 2:
            problem = disturbed(problem, np.random.default_rng(seed))
        options = SolverOptions(resolution=case.options.resolution, max_boxes=40)
        result, whole = solve(problem, options), solve_as_one(problem, options)
        for answer, other in ((result, whole), (whole, result)):
            for hypothesis in other.hypotheses:
                if hypothesis.proved:
                    assert not missing(answer, hypothesis.positions, ROUNDING), seed
        if Verdict.INFEASIBLE not in (result.verdict, whole.verdict):
            for piece in result.pieces:
                index = np.ix_(piece.points, piece.points)
                upper = np.max([h.upper for h in piece.hypotheses], axis=0)
                lower = np.min([h.lower for h in piece.hypotheses], axis=0)
                assert (whole.lower[index] <= upper).all(), seed
                assert (lower <= whole.upper[index]).all(), seed
