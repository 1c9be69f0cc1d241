# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Malformed input is refused with the field, the index and the value in the message."""

from fractions import Fraction
from itertools import permutations
import re

import numpy as np
import pytest
from solver_cases import bounds

from dg_localization import (
    Chirality,
    InvalidProblemError,
    Problem,
    Side,
    SideConstraint,
    SolverOptions,
    solve,
)

TRIANGLE = {(0, 1): (1.0, 2.0), (1, 2): (1.0, 2.0), (0, 2): (1.0, 2.0)}
TWO_APART = [[0.0, 2.0], [2.0, 0.0]]


def triangle(field='lower', value=0.0, *indices):
    """Return the bounds of a triangle with some entries of one field overwritten."""
    lower, upper = bounds(3, TRIANGLE)
    for index in indices:
        {'lower': lower, 'upper': upper}[field][index] = value
    return lower, upper


def face(*points, first=2, second=3, side=Side.SAME):
    return {'sides': [SideConstraint(points, first, second, side)]}


def corners(points, sign=1):
    return {'chiralities': [Chirality(points, sign)]}


ENTRIES = [
    (np.nan, [(0, 2), (2, 0)], r'\[0,2\] = nan m\^2 is NaN'),
    (-0.5, [(1, 2), (2, 1)], r'\[1,2\] = -0.5 m\^2 is negative'),
    (1.5, [(2, 1)], r'\[1,2\] = .* differs from its transpose'),
    (0.25, [(1, 1)], r'\[1,1\] = 0.25 m\^2 must be 0'),
]
FOUR = bounds(4, TRIANGLE)


@pytest.mark.parametrize(
    ('arguments', 'constraints', 'text'),
    [
        *(
            (triangle(field, value, *indices), {}, field + text)
            for field in ('lower', 'upper')
            for value, indices, text in ENTRIES
        ),
        (triangle('lower', 3.0, (0, 1), (1, 0)), {}, r'lower\[0,1\] = 3.0 .* upper\[0,1\] = 2.0'),
        (triangle('lower', np.inf, (0, 1), (1, 0)), {}, r'lower\[0,1\] is infinite'),
        ((np.zeros((2, 3)), np.zeros((2, 3))), {}, r'lower has shape \(2, 3\)'),
        ((np.zeros((2, 2)), np.zeros(2)), {}, r'upper has shape \(2,\)'),
        ((np.zeros((2, 2)), np.zeros((3, 3))), {}, r'lower is \(2, 2\), upper is \(3, 3\)'),
        ((np.zeros((0, 0)), np.zeros((0, 0))), {}, 'no points'),
        (
            (np.ma.masked_array(TWO_APART, mask=np.eye(2)), TWO_APART),
            {},
            'lower is a masked array',
        ),
        (([[0, 1j], [1j, 0]], TWO_APART), {}, r'lower has the entry \[0,1\] = 1j'),
        (([[0, 1], [1]], TWO_APART), {}, r'lower has the entry \[0\] = \[0, 1\]'),
        ((3.0, TWO_APART), {}, r'lower has shape \(\)'),
        *((triangle(), {'dimension': q}, f'dimension is {q!r}') for q in (0, 2.5, True, None)),
        (FOUR, {'sides': None}, 'sides is None'),
        (FOUR, {'sides': [(0, 1, 2, 3, -1)]}, 'is no SideConstraint'),
        (FOUR, {'sides': [SideConstraint(None, 2, 3, Side.SAME)]}, 'None are no points'),
        (FOUR, face(0, 1.0), 'point 1.0 is not an integer'),
        (FOUR, {'chiralities': [((0, 1, 2), 1)]}, 'is no Chirality'),
        (FOUR, face(0, first=1, second=2), r'face=\(0,\).* 2 points'),
        (FOUR, face(0, 4, first=1, second=2), r'point 4 is not in 0..3'),
        (FOUR, face(0, 1, first=1, second=2), r'\(0, 1, 1, 2\) are not all'),
        (FOUR, face(0, 1, side=2), r'side=2.* -1, 0 or \+1'),
        (FOUR, corners((0, 1)), r'points=\(0, 1\).* 3 points'),
        (FOUR, corners((0, 1, 4)), r'point 4 is not in 0..3'),
        (FOUR, corners((0, 1, 1)), r'\(0, 1, 1\) are not all different'),
        (FOUR, corners(7), '7 are no points'),
        (FOUR, corners((0, 1, 2), 1.5), r'-1 or \+1'),
    ],
)
def test_what_is_no_problem_is_refused(arguments, constraints, text):
    with pytest.raises(InvalidProblemError, match=text):
        Problem(*arguments, **constraints)


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('resolution', 0.0),
        ('resolution', float('nan')),
        ('max_boxes', 0),
        ('max_seconds', 0.0),
        ('max_seconds', float('nan')),
        ('resolution', True),
        ('tighten_seconds', -0.1),
        ('max_boxes', 2.5),
        ('max_hypotheses', 0),
        ('resolution', 1.4e154),
    ],
)
def test_wrong_options(field, value):
    with pytest.raises(ValueError, match=re.escape(f'{field} is {value}')):
        SolverOptions(**{field: value})


