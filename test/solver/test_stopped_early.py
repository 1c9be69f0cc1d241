# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What is stopped ends soon and holds the truth; workers of executors give the same answer."""

from concurrent.futures import Future, ProcessPoolExecutor
from itertools import combinations
from multiprocessing import get_context
import pickle
import threading
from unittest.mock import Mock

from joined_cases import FIRST_SEED, PROBLEMS, joined_case, missing
import numpy as np
import pytest
from solver_cases import (
    CancelAfter,
    assert_same,
    braced_grid,
    holding,
    pairs_where,
    problem_of,
    squared_distances,
)
from test_patches import all_parts_hold

from benchmarks.pieces import neighbors
from dg_localization import Problem, SolverOptions, Verdict, solve
from dg_localization.interval import kernels
from dg_localization.solver.decompose import decomposition
from dg_localization.solver.subproblem import pieces_of_problem

SEEDS = range(FIRST_SEED, FIRST_SEED + max(100, PROBLEMS // 20))


@pytest.fixture
def watchful(monkeypatch):
    """Look at the clock after any work at all, and remember no graph."""
    monkeypatch.setattr(kernels, 'WORK_PER_LOOK', 1)
    forget()
    yield
    forget()


def forget():
    decomposition._remembered.cache_clear()


def check_undivided(result, n_points):
    """Assert that nothing is claimed of a fleet that was not taken to pieces."""
    assert result.verdict is Verdict.OUT_OF_BUDGET
    assert result.statistics.pending == 1 and result.statistics.processed == 0
    (piece,) = result.pieces
    (hypothesis,) = piece.hypotheses
    assert piece.points == tuple(range(n_points)) and result.joints == ()
    assert hypothesis.flexible and not hypothesis.proved and hypothesis.positions is None


def test_no_truth_is_lost_where_the_decomposition_is_stopped(watchful):
    n_stopped = 0
    for seed in SEEDS:
        case = joined_case(seed)
        whole = CancelAfter(10**9)
        with kernels.until(whole.is_set):
            pieces_of_problem(case.problem)
        n_looks = 10**9 - whole.left
        for most in {0, n_looks // 2, n_looks - 1, n_looks + 1} - {-1}:
            forget()
            result = solve(case.problem, case.options, cancel=CancelAfter(most))
            assert not missing(result, case.positions), seed
            if most < n_looks:
                n_stopped += 1
                check_undivided(result, case.problem.n_points)
    assert n_stopped > len(SEEDS)


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('listed', [False, True])
def test_large_fleets_are_bounded_by_chains(dimension, listed, watchful):
    positions, pairs = neighbors(250, 8, dimension, 5)
    squared = squared_distances(positions)
    measured = squared[pairs[:, 0], pairs[:, 1]]
    problem = Problem.from_pairs(250, *pairs.T, 0.98 * measured, 1.02 * measured, dimension)
    if not listed:
        problem = Problem(problem.lower, problem.upper, dimension)
    around = 0.9 * squared, 1.1 * squared
    for within in (None, [around]):
        forget()
        result = solve(problem, cancel=CancelAfter(20), within=within)
        check_undivided(result, 250)
        assert holding([result], squared)
        (hypothesis,) = result.hypotheses
        again = pickle.loads(pickle.dumps(hypothesis))
        assert (again.lower == hypothesis.lower).all()
        assert within is None or (hypothesis.upper <= around[1]).all()


def exact_and_wide(n_points, degree, seed):
    """Return a fleet in space with exact distances among others, and its positions."""
    rng = np.random.default_rng(seed)
    positions = rng.random((n_points, 3))
    squared = squared_distances(positions)
    near = np.sort(squared, axis=1)[:, degree]
    known = squared <= np.maximum(near, near[:, None])
    exact = known & (rng.random((n_points, n_points)) < 0.2)
    spread = np.where(exact | exact.T | np.eye(n_points, dtype=bool), 0.0, 0.02)
    lower = np.where(known, (1.0 - spread) * squared, 0.0)
    return Problem(lower, np.where(known, (1.0 + spread) * squared, np.inf), 3), positions


@pytest.mark.parametrize('n_points', [14, 30, 70])
def test_pieces_in_space_that_are_stopped_hold_the_truth(n_points, watchful):
    problem, positions = exact_and_wide(n_points, 8, n_points)
    for most in (0, 10, 100, 1000):
        result = solve(problem, SolverOptions(max_boxes=20), cancel=CancelAfter(most))
        assert not missing(result, positions)
        for piece in result.pieces:
            for hypothesis in piece.hypotheses:
                assert hypothesis.positions is not None or hypothesis.flexible


MOST_LOOKS_AFTER = 40
"""A piece that was begun may look again at each of its steps before it ends."""


@pytest.mark.parametrize(('size', 'holes'), [((5, 6), 0.2), ((7, 9), 0.2), ((9, 9), 0.0)])
def test_a_call_that_is_cancelled_ends_soon_and_holds_the_truth(size, holes):
    problem, positions = braced_grid(*size, 0.01, holes=holes)
    squared = squared_distances(positions)
    whole = CancelAfter(10**9)
    solve(problem, SolverOptions(max_boxes=10**6), cancel=whole)
    n_looks = 10**9 - whole.left
    for most in np.unique(np.geomspace(1, 0.9 * n_looks, 12).astype(int)).tolist():
        cancel = CancelAfter(most)
        result = solve(problem, SolverOptions(max_boxes=10**6), cancel=cancel)
        assert -cancel.left < MOST_LOOKS_AFTER + 2 * len(result.pieces), most
        assert not missing(result, positions), most
        assert all_parts_hold(result, squared), most


@pytest.mark.parametrize('max_seconds', [1e-9, 1e-3, 1e-2])
def test_time_that_is_over_is_never_a_complete_answer(max_seconds):
    problem, positions = braced_grid(9, 9, 0.01)
    result = solve(problem, SolverOptions(max_boxes=10**6, max_seconds=max_seconds))
    assert result.verdict is Verdict.OUT_OF_BUDGET
    assert not missing(result, positions)


def test_pieces_that_were_not_begun_hold_the_truth():
    """There is no time to contract the larger of two pieces in space."""
    positions = np.random.default_rng(0).random((125, 3))
    small = np.arange(125) < 5
    problem = problem_of(positions, pairs_where(small == small[:, None]), error=0.02)
    result = solve(problem, cancel=CancelAfter(0))
    assert [len(piece.points) for piece in result.pieces] == [5, 120]
    assert not missing(result, positions)


def test_what_was_not_examined_counts_as_flexible():
    # The center and the corners of a square, opposite ones of which do not measure each other.
    corners = np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]], dtype=float)
    problem = problem_of(corners, pairs_where(squared_distances(corners) < 3.0), error=0.1)
    stopped = solve(problem, SolverOptions(max_boxes=1)).hypotheses
    assert all(h.proved and h.flexible for h in stopped)
    assert not any(h.flexible for h in solve(problem).hypotheses if h.proved)


