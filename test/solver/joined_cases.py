# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Problems that fall into pieces, whose truth is known exactly, and what answers must say."""

import os

import numpy as np
from solver_cases import (
    RESOLUTIONS,
    Case,
    bounds_around,
    covers,
    drawn_options,
    holding,
    is_in,
    known_orientations,
    scattered,
    squared_distances,
    symmetric,
)

from dg_localization import Problem, SolverOptions, Verdict
from dg_localization.solver.assemble.answer import solve_in_pieces
from dg_localization.solver.decompose.decomposition import Decomposition
from dg_localization.solver.search.budget import Budget

PROBLEMS = int(os.environ.get('DG_PROPERTY_PROBLEMS', '2000'))
COUNTS = [0, 0, 0, 1, 3]
"""How many sides, and how many chiralities, are known."""
FIRST_SEED = int(os.environ.get('DG_PROPERTY_SEED', '0'))


def chunks(n_problems, size):
    """Return ranges of `size` successive seeds."""
    end = FIRST_SEED + n_problems
    return [range(seed, min(seed + size, end)) for seed in range(FIRST_SEED, end, size)]


def first_and_last(seeds):
    return f'{seeds[0]}-{seeds[-1]}'


def check_counts(result):
    """Assert that the numbers of boxes of an answer add up."""
    done = result.statistics
    boxes = sum(len(h.boxes) for piece in result.pieces for h in piece.hypotheses)
    assert done.processed == done.empty + done.split + done.kept
    assert done.kept + done.pending == boxes and done.empty >= 0
    assert (result.verdict is Verdict.OUT_OF_BUDGET) == (done.pending > 0)


def solve_as_one(problem, options=None, cancel=None, progress=None, within=None):
    """Solve a problem without taking it to pieces."""
    budget = Budget(options or SolverOptions(), cancel, progress)
    whole = Decomposition((tuple(range(problem.n_points)),), ())
    return solve_in_pieces(problem, budget, within, whole)


def joined_case(seed, max_points=9):
    """Return a random problem of bodies that are hinged, share faces, or are not joined at all."""
    rng = np.random.default_rng(seed)
    dimension = int(rng.choice([1, 2, 2, 2, 2, 3]))
    bodies = _bodies(rng, dimension, int(rng.integers(3, max_points + 1)))
    n_points = 1 + max(max(body) for body in bodies)
    positions = _positions(rng, n_points, dimension, bodies)
    measured = _measured_pairs(rng, n_points, bodies)
    squared = squared_distances(positions)
    sides, chiralities = known_orientations(rng, positions.tolist(), COUNTS, bodies)
    lower, upper = _bounds(rng, squared, measured)
    seconds = [0.0, 0.0, 0.0, 0.0, np.inf]
    options = drawn_options(rng, squared, RESOLUTIONS, [2, 10, 40, 100], seconds)
    return Case(Problem(lower, upper, dimension, sides, chiralities), options, positions)


def grown_case(seed):
    """Return a random problem of one body in space, of which many pairs are measured."""
    rng = np.random.default_rng([seed, 3])
    body = list(range(int(rng.integers(5, 13))))
    positions = _positions(rng, len(body), 3, [body])
    measured = np.triu(rng.random((len(body), len(body))) < rng.choice([0.5, 0.7, 0.9, 1.0]), 1)
    squared = squared_distances(positions)
    sides, chiralities = known_orientations(rng, positions.tolist(), COUNTS, [body])
    lower, upper = _bounds(rng, squared, measured | measured.T)
    seconds = [0.0, 0.0, 0.0, np.inf]
    options = drawn_options(rng, squared, [1e-6, 1e-2, 0.1], [2, 10, 20], seconds)
    return Case(Problem(lower, upper, 3, sides, chiralities), options, positions)


def _bodies(rng, dimension, n_points):
    """Return sets of points, each sharing some with one of those before it, in any order."""
    names = rng.permutation(n_points).tolist()
    first = min(len(names), int(rng.integers(1, dimension + 3)))
    bodies, names = [names[:first]], names[first:]
    while names:
        n_shared = int(rng.integers(0, dimension + 1))
        base = bodies[rng.integers(len(bodies))]
        shared = rng.permutation(base)[:n_shared].tolist()
        # Now and then what is shared belongs to two bodies, and a loop is closed.
        if n_shared and rng.random() < 0.2:
            shared[0] = int(rng.choice(bodies[rng.integers(len(bodies))]))
        size = min(len(names), int(rng.choice([1, 1, 1, 2, 3])))
        bodies.append([*dict.fromkeys(shared), *names[:size]])
        names = names[size:]
    return bodies


def _positions(rng, n_points, dimension, bodies):
    positions = scattered(rng, n_points, dimension, [1, 3, 10, 1000, 10**6], bodies)
    return positions * 2.0 ** rng.choice([0, 0, 0, -40, 40])


def _measured_pairs(rng, n_points, bodies):
    """Return which pairs are measured: most of those within a body, and few others."""
    measured = np.zeros((n_points, n_points), dtype=bool)
    density = rng.choice([0.6, 0.85, 1.0, 1.0])
    for body in bodies:
        inside = np.ix_(body, body)
        measured[inside] |= rng.random((len(body), len(body))) < density
    if rng.random() < 0.3:
        i, j = rng.integers(n_points, size=2)
        measured[i, j] = True
    measured = np.triu(measured | measured.T, 1)
    return measured | measured.T


def _bounds(rng, squared, measured):
    """Return bounds around squared distances; of some pairs only that they are not shorter."""
    widths = [0, 1e-15, 1e-12, 1e-6, 1e-3, 0.01, 0.1, 0.3]
    lower, upper = bounds_around(rng, squared, widths, alike=0.7)
    apart = symmetric(rng.random(squared.shape) < rng.choice([0.0, 0.0, 0.0, 0.2, 1.0]))
    least = squared * rng.choice([0.1, 0.9, 1.0])
    unknown = ~measured & ~np.eye(len(squared), dtype=bool)
    lower = np.where(unknown, np.where(apart, least, 0.0), lower)
    return lower, np.where(unknown, np.inf, upper)


def missing(result, positions, share=0.0):
    """
    Return where in an answer a placement is missing, up to a share of the largest distance.

    It must lie in a hypothesis of every piece, within the bounds of the fleet, and in a whole
    hypothesis when all of these are listed.
    """
    squared = squared_distances(positions)
    found, slack = [], share * squared.max()
    if not holding([result], squared, share):
        found.append('bounds')
    for piece in result.pieces:
        part = squared[np.ix_(piece.points, piece.points)]
        if not any(is_in(hypothesis, part, slack) for hypothesis in piece.hypotheses):
            found.append(f'piece {piece.points}')
    listed = len(result.hypotheses)
    if result.n_hypotheses <= max(listed, 64) and not covers(result, squared, slack):
        found.append(f'hypotheses: {listed} of {result.n_hypotheses}')
    return found