def test_options_are_kept_as_numbers_of_python():
    options = SolverOptions(resolution=1, max_boxes=np.int64(7), max_seconds=Fraction(1, 2))
    assert (type(options.resolution), options.resolution) == (float, 1.0)
    assert (type(options.max_boxes), options.max_boxes) == (int, 7)
    assert options.max_seconds == 0.5


@pytest.mark.parametrize(
    ('within', 'text'),
    [
        ([3], r'within\[0\] is no pair'),
        ([(np.zeros((3, 3)), [[1j] * 3] * 3)], r'within\[0\]: upper has the entry \[0,0\]'),
        ([(np.full((3, 3), np.inf),) * 2], r'within\[0\]: lower is inf'),
        ([(np.eye(3), np.eye(3))], r'within\[0\] is not 0 everywhere on the diagonal'),
    ],
)
def test_wrong_boxes_to_search_in(within, text):
    with pytest.raises(InvalidProblemError, match=text):
        solve(Problem(*bounds(3, TRIANGLE)), within=within)


@pytest.mark.parametrize('order', list(permutations((3, 0, 2, 1))))
def test_a_chirality_in_another_order_is_that_of_the_determinant(order):
    corners = np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 0.0], [1.0, 4.0, 1.0], [1.0, 1.0, 5.0]])

    def sign(points):
        edges = corners[list(points[1:])] - corners[points[0]]
        return int(np.sign(np.linalg.det(edges)))

    assert Chirality((3, 0, 2, 1), sign((3, 0, 2, 1))).sign_of(order) == sign(order)


def test_a_problem_is_its_own_copy():
    lower, upper = bounds(3, TRIANGLE)
    problem = Problem(lower, upper)
    lower[0, 1] = 0.0
    assert problem.lower[0, 1] == 1.0
    with pytest.raises(ValueError, match='read-only'):
        problem.upper[0, 1] = 5.0


LISTED = {'n_points': 4, 'i': [0, 1, 3], 'j': [1, 2, 2], 'lower': [1.0] * 3, 'upper': [2.0] * 3}


def test_a_problem_of_listed_pairs_is_that_of_its_matrices():
    problem = Problem.from_pairs(**LISTED, chiralities=[Chirality((0, 1, 2), 1)])
    listed = {(0, 1): (1.0, 2.0), (1, 2): (1.0, 2.0), (2, 3): (1.0, 2.0)}
    lower, upper = bounds(4, listed)
    assert (problem.lower == lower).all() and (problem.upper == upper).all()
    assert not problem.lower.flags.writeable and problem.n_points == 4
    assert problem.chiralities == (Chirality((0, 1, 2), 1),)
    low, high = problem.bounds_among([2, 3, 0])
    index = np.ix_([2, 3, 0], [2, 3, 0])
    assert (low == lower[index]).all() and (high == upper[index]).all()
    again = Problem(lower, upper).pairs
    assert (again.pairs == [[0, 1], [1, 2], [2, 3]]).all()
    assert (again.keys == problem.pairs.keys).all()


def test_bounds_of_listed_pairs_are_rounded_outward():
    wide = 2**53 + 1
    given = {**LISTED, 'lower': [wide, 1, 1], 'upper': [wide, Fraction(1, 3) + 1, 2]}
    pairs = Problem.from_pairs(**given).pairs
    lower, upper = pairs.lower.tolist(), pairs.upper.tolist()
    assert lower[0] < wide < upper[0] and upper[1] > Fraction(4, 3)


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [
        ({'n_points': 0}, 'n_points is 0'),
        ({'i': [0, 1, 4]}, r'i\[2\] = 4 is not in 0..3'),
        ({'j': [1, -1, 2]}, r'j\[1\] = -1 is not in 0..3'),
        ({'i': [0, 1, 2.5]}, 'i has entries of type float64, integers are needed'),
        ({'i': np.ma.masked_array([0, 1, 3], mask=[0, 1, 0])}, 'i is a masked array'),
        ({'j': [1, 2]}, r'j has shape \(2,\), i has shape \(3,\)'),
        ({'i': [1, 1, 3]}, r'i\[0\] = j\[0\] = 1: a pair needs two points'),
        ({'j': [1, 0, 2]}, r'pair \(0, 1\) is given twice, as entries 0 and 1'),
        ({'lower': [1.0, np.nan, 1.0]}, r'lower\[1\] = nan m\^2 of pair \(1, 2\) is NaN'),
        ({'lower': [-1.0, 1.0, 1.0]}, r'lower\[0\] = -1.0 m\^2 of pair \(0, 1\) is negative'),
        ({'lower': [1.0, 3.0, 1.0]}, r'lower\[1\] = 3.0 .* exceeds upper\[1\] = 2.0'),
    ],
)
def test_wrong_pairs(wrong, text):
    with pytest.raises(InvalidProblemError, match=text):
        Problem.from_pairs(**{**LISTED, **wrong})


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        (([[0.0]], [[0.0]]), 'problem must be of type Problem, not list'),
        ((None,), 'problem must be of type Problem, not NoneType'),
        ((Problem([[0.0]], [[0.0]]), 0.05), 'options must be of type SolverOptions, not float'),
    ],
)
def test_what_is_no_problem_is_not_solved(arguments, text):
    with pytest.raises(TypeError, match=text):
        solve(*arguments)
