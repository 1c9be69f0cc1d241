# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
How many placements there are, counted independently.

Graphs are built point by point, each measured from q points before it: all placements follow from
intersections of circles and spheres. Points lie on a lattice, many of them in line, so that hubs
are flat, bars parallel and pieces mirrored at faces that coincide.
"""

from itertools import combinations
import os

import numpy as np
import pytest
from solver_cases import CancelAfter, bounds, holding, problem_of, squared_distances

from dg_localization import Chirality, Problem, Side, SideConstraint, SolverOptions, Verdict, solve

COUNTED = int(os.environ.get('DG_PROPERTY_PROBLEMS', '400')) // 2
APART_M = 2e-3


def intersections(centers, squared_m2):
    """Return the one or two points at these squared distances from q points, or nothing."""
    dimension = centers.shape[1]
    rows = 2.0 * (centers[1:] - centers[0])
    values = squared_m2[0] - squared_m2[1:] + (centers[1:] ** 2 - centers[0] ** 2).sum(axis=1)
    if np.linalg.matrix_rank(rows, tol=1e-9) < dimension - 1:
        return None
    foot = np.linalg.lstsq(rows, values, rcond=None)[0] if len(rows) else np.zeros(dimension)
    normal = np.linalg.svd(rows)[2][-1] if len(rows) else np.ones(1)
    foot = foot + normal * ((centers[0] - foot) @ normal)
    height_m2 = squared_m2[0] - ((foot - centers[0]) ** 2).sum()
    if height_m2 < -1e-9:
        return []
    height_m = np.sqrt(max(height_m2, 0.0))
    return [foot] if height_m < 1e-4 else [foot + height_m * normal, foot - height_m * normal]


def built_case(seed):
    """Return a lattice of points in the order of their construction, and what each measures."""
    rng = np.random.default_rng([seed, 17])
    dimension = int(rng.choice([1, 2, 2, 2, 3]))
    n_points = int(rng.integers(dimension + 2, 8 if dimension == 2 else 7))
    reach = int(rng.choice([2, 4]))
    positions = rng.integers(0, reach + 1, (n_points, dimension)).astype(float)
    if rng.random() < 0.5:
        # The first points lie in a hyperplane.
        positions[: dimension + 2, -1] = 0.0
    measured = dict.fromkeys(combinations(range(dimension), 2), 0.0)
    for point in range(dimension, n_points):
        near = rng.choice(point, dimension, replace=False)
        if rng.random() < 0.4:
            near = np.arange(dimension)
        measured |= {(int(k), point): 0.0 for k in near}
    return rng, positions, measured


def placements_of(positions, measured):
    """Return squared distances of all placements, None where points leave some of them free."""
    n_points, dimension = positions.shape
    squared = squared_distances(positions)
    begun = [[positions[k] for k in range(dimension)]]
    for point in range(dimension, n_points):
        near = [i for i, j in measured if j == point]
        further = []
        for placed in begun:
            new = intersections(np.array([placed[k] for k in near]), squared[near, point])
            if new is None:
                return None
            further += [[*placed, one] for one in new]
        begun = further
    return [np.array(placed) for placed in begun]


def distinct(found):
    """Return one of each congruence class."""
    classes = []
    for placed in found:
        apart_m = np.sqrt(squared_distances(placed))
        others = (np.sqrt(squared_distances(c)) for c in classes)
        if all(np.abs(apart_m - other).max() > APART_M for other in others):
            classes.append(placed)
    return classes


def with_more(rng, positions, found):
    """Return bounds across the graph, and sides, with the placements that they leave."""
    n_points, dimension = positions.shape
    squared = squared_distances(positions)
    ranges, sides = {}, []
    kind = rng.choice(['nothing', 'nothing', 'least', 'wide', 'side'])
    i, j = sorted(rng.choice(n_points, 2, replace=False).tolist())
    if kind == 'least' and squared[i, j] > 0.0:
        ranges[i, j] = (0.9 * squared[i, j], np.inf)
    elif kind == 'wide' and squared[i, j] > 0.0:
        ranges[i, j] = (0.8 * squared[i, j], 1.3 * squared[i, j])
    elif kind == 'side' and n_points >= dimension + 2:
        named = rng.choice(n_points, dimension + 2, replace=False).tolist()
        face, first, second = named[:dimension], named[-2], named[-1]
        volumes = [_volume(positions, face, apex) for apex in (first, second)]
        if abs(volumes[0] * volumes[1]) > 1e-6:
            side = Side.SAME if volumes[0] * volumes[1] > 0.0 else Side.OPPOSITE
            sides.append(SideConstraint(tuple(face), first, second, side))
    left = []
    for placed in found:
        apart = squared_distances(placed)
        inside = all(low - 1e-3 <= apart[x] <= high + 1e-3 for x, (low, high) in ranges.items())
        for c in sides:
            volumes = [_volume(placed, c.face, apex) for apex in (c.first, c.second)]
            inside &= volumes[0] * volumes[1] * (-1 if c.side is Side.OPPOSITE else 1) > -1e-3
        if inside:
            left.append(placed)
    return ranges, sides, left


def _volume(positions, face, apex):
    corners = positions[[*face, apex]]
    return float(np.linalg.det(corners[1:] - corners[0]))


def holds(hypothesis, positions):
    apart_m = np.sqrt(squared_distances(positions))
    least_m, most_m = np.sqrt(hypothesis.lower) - 1e-4, np.sqrt(hypothesis.upper) + 1e-4
    return bool(((least_m <= apart_m) & (apart_m <= most_m)).all())


def solved_case(seed):
    """Return the placements of a case, one of each class, and the answer; None where some move."""
    rng, positions, measured = built_case(seed)
    found = placements_of(positions, measured)
    if found is None:
        return None
    ranges, sides, found = with_more(rng, positions, found)
    problem = problem_of(positions, measured, ranges, sides=sides)
    return distinct(found), solve(problem, SolverOptions(resolution=0.01, max_boxes=4000))


def test_every_placement_is_one_hypothesis():
    n_exact = 0
    for seed in range(COUNTED):
        if (solved := solved_case(seed)) is None:
            continue
        classes, result = solved
        held = [[x for x, h in enumerate(result.hypotheses) if holds(h, c)] for c in classes]
        assert result.verdict is Verdict.COVERED and all(held), seed
        assert result.n_hypotheses >= len(classes), seed
        if not result.n_hypotheses_is_bound:
            n_exact += 1
            assert result.n_hypotheses == len(classes) == len(result.hypotheses), seed
            assert sorted(x for numbers in held for x in numbers) == [*range(len(classes))], seed
    assert n_exact > 0.6 * COUNTED


@pytest.mark.parametrize(
    ('seed', 'count', 'is_bound'),
    [
        # The base of a triangle is known within a range, and exactly by the piece beside it.
        (1000217, 8, False),
        # Points 2, 3 and 5 are in line if 2 and 3 are 2 m apart, and not if 2.28 m.
        (8020477, 12, True),
    ],
    ids=['flat by itself and not beside another', 'flat at two faces in one of its hypotheses'],
)
def test_a_piece_that_may_be_flat(seed, count, is_bound):
    classes, result = solved_case(seed)
    assert result.n_hypotheses_is_bound == is_bound
    assert len(classes) == count <= result.n_hypotheses
    assert is_bound or result.n_hypotheses == count


def test_a_piece_that_is_flat_beside_one_of_two_hypotheses():
    positions = np.array([(0, 0), (4, 0), (1, 2), (2, 3), (2, 3)], dtype=float)
    known = {pair: squared_distances(positions)[pair] for pair in ((0, 1), (0, 2), (1, 2))}
    known |= {(0, 3): 13.0, (1, 3): 13.0, (2, 4): 0.16 * 26.0, (3, 4): 0.36 * 26.0}
    # 2 and 3 are on the same side of the line through 0 and 1, or on different ones.
    ranges = {pair: (value, value) for pair, value in known.items()} | {(2, 3): (1.0, 30.0)}
    result = solve(Problem(*bounds(5, ranges), 2))
    assert result.n_hypotheses_is_bound and result.n_hypotheses >= 3
    apart_m2 = {round(float(h.lower[2, 3])) for h in result.hypotheses}
    assert apart_m2 == {2, 26}


@pytest.mark.parametrize(
    ('exact_m2', 'wide_m2', 'pair', 'apart_m', 'count'),
    [
        (
            {(0, 2): 16, (0, 5): 5, (0, 7): 25, (1, 2): 17, (1, 5): 2, (2, 3): 8, (2, 4): 1}
            | {(3, 4): 5, (3, 5): 1, (3, 7): 5, (4, 5): 10, (4, 6): 4, (6, 7): 8},
            {(1, 3): (0.0, 3.28), (1, 6): (0.0, 9.85)},
            (1, 7),
            [1.617, 2.481],
            2,
        ),
        (
            {(0, 2): 1, (0, 6): 8, (1, 2): 5, (1, 3): 2, (1, 4): 1, (1, 6): 4, (1, 7): 1}
            | {(2, 3): 1, (3, 4): 1, (3, 5): 5, (4, 6): 9, (5, 7): 10, (6, 7): 1},
            {(0, 5): (0.0, 5.1)},
            (0, 1),
            [1.240, 2.0],
            2,
        ),
        (
            {(0, 1): 1, (0, 5): 2, (0, 6): 2, (1, 2): 4, (1, 3): 5, (1, 6): 5, (2, 4): 8}
            | {(2, 5): 5, (3, 4): 1, (3, 5): 2, (5, 6): 4},
            {(1, 5): (0.0, 2.618)},
            (2, 3),
            [2.236, 3.606],
            8,
        ),
        (
            {(0, 2): 2, (0, 7): 4, (1, 5): 5, (1, 6): 4, (2, 5): 4, (2, 6): 1, (2, 7): 2}
            | {(3, 5): 1, (3, 7): 1, (4, 5): 1, (4, 6): 2, (5, 7): 2, (6, 7): 1},
            {(0, 6): (0.0, 2.618), (1, 4): (0.0, 7.4), (2, 3): (0.0, 2.618)},
            (1, 4),
            [1.414, 2.280],
            6,
        ),
    ],
    ids=['that others tell', 'at a reference in line', 'told by a piece', 'told by a later piece'],
)
def test_a_wide_measurement_explains_no_box_with_two_placements(
    exact_m2, wide_m2, pair, apart_m, count
):
    ranges = {x: (value * (1 - 1e-6), value * (1 + 1e-6)) for x, value in exact_m2.items()}
    n_points = 1 + max(max(x) for x in exact_m2)
    result = solve(Problem(*bounds(n_points, ranges | wide_m2), 2))
    assert (result.n_hypotheses, result.n_hypotheses_is_bound) == (count, False)
    found_m = np.sqrt([h.bounds_of_pair(*pair) for h in result.hypotheses])
    nearest_m = [min(apart_m, key=lambda x: abs(x - low)) for low, _ in found_m]
    assert found_m == pytest.approx(np.transpose([nearest_m, nearest_m]), abs=0.01)
    assert set(nearest_m) == set(apart_m)


def test_one_side_of_a_face_is_told_by_a_piece_at_another_joint():
    """Two tetrahedra know a wide range of points 1 and 5, and a bipyramid knows more."""
    exact_m2 = {(0, 1): 4, (0, 3): 5, (0, 5): 2, (0, 6): 1, (1, 2): 8, (1, 3): 1, (1, 4): 1}
    exact_m2 |= {(1, 6): 5, (2, 4): 9, (2, 5): 2, (2, 6): 5, (3, 5): 5, (4, 5): 5, (4, 6): 8}
    exact_m2[5, 6] = 5
    ranges = {pair: (value * (1 - 1e-5), value * (1 + 1e-5)) for pair, value in exact_m2.items()}
    result = solve(Problem(*bounds(7, ranges | {(1, 5): (4.57, 8.7)}), 3))
    assert len(result.pieces) == 3
    assert result.n_hypotheses == 4 and not result.n_hypotheses_is_bound


FLAT = ((0, 0), (4, 0), (2, 0), (1, 2), (3, 2))
ON_ONE_EDGE = ((0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (0, 4), (1, 4))


@pytest.mark.parametrize('order', [(0, 1, 2, 3, 4), (3, 1, 4, 0, 2), (4, 3, 2, 1, 0)])
@pytest.mark.parametrize('error', [0.0, 1e-9, 1e-3, 0.02])
def test_triangles_on_one_edge_of_which_one_is_flat(order, error):
    number = {old: new for new, old in enumerate(order)}
    positions = np.array(FLAT, dtype=float)[list(order)]
    measured = [tuple(sorted((number[i], number[j]))) for i, j in ON_ONE_EDGE]
    result = solve(problem_of(positions, measured, error=error))
    pair = number[3], number[4]
    apart_m = sorted(np.sqrt(h.bounds_of_pair(*pair)).tolist() for h in result.hypotheses)
    assert result.n_hypotheses == 2
    # Exact distances in line are hardly ever proved to be met.
    assert error == 0.0 or not result.n_hypotheses_is_bound
    for (low_m, high_m), true_m in zip(apart_m, (2.0, 20**0.5), strict=True):
        assert low_m - 1e-9 < true_m < high_m + 1e-9
    assert apart_m[0][1] < 2.2 and apart_m[1][0] > 4.3


def test_a_piece_that_is_flat_in_one_hypothesis_alone():
    """Its sides are at two faces where it is not flat: the count says that it is a bound."""
    for order in ((0, 1, 2, 3, 4, 5, 6), (6, 2, 4, 0, 5, 1, 3)):
        positions = np.array([(1, 4), (2, 1), (1, 1), (1, 0), (1, 4), (0, 2), (1, 0)], float)
        pairs = [(0, 1), (0, 2), (0, 3), (0, 6), (1, 2), (1, 3), (1, 6)]
        pairs += [(2, 4), (2, 5), (3, 4), (4, 5)]
        found = distinct(placements_of(positions, dict.fromkeys(pairs, 0.0)))
        number = np.argsort(order)
        measured = [tuple(sorted((int(number[i]), int(number[j])))) for i, j in pairs]
        result = solve(problem_of(positions[list(order)], measured))
        assert len(found) == 12 <= result.n_hypotheses
        assert result.n_hypotheses_is_bound or result.n_hypotheses == 12
        for placed in found:
            assert any(holds(h, placed[list(order)]) for h in result.hypotheses)


def test_a_flat_piece_passes_sides_on():
    """Between two faces of a flat piece, of two flat pieces, in space, and on the line."""
    line = [(0, 0), (2, 0), (5, 0), (1, 2), (4, 2)]
    joined = [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (1, 4), (2, 4)]
    longer = [(0, 0), (2, 0), (5, 0), (1, 2), (6, 2), (7, 0)]
    chain = [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (1, 5), (2, 5), (2, 4), (4, 5)]
    base = [(0, 0, 0), (4, 0, 0), (0, 4, 0), (1, 1, 0), (1, 1, 2), (2, 1, 3)]
    in_space = [(0, 1), (0, 2), (1, 2), *((i, j) for j in (3, 4, 5) for i in (0, 1, 2))]
    on_line = [[0], [0], [2], [5]], [(0, 1), (0, 2), (0, 3)]
    for positions, measured in ((line, joined), (longer, chain), (base, in_space), on_line):
        result = solve(problem_of(positions, measured, error=1e-4))
        assert result.n_hypotheses == len(result.hypotheses) == 2, positions
        first, second = result.hypotheses
        assert ((first.lower > second.upper) | (second.lower > first.upper)).any(), positions
        assert first.proved and second.proved


def test_a_chirality_of_one_triangle_says_nothing_of_the_other():
    chirality = Chirality((0, 1, 3), 1)
    result = solve(problem_of(FLAT, ON_ONE_EDGE, error=1e-3, chiralities=[chirality]))
    assert result.n_hypotheses == len(result.hypotheses) == 2


def test_what_does_not_tell_a_side_leaves_both():
    positions = np.array([(0, 0), (4, 0), (1, 2), (3, 1)], dtype=float)
    free, known = SideConstraint((0, 1), 2, 3, Side.FREE), Chirality((0, 1, 2), 1)
    for more in ({'sides': [free]}, {'chiralities': [known]}):
        result = solve(problem_of(positions, ON_ONE_EDGE[:5], error=0.1, **more))
        assert result.n_hypotheses == len(result.hypotheses) == 2


def folded_strip(n_points, least=0.0, **constraints):
    """Return a strip of triangles, its ends at least so far apart as a part of their distance."""
    positions = [(i, 2 * (i % 2)) for i in range(n_points)]
    measured = [(i, j) for i in range(n_points) for j in (i + 1, i + 2) if j < n_points]
    least_m2 = least * squared_distances(np.array(positions, float))[0, -1]
    far = {(0, n_points - 1): (least_m2, np.inf)}
    return problem_of(positions, measured, far if least else {}, error=0.02, **constraints)


@pytest.mark.parametrize(('n_points', 'most'), [(5, 64), (8, 64), (10, 64), (10, 3), (14, 64)])
def test_constraints_between_pieces_that_share_no_joint_count(n_points, most):
    options = SolverOptions(max_hypotheses=most)
    result = solve(folded_strip(n_points, least=0.97), options)
    assert result.verdict is Verdict.COVERED
    assert result.n_hypotheses == len(result.hypotheses) == 1
    assert result.hypotheses[0].proved and not result.n_hypotheses_is_bound


def test_the_list_has_what_is_possible_and_is_never_empty():
    """Of 2^38 combinations one is possible, and hardly any can be looked at."""
    result = solve(folded_strip(40, least=0.97))
    assert result.verdict is Verdict.COVERED and result.hypotheses
    squared = squared_distances(np.array([(i, 2.0 * (i % 2)) for i in range(40)]))
    assert result.n_hypotheses_is_bound or result.n_hypotheses == 1
    assert holding(result.hypotheses, squared)


def test_what_is_mirrored_at_every_joint_is_counted_exactly():
    result = solve(folded_strip(40))
    assert result.n_hypotheses == 2**37 and not result.n_hypotheses_is_bound


@pytest.mark.parametrize('most', range(1, 40, 2))
def test_sides_that_there_was_no_time_to_tell_are_counted(most):
    result = solve(folded_strip(6), cancel=CancelAfter(most))
    assert result.n_hypotheses >= 2**3 or result.verdict is Verdict.OUT_OF_BUDGET
    assert result.n_hypotheses_is_bound or result.n_hypotheses == 2**3


def test_sides_of_two_pieces_with_many_hypotheses_are_counted():
    """On a line ten bars of 1 m in a ring have 126 placements; two rings share a point."""
    positions = np.array([[x % 2 if x < 10 else 1 - x % 2] for x in range(19)], dtype=float)
    bars = [(x, x + 1) for x in range(18) if x != 9] + [(0, 9), (0, 10), (0, 18)]
    result = solve(problem_of(positions, bars, error=1e-3), SolverOptions(max_boxes=10**4))
    assert result.n_hypotheses >= 2 * 126**2


@pytest.mark.parametrize('n_points', [9, 49])
def test_parts_that_given_boxes_leave_between_pieces_are_counted(n_points):
    positions = np.random.default_rng(0).random((n_points, 2))
    bodies = range(n_points // 2 + 1), (0, *range(n_points // 2 + 1, n_points))
    problem = problem_of(positions, [pair for body in bodies for pair in combinations(body, 2)])
    far_m2 = solve(problem).upper[1, -1]
    parts = [{(1, n_points - 1): (part * far_m2, 1.05 * part * far_m2)} for part in (0.6, 0.8)]
    assert solve(problem, within=[bounds(n_points, part) for part in parts]).n_hypotheses == 2
