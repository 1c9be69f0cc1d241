# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Pieces and joints of known graphs, and of random ones against the rank of their matrices."""

from itertools import combinations

import numpy as np
import pytest

from benchmarks.pieces import neighbors
from dg_localization import JointKind
from dg_localization.solver.decompose.decomposition import pieces_of
from dg_localization.solver.decompose.graph import pairs_of
from dg_localization.solver.decompose.rigid_components import is_rigid, rigid_rank

HINGE, REFLECTION, LOOSE = JointKind.HINGE, JointKind.REFLECTION, JointKind.LOOSE


def complete(*points, without=()):
    return {pair for pair in combinations(points, 2) if pair not in without}


def as_array(pairs):
    return np.array(sorted(tuple(sorted(pair)) for pair in pairs), dtype=np.int64).reshape(-1, 2)


def decomposed(n_points, pairs, dimension=2):
    """Return the points of the pieces and (points, kind, points of each piece) of the joints."""
    answer = pieces_of(n_points, as_array(pairs), dimension)
    pieces = list(answer.pieces)
    joints = {
        (joint.points, joint.kind, frozenset(pieces[x] for x in joint.pieces))
        for joint in answer.joints
    }
    return set(pieces), joints


def test_the_double_banana_turns_about_a_line():
    """As many pairs as eight rigid points need, and yet a flex: Maxwell's count fails in space."""
    first, second = (0, 1, 2, 3, 4), (0, 1, 5, 6, 7)
    pairs = complete(*first, without={(0, 1)}) | complete(*second, without={(0, 1)})
    assert len(pairs) == rigid_rank(8, 3)
    pieces, joints = decomposed(8, pairs, dimension=3)
    assert pieces == {first, second}
    assert joints == {((0, 1), HINGE, frozenset({first, second}))}


def near_pairs(rng, n_points, dimension, degree):
    """Return the closest pairs of random points."""
    _, pairs = neighbors(n_points, degree, dimension, int(rng.integers(2**32)))
    return as_array(pairs.tolist())


def check_pieces(n_points, pairs, dimension):
    """Assert what a decomposition promises."""
    answer = pieces_of(n_points, pairs, dimension)
    measured = {tuple(pair) for pair in pairs.tolist()}
    assert set().union(*answer.pieces) == set(range(n_points))
    assert measured <= set().union(*map(pairs_of, answer.pieces))
    known = set(measured)
    for number, part in enumerate(answer.pieces):
        own = [pair for pair in pairs_of(part) if pair in known]
        local = np.searchsorted(part, np.array(own).reshape(-1, 2))
        assert is_rigid(len(part), local, dimension)
        for joint in answer.joints:
            if number in joint.pieces:
                assert set(joint.points) <= set(part)
                known.update(pairs_of(joint.points))
    for joint in answer.joints:
        assert len(joint.pieces) > 1
        shared = {HINGE: [dimension - 1], REFLECTION: [dimension]}
        assert len(joint.points) in shared.get(joint.kind, range(1, dimension - 1))
    return answer


@pytest.mark.parametrize('dimension', [1, 2, 3])
def test_every_piece_is_rigid_by_what_comes_before_it(dimension):
    rng = np.random.default_rng(10 + dimension)
    for _ in range(100):
        n_points = int(rng.integers(1, 15))
        check_pieces(
            n_points, near_pairs(rng, n_points, dimension, int(rng.integers(1, 9))), dimension
        )


def test_a_part_hears_of_a_pair_from_a_piece_that_it_shares_no_joint_with():
    """Points 0 and 2 wait for the distance of 5 and 7, which 3, 6 and 8 imply."""
    pairs = complete(3, 5, 6, 7, 8, without={(5, 7)}) | {(1, 3), (1, 5), (1, 6)}
    pairs |= {(2, 5), (2, 6), (2, 7), (0, 2), (0, 5), (0, 7), (4, 5), (4, 7)}
    answer = check_pieces(9, as_array(pairs), 3)
    assert {(4, 5, 7), (0, 2, 5, 7)} <= set(answer.pieces)
    assert ((5, 7), HINGE) in {(joint.points, joint.kind) for joint in answer.joints}


@pytest.mark.parametrize('degree', [2, 4, 6, 8, 10])
def test_a_thousand_points_in_the_plane(degree):
    check_pieces(1000, near_pairs(np.random.default_rng(degree), 1000, 2, degree), 2)
