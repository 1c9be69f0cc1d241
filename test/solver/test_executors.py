# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Parts solved by the workers of an executor: the same answer, stopped as promptly."""

from concurrent.futures import Future, ProcessPoolExecutor
from itertools import combinations
from multiprocessing import get_context
import pickle
import threading

from joined_cases import missing
import numpy as np
import pytest
from solver_cases import braced_grid, problem_of

from dg_localization import SolverOptions, Verdict, solve


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


class NeverExecutor:
    """Takes tasks and never runs them."""

    def __init__(self):
        self.futures = []

    def submit(self, function, *args):
        self.futures.append(Future())
        return self.futures[-1]


def check_same(result, other):
    assert result.verdict is other.verdict and result.n_hypotheses == other.n_hypotheses
    for counted in ('processed', 'empty', 'split', 'kept', 'pending'):
        assert getattr(result.statistics, counted) == getattr(other.statistics, counted)
    assert len(result.pieces) == len(other.pieces)
    for piece, twin in zip(result.pieces, other.pieces, strict=True):
        for part, same in zip((piece, *piece.patches), (twin, *twin.patches), strict=True):
            assert part.points == same.points
            for h, g in zip(part.hypotheses, same.hypotheses, strict=True):
                assert (h.lower == g.lower).all() and (h.upper == g.upper).all()
                assert (h.positions == g.positions).all() and h.proved == g.proved


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
    check_same(result, solve(PROBLEMS[name], options))


def test_processes_give_the_same_answer():
    options = SolverOptions(max_boxes=10**6)
    problem = PROBLEMS['one large piece']
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as executor:
        check_same(solve(problem, options, executor=executor), solve(problem, options))


@pytest.mark.parametrize('max_seconds', [0.2, 60.0])
def test_what_no_worker_solves_in_time_or_before_it_is_cancelled_is_left_open(max_seconds):
    problem, positions = braced_grid(9, 9, 0.01)
    executor, cancel = NeverExecutor(), threading.Event()
    if max_seconds > 1.0:
        threading.Timer(0.1, cancel.set).start()
    result = solve(problem, SolverOptions(max_seconds=max_seconds), cancel, executor=executor)
    assert result.verdict is Verdict.OUT_OF_BUDGET
    assert executor.futures and all(future.cancelled() for future in executor.futures)
    assert not missing(result, positions)


def test_an_error_of_a_worker_is_raised():
    class Broken(LaterExecutor):
        def submit(self, function, *args):
            future = Future()
            future.set_exception(TimeoutError('the worker is gone'))
            return future

    with pytest.raises(TimeoutError, match='the worker is gone'):
        solve(PROBLEMS['one large piece'], executor=Broken())


def test_an_answer_is_pickled_without_those_who_might_have_stopped_it():
    problem = chain_of_triangles(4)
    cancel, progress = threading.Event(), lambda statistics: None
    result = solve(problem, cancel=cancel, progress=progress, executor=LaterExecutor())
    again = pickle.loads(pickle.dumps(result))
    for hypothesis, same in zip(result.hypotheses, again.hypotheses, strict=True):
        assert (hypothesis.lower == same.lower).all() and (hypothesis.upper == same.upper).all()
