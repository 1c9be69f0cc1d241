# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Range reduction on the line (Section 4.2) against brute force over arrangements."""

from fractions import Fraction
import math

from hypothesis import given, strategies as st
import numpy as np
from solver_cases import bounds_around, box_of, squared_distances, symmetric

from dg_localization.solver.box import UPPER
from dg_localization.solver.contract.line import _narrow_to_distances, _set_roots, reduce_line
from dg_localization.solver.contract.projection import whole_lanes
from dg_localization.solver.contract.reduction import make_workspace


def reduce(box, merged, sigma, points):
    n_points = box.shape[1]
    work, count = make_workspace(n_points, 1), len(points)
    pairs = np.ix_(range(4), points, points)
    across = work.across[0]
    across[UPPER] = np.inf
    across[:, :count, :count] = box[pairs]
    scratch = work.distance, work.is_open, work.n_open
    if not reduce_line(across, *scratch, points, n_points, merged, sigma):
        return False
    box[pairs] = across[:, :count, :count]
    return True


def holds(box, squared):
    inside = (box[0] <= squared) & (squared <= box[1])
    return bool(np.all(inside & ~((box[2] < squared) & (squared < box[3]))))


@given(st.integers(0, 2**32))
def test_no_arrangement_is_lost(seed):
    """The truth stays: any widths, sides, order of the points, and points on top of each other."""
    rng = np.random.default_rng(seed)
    n_points = int(rng.integers(2, 12))
    x = rng.integers(-10, 11, n_points)
    squared = squared_distances(x[:, None] * 2.0 ** rng.choice([-40, 0, 40]))
    box = box_of(*bounds_around(rng, squared, [0.0, 1e-9, 0.1, 1.0], alike=0.1))
    unknown = symmetric(rng.random((n_points, n_points)) < 0.3)
    box[:2, unknown] = [[0.0], [math.inf]]
    merged = int(rng.integers(-1, n_points))
    sigma = np.zeros((n_points, n_points), dtype=np.int8)
    if merged >= 0:
        sides = np.sign(x - x[merged])
        # A point on the hyperplane is on both sides.
        known = symmetric(rng.random(sigma.shape) < 0.5)
        sigma[:] = np.where(known, -np.outer(sides, sides), 0)
    before = box.copy()
    points = rng.permutation(n_points)[: rng.integers(2, n_points + 1)]
    assert reduce(box, merged, sigma, points)
    assert holds(box, squared)
    assert (box[0] >= before[0]).all() and (box[1] <= before[1]).all()
    assert np.array_equal(box, box.transpose(0, 2, 1))


def test_gaps_are_rounded_inward_on_the_way_to_the_line_and_on_the_way_back():
    """An end of a gap belongs to the box: its root, and its square, may not lie in the gap."""
    rng = np.random.default_rng(3)
    shape = (4, 2, whole_lanes(2))
    for ends in np.sort(rng.uniform(0.1, 9.9, (200, 2))):
        box, distance = np.zeros(shape), np.zeros(shape)
        box[:, [0, 1], [1, 0]] = np.array([0.0, 10.0, *ends])[:, None]
        _set_roots(box, distance, 2)
        low_m, high_m = map(Fraction, distance[2:, 0, 1].tolist())
        assert low_m**2 >= Fraction(float(ends[0])) and high_m**2 <= Fraction(float(ends[1]))
        box[2:] = 0.0
        assert _narrow_to_distances(box, distance, 2)
        low_m2, high_m2 = map(Fraction, box[2:, 0, 1].tolist())
        assert low_m2 >= low_m**2 and high_m2 <= high_m**2
