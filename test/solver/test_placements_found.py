# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Placements are proved where the truth is well inside all bounds; real ranges are covered."""

from collections import defaultdict
import csv
from itertools import combinations
import json

import numpy as np
import pytest
from solver_cases import bounds, covers, holding, squared_distances

from benchmarks.large import fleet
from dg_localization import Problem, SolverOptions, Verdict, solve

NETWORKS = {2: 200, 3: 50}
LEAST_SHARE = {2: 0.99, 3: 0.96}
"""By dimension: in space some searches end at their most boxes."""


def drawn_network(seed, dimension):
    """Draw a network whose bounds are as wide as those of UWB, the truth a tenth inside them."""
    rng = np.random.default_rng(seed)
    n_points = int(rng.integers(6, 13))
    positions_m = rng.random((n_points, dimension)) * rng.choice([4.0, 8.0, 15.0, 30.0])
    if seed % 4 == 0:
        positions_m[:, -1] *= 0.3
    pairs = list(combinations(range(n_points), 2))
    rigid = dimension * n_points - dimension * (dimension + 1) // 2
    count = min(len(pairs), int(rng.integers(rigid + 1, rigid + n_points)))
    width_m = rng.choice([0.3, 1.35, 2.0])
    ranges = {}
    for number in rng.permutation(len(pairs))[:count]:
        i, j = pairs[number]
        true_m = np.linalg.norm(positions_m[i] - positions_m[j])
        below_m = rng.uniform(0.1, 0.9) * width_m
        ranges[i, j] = max(true_m - below_m, 0.0) ** 2, (true_m + width_m - below_m) ** 2
    return Problem(*bounds(n_points, ranges), dimension=dimension), positions_m


@pytest.mark.parametrize('dimension', [2, 3])
def test_the_hypothesis_with_the_truth_has_a_proved_placement(dimension):
    options = SolverOptions(max_boxes=300)
    n_proved = 0
    for seed in range(NETWORKS[dimension]):
        problem, positions_m = drawn_network(seed, dimension)
        found = holding(solve(problem, options).hypotheses, squared_distances(positions_m), 1e-9)
        assert found
        n_proved += any(hypothesis.proved for hypothesis in found)
    assert n_proved >= LEAST_SHARE[dimension] * NETWORKS[dimension]


@pytest.mark.parametrize('name', ['campus_sport_poor_samples', 'campus_sport_rich_samples'])
def test_the_placement_of_a_real_network_is_proved(name, shared):
    network = json.loads((shared / f'data/dwm1001/{name}_medians.json').read_text())
    number = {name: x for x, name in enumerate(network['names'])}
    places_m = np.array(network['places_m'])
    readings = [(*sorted((number[a], number[b])), read_m) for a, b, read_m in network['readings']]
    errors_m = [r - np.linalg.norm(places_m[i] - places_m[j]) for i, j, r in readings]
    ranges = {}
    for i, j, read_m in readings:
        low_m, high_m = max(read_m - max(errors_m), 0.0), read_m - min(errors_m)
        known = ranges.get((i, j), (0.0, np.inf))
        ranges[i, j] = max(low_m**2, known[0]), min(high_m**2, known[1])
    (found,) = solve(Problem(*bounds(len(places_m), ranges))).hypotheses
    assert found.proved


def test_a_thousand_points_have_a_proved_placement():
    problem, _ = fleet(1000, 10, 0.03, 0)
    result = solve(problem, SolverOptions(max_boxes=10**9, max_seconds=60.0))
    assert result.verdict is Verdict.COVERED
    largest = max(result.pieces, key=lambda piece: len(piece.points))
    (hypothesis,) = largest.hypotheses
    assert hypothesis.proved
    # Other coordinates than the truth, in all of its bounds.
    lower, upper = problem.bounds_among(largest.points)
    squared = squared_distances(hypothesis.positions)
    assert ((lower <= squared) & (squared <= upper)).all()


POINT_OF_NODE = {1: 0, 3: 1, 4: 2, 5: 3}


def planar(squared):
    """Return the placement in the plane nearest to measured distances (classical scaling)."""
    centring = np.eye(len(squared)) - 1.0 / len(squared)
    values, vectors = np.linalg.eigh(-0.5 * centring @ squared @ centring)
    return vectors[:, -2:] * np.sqrt(values[-2:])


def test_the_truth_is_covered_at_every_epoch_of_a_recording(shared):
    """UWB errs one way: a range is up to 1.3 m too long and 5 cm too short."""
    measured, true = defaultdict(dict), defaultdict(dict)
    with (shared / 'data/tiers_uwb/20221011_processed.csv').open() as file:
        for row in csv.DictReader(file):
            pair = tuple(POINT_OF_NODE[int(float(row[node]))] for node in ('node1', 'node2'))
            range_m = float(row['uwb_range'])
            measured[row['timestamp']][pair] = max(0.0, range_m - 1.3) ** 2, (range_m + 0.05) ** 2
            true[row['timestamp']][pair] = float(row['mocap_range']) ** 2, 0.0
    assert len(measured) == 1452
    for stamp, ranges in measured.items():
        # The markers are up to 2 cm out of one plane: the truth is the plane through them.
        squared = squared_distances(planar(bounds(4, true[stamp])[0]))
        result = solve(Problem(*bounds(4, ranges)), SolverOptions(resolution=0.05, max_boxes=100))
        assert covers(result, squared), stamp
