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
    new_procrustes_frame,
    set_crossing,
    set_frame,
)
from dg_localization.solver.place.placements import place_step_by_step
from dg_localization.solver.search import common_frame
from dg_localization.solver.search.common_frame import CommonFrame, narrow_in_common_frame
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
    return box, truth, groups_of(np.where(np.isinf(known), 0.0, lower), known), reference


@pytest.fixture(params=['cut where pairs are wide', 'always cut'])
def cuts(request, monkeypatch):
    if request.param == 'always cut':
        monkeypatch.setattr(common_frame, 'MOST_EXCESS', {1: 0.0, 3: 0.0})
        monkeypatch.setattr(common_frame, 'MOST_CUTS', 3)


@pytest.mark.usefixtures('cuts')
def test_the_truth_is_never_lost():
    for seed in range(FIRST_SEED, FIRST_SEED + N_HOSTILE):
        box, truth, groups, reference = hostile(seed)
        squared, before = squared_distances(truth), box.copy()
        pairs = np.array(list(combinations(range(len(reference)), 2)))
        explained = np.zeros(len(pairs))
        assert narrow_in_common_frame(groups, box, reference, pairs, explained, never), seed
        assert (box[0] <= squared * (1.0 + ROUNDING)).all(), seed
        assert (box[1] >= squared * (1.0 - ROUNDING)).all(), seed
        assert (box[0] >= before[0]).all() and (box[1] <= before[1]).all(), seed


def test_the_crossing_of_a_pair_holds_all_its_turns():
    rng = np.random.default_rng(FIRST_SEED)
    for seed in range(FIRST_SEED, FIRST_SEED + N_HOSTILE):
        box, truth, groups, reference = hostile(seed)
        n_points = len(truth)
        linear = new_linearization(np.array([[0, n_points - 1]]), n_points, 2)
        turned = new_procrustes_frame(n_points)
        if len(groups.offsets) != 2 or not set_frame(box, reference, linear, turned):
            continue
        g, v = linear.reference[0] - linear.reference[-1], truth[0] - truth[-1]
        turn = np.arctan2(g[0] * v[1] - g[1] * v[0], g @ v)
        low, high = turn - rng.random() ** 3, turn + rng.random() ** 3
        turned.turns[0, :, -1] = max(low, -np.pi), min(high, np.pi)
        set_crossing(box, linear, turned, 0, rng.uniform(low, high))
        crossing = linear.gradients[0] @ (v - g)
        slack = 1e-12 * np.hypot(*linear.gradients[0]) * (np.hypot(*v) + np.hypot(*g))
        assert linear.residuals[0, 0] - slack <= crossing <= linear.residuals[0, 1] + slack, seed


def fits(frame, truth, slack_m):
    """Return whether a placement turns all pairs within their bounds, but for rounding."""
    placed = procrustes(truth, frame.reference)
    if placed is None:
        return True
    for i, j in combinations(range(len(truth)), 2):
        g, v = frame.reference[i] - frame.reference[j], placed[i] - placed[j]
        shorter_m = min(np.hypot(*g), np.hypot(*v))
        if shorter_m > 1e3 * slack_m:
            turn, slack = np.arctan2(g[0] * v[1] - g[1] * v[0], g @ v), slack_m / shorter_m
            if not frame.turns[i, 0, j] - slack <= turn <= frame.turns[i, 1, j] + slack:
                return False
    return True


def test_the_turns_of_the_truth_are_never_lost():
    for seed in range(FIRST_SEED, FIRST_SEED + N_HOSTILE):
        box, truth, groups, reference = hostile(seed)
        if len(groups.offsets) != 2 or groups.members.tolist() != list(range(len(truth))):
            continue
        frame = CommonFrame(box, reference, groups.edges, never)
        pairs = np.array(list(combinations(range(len(truth)), 2)))
        assert frame.narrow(pairs, np.zeros(len(groups.edges)), np.zeros(len(pairs))), seed
        if frame.is_known:
            slack_m = 1e-12 * np.abs(truth - truth.mean(axis=0)).max()
            assert fits(frame, truth, slack_m) or fits(frame, truth * [1.0, -1.0], slack_m), seed


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
    length = np.hypot(plain, crossed)
    if not length > 1e-3 * np.linalg.norm(x) * np.linalg.norm(y):
        return None  # rounding would turn it
    cosine, sine = np.array([plain, crossed]) / length
    return x @ np.array([[cosine, -sine], [sine, cosine]]) + reference.mean(axis=0)


