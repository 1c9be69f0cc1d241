# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Real UWB ranges: 1,452 epochs of four robots against motion capture, the solver alone."""

from collections import defaultdict
import csv

import numpy as np
import pytest
from solver_cases import bounds, covers, squared_distances

from dg_localization import Problem, SolverOptions, solve

POINT_OF_NODE = {1: 0, 3: 1, 4: 2, 5: 3}


def planar(squared):
    """Return the placement in the plane nearest to measured distances (classical scaling)."""
    centring = np.eye(len(squared)) - 1.0 / len(squared)
    values, vectors = np.linalg.eigh(-0.5 * centring @ squared @ centring)
    return vectors[:, -2:] * np.sqrt(values[-2:])


@pytest.fixture(scope='module')
def epochs(shared):
    """Return [({(i, j): measured range in m}, true planar squared distances)]."""
    measured, true = defaultdict(dict), defaultdict(dict)
    with (shared / 'data/tiers_uwb/20221011_processed.csv').open() as file:
        for row in csv.DictReader(file):
            pair = tuple(POINT_OF_NODE[int(float(row[node]))] for node in ('node1', 'node2'))
            measured[row['timestamp']][pair] = float(row['uwb_range'])
            true[row['timestamp']][pair] = float(row['mocap_range']) ** 2, 0.0
    # The markers are up to 2 cm out of one plane: the truth is the plane through them.
    return [
        (measured[stamp], squared_distances(planar(bounds(4, true[stamp])[0])))
        for stamp in measured
    ]


@pytest.mark.parametrize(
    ('long_m', 'short_m', 'obeying'),
    [(1.3, 0.05, 1.0), (0.95, 0.05, 0.93), (0.65, 0.05, 0.75)],
)
def test_every_epoch_that_obeys_its_bounds_is_covered(epochs, long_m, short_m, obeying):
    """
    UWB errs one way: a range is up to `long_m` too long and `short_m` too short.

    1.3 m and 5 cm hold for the whole recording; 0.95 m for 99 % of the ranges.
    """
    assert len(epochs) == 1452
    obeyed, covered = 0, 0
    for measured, squared in epochs:
        ranges = {
            pair: (max(0.0, r - long_m) ** 2, (r + short_m) ** 2) for pair, r in measured.items()
        }
        result = solve(Problem(*bounds(4, ranges)), SolverOptions(resolution=0.05, max_boxes=100))
        lower, upper = bounds(4, ranges)
        if np.all((lower <= squared) & (squared <= upper)):
            obeyed += 1
            covered += covers(result, squared)
    assert covered == obeyed
    assert obeyed >= obeying * len(epochs)