class LaterExecutor:
    """Runs tasks when they are asked for, last first, in copies as another machine would."""

    def __init__(self):
        self.n_tasks = 0

    def submit(self, function, *args):
        self.n_tasks += 1
        future = Future()
        result = future.result

        def run_when_asked(timeout=None):
            if not future.done():
                run, given = pickle.loads(pickle.dumps((function, args)))
                future.set_result(pickle.loads(pickle.dumps(run(*given))))
            return result(timeout)

        future.result = run_when_asked
        return future


def chain_of_triangles(count):
    """Return triangles and fours, each hinged to the next in one point."""
    bodies, last = [], 0
    for number in range(count):
        bodies.append(range(last, last + 3 + number % 2))
        last = bodies[-1][-1]
    places = np.random.default_rng(0).uniform(0.0, 5.0, (last + 1, 2))
    return problem_of(places, [p for body in bodies for p in combinations(body, 2)], error=0.02)


PROBLEMS = {
    'a chain of small pieces': chain_of_triangles(30),
    'one large piece': braced_grid(9, 9, 0.01)[0],
    'many pieces': braced_grid(8, 8, 0.03, holes=0.3)[0],
}


@pytest.mark.parametrize('name', PROBLEMS)
@pytest.mark.parametrize('max_boxes', [1, 40, 300])
def test_workers_give_the_same_answer(name, max_boxes):
    options = SolverOptions(max_boxes=max_boxes)
    executor = LaterExecutor()
    result = solve(PROBLEMS[name], options, executor=executor)
    assert (executor.n_tasks > 0) == ('large' in name or 'many' in name)
    assert_same(result, solve(PROBLEMS[name], options))


def test_processes_give_the_same_answer():
    options = SolverOptions(max_boxes=10**6)
    problem = PROBLEMS['one large piece']
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as executor:
        assert_same(solve(problem, options, executor=executor), solve(problem, options))


@pytest.mark.parametrize('max_seconds', [0.2, 60.0])
def test_what_no_worker_solves_in_time_or_before_it_is_cancelled_is_left_open(max_seconds):
    problem, positions = braced_grid(9, 9, 0.01)
    futures, cancel = [], threading.Event()

    def submit(*_):
        futures.append(Future())
        return futures[-1]

    if max_seconds > 1.0:
        threading.Timer(0.1, cancel.set).start()
    options, never = SolverOptions(max_seconds=max_seconds), Mock(submit=submit)
    result = solve(problem, options, cancel, executor=never)
    assert result.verdict is Verdict.OUT_OF_BUDGET
    assert futures and all(future.cancelled() for future in futures)
    assert not missing(result, positions)


def test_an_error_of_a_worker_is_raised():
    failed = Future()
    failed.set_exception(TimeoutError('the worker is gone'))
    with pytest.raises(TimeoutError, match='the worker is gone'):
        solve(PROBLEMS['one large piece'], executor=Mock(submit=Mock(return_value=failed)))


def test_an_answer_is_pickled_without_those_who_might_have_stopped_it():
    problem = chain_of_triangles(4)
    cancel, progress = threading.Event(), lambda statistics: None
    result = solve(problem, cancel=cancel, progress=progress, executor=LaterExecutor())
    again = pickle.loads(pickle.dumps(result))
    for hypothesis, same in zip(result.hypotheses, again.hypotheses, strict=True):
        assert (hypothesis.lower == same.lower).all() and (hypothesis.upper == same.upper).all()
