# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear programs in the Procrustes frame: they lose nothing and bound well."""

from itertools import combinations
import os

import numpy as np
from numpy.testing import assert_allclose
import pytest
from solver_cases import bounds, squared_distances

from dg_localization import Problem, SolverOptions
from dg_localization.interval.kernels import COMPILED
from dg_localization.solver.contract.groups import groups_of
from dg_localization.solver.contract.linearization import new_linearization
from dg_localization.solver.contract.procrustes import (
    BOUNDED,
    bound_displacements,
    new_procrustes_frame,
    newton_step,
)
from dg_localization.solver.place.placements import place
from dg_localization.solver.search.common_frame import narrow_in_common_frame
from dg_localization.solver.search.pruning import Pruner

N_HOSTILE = int(os.environ.get('DG_PROPERTY_PROBLEMS', '2000' if COMPILED else '20'))
FIRST_SEED = int(os.environ.get('DG_PROPERTY_SEED', '0'))
ROUNDING = 1e-15
"""Relative error of a squared distance that is computed in floating point."""


def never():
    return False


def scattered(rng):
    """Return a placement of some awkward shape and size."""
    n_points = int(rng.integers(3, 10))
    positions = rng.uniform(-1.0, 1.0, (n_points, 2))
    shape = rng.integers(6)
    if shape == 1:
        positions[:, 1] *= 10.0 ** -rng.integers(2, 20)
    elif shape == 2:
        positions[:, 1] = 0.0
    elif shape == 3:
        positions[rng.integers(n_points)] = positions[rng.integers(n_points)]
    elif shape == 4:
        positions[: n_points // 2] = 1e-6 * positions[: n_points // 2] + 1.0
    elif shape == 5:
        positions = np.round(4.0 * positions) / 4.0
    return positions * 10.0 ** rng.choice([0, 0, 0, -3, 4, -30, 30, -90, 90, -120])


def hostile(seed):
    """Return a box, the truth in it, the measured pairs, and a reference placement."""
    rng = np.random.default_rng(seed)
    truth = scattered(rng)
    n_points = len(truth)
    squared = squared_distances(truth)
    error = rng.choice([0.0, 1e-9, 1e-3, 0.01, 0.03, 0.1, 0.5])
    pairs = list(combinations(range(n_points), 2))
    lower, upper = np.zeros_like(squared), np.zeros_like(squared)
    is_measured = rng.random(len(pairs)) < rng.choice([0.5, 0.8, 1.0])
    for pair, measured in zip(pairs, is_measured, strict=True):
        wider = 1.0 if measured else rng.choice([1.0, 3.0, 30.0])
        below, above = error * wider * rng.random(2)
        if rng.random() < 0.2:
            below = 0.0  # the truth is at an end of its interval
        low = squared[pair] * max(0.0, 1.0 - below) ** 2 * (1.0 - ROUNDING)
        high = squared[pair] * (1.0 + above) ** 2 * (1.0 + ROUNDING)
        lower[pair], upper[pair] = low, high
        lower[pair[::-1]], upper[pair[::-1]] = low, high
    box = np.zeros((4, n_points, n_points))
    box[0], box[1] = lower, upper
    known = upper.copy()
    for pair, measured in zip(pairs, is_measured, strict=True):
        if not measured:
            known[pair] = known[pair[::-1]] = np.inf
    kind = rng.integers(4)
    spread = np.sqrt(squared.max()) or 1.0
    reference = truth + spread * error * rng.normal(size=truth.shape)
    if kind == 1:
        reference = spread * rng.normal(size=truth.shape)
    elif kind == 2:
        reference[:, 0] = -reference[:, 0]
    elif kind == 3:
        reference = truth.copy()
    return box, squared, groups_of(np.where(np.isinf(known), 0.0, lower), known), reference


def test_the_truth_is_never_lost():
    for seed in range(FIRST_SEED, FIRST_SEED + N_HOSTILE):
        box, squared, groups, reference = hostile(seed)
        before = box.copy()
        pairs = np.array(list(combinations(range(len(reference)), 2)))
        explained = np.zeros(len(pairs))
        assert narrow_in_common_frame(groups, box, reference, pairs, explained, never), seed
        assert (box[0] <= squared * (1.0 + ROUNDING)).all(), seed
        assert (box[1] >= squared * (1.0 - ROUNDING)).all(), seed
        assert (box[0] >= before[0]).all() and (box[1] <= before[1]).all(), seed


def fleet(seed, relative_error, n_unknown):
    """Return a placement, and its problem with all but some pairs measured."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0.0, 10.0, (8, 2))
    squared = squared_distances(positions)
    pairs = list(combinations(range(8), 2))
    measured = [pairs[number] for number in rng.permutation(len(pairs))[n_unknown:]]
    ends = np.array([1.0 - relative_error, 1.0 + relative_error]) ** 2
    ranges = {pair: tuple(squared[pair] * ends) for pair in measured}
    return positions, Problem(*bounds(8, ranges))


def procrustes(positions, reference):
    """Return a placement shifted and turned to where its displacements turn least."""
    x, y = positions - positions.mean(axis=0), reference - reference.mean(axis=0)
    plain, crossed = (x * y).sum(), (y[:, 0] * x[:, 1] - y[:, 1] * x[:, 0]).sum()
    cosine, sine = np.array([plain, crossed]) / np.hypot(plain, crossed)
    return x @ np.array([[cosine, -sine], [sine, cosine]]) + reference.mean(axis=0)


@pytest.mark.parametrize('seed', range(10))
def test_the_displacements_of_every_placement_are_bounded(seed):
    positions, problem = fleet(seed, 0.01, 6)
    pruner = Pruner(problem, SolverOptions())
    box = pruner.prune(pruner.whole()).box
    linear, turned = new_linearization(groups_of(problem.lower, problem.upper).edges, 8, 2), None
    turned = new_procrustes_frame(8)
    assert bound_displacements(box, place(box, 2), linear, turned) == BOUNDED
    for _ in range(4):
        assert newton_step(box, linear, turned) >= 0.0
    reference = linear.reference
    turns = (1.0, -1.0)
    aligned = min(
        (procrustes(positions * [1.0, sign], reference) for sign in turns),
        key=lambda placed: np.abs(placed - reference).max(),
    )
    e = aligned - reference
    assert_allclose(e.sum(axis=0), 0.0, atol=1e-9)
    assert (np.abs(e) <= linear.displacements[:, 1] + 1e-9).all()
    for i, j in combinations(range(8), 2):
        g, relative = reference[i] - reference[j], e[i] - e[j]
        across, along = g[0] * relative[1] - g[1] * relative[0], g @ relative
        assert turned.across[i, 0, j] - 1e-9 <= across <= turned.across[i, 1, j] + 1e-9
        assert turned.along[i, 0, j] - 1e-9 <= along <= turned.along[i, 1, j] + 1e-9
    # The errors alone displace points by some centimeters.
    assert linear.displacements[:, 1].max() < 0.5


def test_pairs_are_narrowed_close_to_what_the_errors_explain():
    excess = []
    for seed in range(8):
        positions, problem = fleet(seed, 0.01, 6)
        pruner = Pruner(problem, SolverOptions())
        box = pruner.prune(pruner.whole()).box
        pairs = np.argwhere(np.triu(np.isinf(problem.upper)))
        explained = np.zeros(len(pairs))
        assert pruner.narrow_in_common_frame(box, place(box, 2), pairs, explained, never)
        squared = squared_distances(positions)
        assert (box[0] <= squared).all() and (squared <= box[1]).all()
        i, j = pairs.T
        excess.extend((box[1, i, j] - box[0, i, j]) / explained)
    assert np.median(excess) < 1.1


def test_time_that_is_up_leaves_the_box_as_it_is():
    _, problem = fleet(0, 0.01, 6)
    pruner = Pruner(problem, SolverOptions())
    box = pruner.prune(pruner.whole()).box
    before = box.copy()
    pairs = np.argwhere(np.triu(np.isinf(problem.upper)))
    explained = np.zeros(len(pairs))
    assert pruner.narrow_in_common_frame(box, place(box, 2), pairs, explained, lambda: True)
    assert (box == before).all() and not explained.any()