@pytest.mark.parametrize('seed', range(10))
def test_the_turns_of_every_placement_are_bounded(seed):
    positions, problem = fleet(seed, 0.01, 6)
    pruner = Pruner(problem, SolverOptions())
    box = pruner.prune(pruner.whole()).box
    edges = groups_of(problem.lower, problem.upper).edges
    frame = CommonFrame(box, place_step_by_step(box, 2), edges, never)
    pairs = np.array(list(combinations(range(8), 2)))
    assert frame.narrow(pairs, np.zeros(len(edges)), np.zeros(len(pairs)))
    reference, turns = frame.reference, frame.turns
    mirrored = (procrustes(positions * [1.0, sign], reference) for sign in (1.0, -1.0))
    aligned = min(
        (placed for placed in mirrored if placed is not None),
        key=lambda placed: np.abs(placed - reference).max(),
    )
    assert_allclose((aligned - reference).sum(axis=0), 0.0, atol=1e-9)
    for i, j in combinations(range(8), 2):
        g, v = reference[i] - reference[j], aligned[i] - aligned[j]
        turn = np.arctan2(g[0] * v[1] - g[1] * v[0], g @ v)
        assert turns[i, 0, j] - 1e-9 <= turn <= turns[i, 1, j] + 1e-9
    widths_rad = [turns[i, 1, j] - turns[i, 0, j] for i, j in pairs]
    # The errors alone turn pairs by some hundredths.
    assert np.median(widths_rad) < 0.1


@pytest.mark.parametrize(('relative_error', 'most'), [(0.01, 1.06), (0.03, 1.15)])
def test_pairs_are_narrowed_close_to_what_the_errors_explain(relative_error, most):
    excess = []
    for seed in range(8):
        positions, problem = fleet(seed, relative_error, 6)
        pruner = Pruner(problem, SolverOptions())
        box = pruner.prune(pruner.whole()).box
        pairs = np.argwhere(np.triu(np.isinf(problem.upper)))
        explained = np.zeros(len(pairs))
        start = place_step_by_step(box, 2)
        assert pruner.narrow_in_common_frame(box, start, pairs, explained, never)
        squared = squared_distances(positions)
        assert (box[0] <= squared).all() and (squared <= box[1]).all()
        i, j = pairs.T
        excess.extend((box[1, i, j] - box[0, i, j]) / explained)
    assert np.median(excess) < most


def excess_of(problem):
    """Return the widths that linear programs leave of the unknown pairs, over the explained."""
    pruner = Pruner(problem, SolverOptions())
    pruned = pruner.prune(pruner.whole())
    box, pairs = pruned.box, np.argwhere(np.triu(np.isinf(problem.upper)))
    explained = pruned.explained[tuple(pairs.T)]
    assert pruner.narrow_in_common_frame(box, place_step_by_step(box, 2), pairs, explained, never)
    i, j = pairs.T
    return box[:2, i, j], (box[1, i, j] - box[0, i, j]) / explained


def test_a_box_is_cut_where_pairs_are_wide_and_nowhere_else(monkeypatch):
    wide = common_frame.MOST_EXCESS[1]
    n_cut = 0
    for seed in range(20):
        _, problem = fleet(seed, 0.01, 6)
        monkeypatch.setattr(common_frame, 'MOST_CUTS', 0)
        whole, excess = excess_of(problem)
        monkeypatch.undo()
        parts, excess_of_parts = excess_of(problem)
        assert (parts[0] >= whole[0]).all() and (parts[1] <= whole[1]).all()
        assert (parts[:, excess < wide] == whole[:, excess < wide]).all()
        assert excess_of_parts.max() < wide
        n_cut += excess.max() > wide
    assert n_cut == 2


def test_time_that_is_up_leaves_the_box_as_it_is():
    _, problem = fleet(0, 0.01, 6)
    pruner = Pruner(problem, SolverOptions())
    box = pruner.prune(pruner.whole()).box
    before = box.copy()
    pairs = np.argwhere(np.triu(np.isinf(problem.upper)))
    explained = np.zeros(len(pairs))
    start = place_step_by_step(box, 2)
    assert pruner.narrow_in_common_frame(box, start, pairs, explained, lambda: True)
    assert (box == before).all() and not explained.any()
