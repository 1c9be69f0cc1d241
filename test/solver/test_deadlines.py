# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Every step of a large problem can be stopped: the clock advances with the work."""

from functools import wraps

import numpy as np
import pytest
from solver_cases import squared_distances
from test_patches import braced_grid

from dg_localization import Problem, SolverOptions, Verdict
from dg_localization.solver.assemble import links, tasks
from dg_localization.solver.assemble.answer import solve_in_pieces
from dg_localization.solver.assemble.budget import CallBudget
from dg_localization.solver.patches import chains, known_pairs, neighborhoods
from dg_localization.solver.place import sparse_placements

STEP_S = 1.0
WORK = [
    (tasks, 'search'),
    (tasks, 'hypotheses_of'),
    (tasks, 'unplaced_hypotheses_of'),
    (neighborhoods.Neighborhoods, 'rigid_part'),
    (neighborhoods.Neighborhoods, 'paths'),
    (neighborhoods.Neighborhoods, 'within_hops'),
    (known_pairs.KnownPairs, 'narrow'),
    (known_pairs.KnownPairs, 'bounds_of_shared'),
    (chains, '_chain_lengths'),
    (sparse_placements, '_step'),
    (links, 'apex_of'),
    (chains.ChainGraph, 'bounds'),
]


class WorkClock:
    """A clock that each call of some functions advances by a step."""

    def __init__(self, monkeypatch):
        self.now_s = 0.0
        for owner, name in WORK:
            monkeypatch.setattr(owner, name, self._counted(getattr(owner, name)))

    def _counted(self, function):
        @wraps(function)
        def counted(*args, **kwargs):
            self.now_s += STEP_S
            return function(*args, **kwargs)

        return counted

    def __call__(self):
        return self.now_s


def solve_until(problem, steps, monkeypatch):
    """Return the answer of so many steps, and how many it took."""
    with monkeypatch.context() as patch:
        clock = WorkClock(patch)
        options = SolverOptions(max_boxes=10**6, max_seconds=steps * STEP_S)
        result = solve_in_pieces(problem, CallBudget(options, clock=clock))
        return result, clock.now_s / STEP_S


@pytest.mark.parametrize('holes', [0.0, 0.3])
def test_no_step_goes_on_after_the_time_is_over(holes, monkeypatch):
    problem, positions = braced_grid(9, 9, 0.01, holes=holes)
    squared = squared_distances(positions)
    _, n_steps = solve_until(problem, 10**6, monkeypatch)
    assert n_steps > 100
    for steps in np.linspace(0.5, n_steps, 30):
        result, taken = solve_until(problem, steps, monkeypatch)
        # A search that was begun and its placements, and what is known of the pairs of each piece.
        assert taken <= steps + 4 + 2 * len(result.pieces), steps
        assert result.verdict is not Verdict.INFEASIBLE
        assert ((result.lower <= squared) & (squared <= result.upper)).all(), steps
        for piece in result.pieces:
            for part in (piece, *piece.patches):
                true = squared[np.ix_(part.points, part.points)]
                held = ((h.lower <= true) & (true <= h.upper) for h in part.hypotheses)
                assert any(inside.all() for inside in held), steps


def test_time_that_is_over_is_never_a_complete_answer(monkeypatch):
    problem, _ = braced_grid(9, 9, 0.01)
    for steps in (0.5, 1.5, 10, 30):
        result, _ = solve_until(problem, steps, monkeypatch)
        assert result.verdict is Verdict.OUT_OF_BUDGET


def test_a_piece_without_time_leaves_the_others_as_they_are(monkeypatch):
    small, _ = braced_grid(3, 4, 0.01)
    large, _ = braced_grid(9, 9, 0.01)
    lower, upper = np.zeros((93, 93)), np.full((93, 93), np.inf)
    lower[:12, :12], upper[:12, :12] = small.lower, small.upper
    lower[12:, 12:], upper[12:, 12:] = large.lower, large.upper
    both = Problem(lower, upper)
    whole, n_steps = solve_until(both, 10**6, monkeypatch)
    cut, _ = solve_until(both, 0.3 * n_steps, monkeypatch)
    assert whole.verdict is Verdict.COVERED and cut.verdict is Verdict.OUT_OF_BUDGET
    assert [piece.points for piece in cut.pieces] == [piece.points for piece in whole.pieces]
    (hypothesis,), (same,) = cut.pieces[0].hypotheses, whole.pieces[0].hypotheses
    assert len(cut.pieces[0].points) == 12
    assert (hypothesis.lower == same.lower).all() and (hypothesis.upper == same.upper).all()
