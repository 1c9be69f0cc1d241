# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Separating pairs found in neighborhoods, against the removal of each point in turn."""

import numpy as np
import pytest
from test_decomposition import as_array, near_pairs

from dg_localization.solver.decompose.graph import cut_points, graph_of
from dg_localization.solver.decompose.rigid_components import rigid_components
from dg_localization.solver.decompose.separating_pairs import FIRST_POINTS, separating_pairs


def removed_in_turn(n_points, pairs):
    """Return the separating pairs of a graph: the cut points that are left without each point."""
    graph = graph_of(n_points, pairs)
    found = []
    for i in range(n_points):
        removed = np.zeros(n_points, dtype=bool)
        removed[i] = True
        found += [[i, int(j)] for j in np.flatnonzero(cut_points(graph, removed)) if j > i]
    return found


def ladder(length, *rungs):
    """Return the pairs of two chains of points that some rungs join, the first and last too."""
    rails = {(2 * x + side, 2 * x + side + 2) for x in range(length - 1) for side in (0, 1)}
    return as_array(rails | {(2 * x, 2 * x + 1) for x in {0, length - 1, *rungs}})


@pytest.mark.parametrize('length', [2, 3, 10, FIRST_POINTS, 10 * FIRST_POINTS])
def test_a_ring_is_separated_by_any_two_points_that_are_no_neighbors(length):
    pairs = ladder(length)
    n_pairs = len(separating_pairs(graph_of(2 * length, pairs)))
    assert n_pairs == 2 * length * (2 * length - 3) // 2


@pytest.mark.parametrize('every', [1, 2, 7])
@pytest.mark.parametrize('length', [5, 50, 300])
def test_both_sides_may_be_larger_than_a_neighborhood(length, every):
    pairs = ladder(length, *range(0, length, every))
    found = separating_pairs(graph_of(2 * length, pairs)).tolist()
    assert found == removed_in_turn(2 * length, pairs)
    assert [length - length % 2, length - length % 2 + 1] in found or length < 5


@pytest.mark.parametrize('degree', [4, 5, 6, 8, 10])
def test_neighborhoods_tell_what_the_whole_graph_does(degree):
    rng = np.random.default_rng(degree)
    n_found = 0
    for _ in range(12):
        n_points = int(rng.integers(10, 400))
        pairs = near_pairs(rng, n_points, 2, degree)
        for component in rigid_components(n_points, pairs, 2):
            if len(component) < 4:
                continue
            inner = pairs[np.isin(pairs, component).all(axis=1)]
            local = np.searchsorted(component, inner)
            found = separating_pairs(graph_of(len(component), local)).tolist()
            assert found == removed_in_turn(len(component), local)
            n_found += len(found)
    assert n_found > 20


def test_points_with_many_neighbors():
    """A wheel has no separating pair; a fan, whose rim is open, has one for each point inside."""
    rim = range(1, 201)
    spokes = {(0, point) for point in rim}
    fan = spokes | {(point, point + 1) for point in rim if point < 200}
    assert len(separating_pairs(graph_of(201, as_array(fan | {(1, 200)})))) == 0
    found = separating_pairs(graph_of(201, as_array(fan))).tolist()
    assert found == [[0, point] for point in range(2, 200)]
