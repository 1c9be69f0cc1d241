"""Malformed input is refused with the field, the index and the value in the message."""

from itertools import permutations

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
)

TRIANGLE = {(0, 1): (1.0, 2.0), (1, 2): (1.0, 2.0), (0, 2): (1.0, 2.0)}


def with_entries(field, value, *indices):
    """Return the bounds of a triangle with some entries of one field overwritten."""
    lower, upper = bounds(3, TRIANGLE)
    for index in indices:
        {'lower': lower, 'upper': upper}[field][index] = value
    return lower, upper


@pytest.mark.parametrize('field', ['lower', 'upper'])
@pytest.mark.parametrize(
    ('value', 'indices', 'text'),
    [
        (np.nan, [(0, 2), (2, 0)], r'\[0,2\] = nan m\^2 is NaN'),
        (-0.5, [(1, 2), (2, 1)], r'\[1,2\] = -0.5 m\^2 is negative'),
        (1.5, [(2, 1)], r'\[1,2\] = .* differs from its transpose'),
        (0.25, [(1, 1)], r'\[1,1\] = 0.25 m\^2 must be 0'),
    ],
)
def test_wrong_entries(field, value, indices, text):
    with pytest.raises(InvalidProblemError, match=field + text):
        Problem(*with_entries(field, value, *indices))


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        (with_entries('lower', 3.0, (0, 1), (1, 0)), r'lower\[0,1\] = 3.0 .* upper\[0,1\] = 2.0'),
        (with_entries('lower', np.inf, (0, 1), (1, 0)), r'lower\[0,1\] is infinite'),
        ((np.zeros((2, 3)), np.zeros((2, 3))), r'lower has shape \(2, 3\)'),
        ((np.zeros((2, 2)), np.zeros(2)), r'upper has shape \(2,\)'),
        ((np.zeros((2, 2)), np.zeros((3, 3))), r'lower is \(2, 2\), upper is \(3, 3\)'),
        ((np.zeros((0, 0)), np.zeros((0, 0))), 'no points'),
    ],
)
def test_wrong_bounds(arguments, text):
    with pytest.raises(InvalidProblemError, match=text):
        Problem(*arguments)


@pytest.mark.parametrize('dimension', [0, 4, 2.5, None, '2'])
def test_wrong_dimension(dimension):
    with pytest.raises(InvalidProblemError, match=f'dimension is {dimension!r}'):
        Problem(*bounds(3, TRIANGLE), dimension=dimension)


@pytest.mark.parametrize(
    ('constraint', 'text'),
    [
        (SideConstraint((0,), 1, 2, Side.SAME), r'face=\(0,\).* 2 points'),
        (SideConstraint((0, 1, 2), 3, 3, Side.SAME), r'face=\(0, 1, 2\).* 2 points'),
        (SideConstraint((0, 4), 1, 2, Side.SAME), r'point 4 is not in 0..3'),
        (SideConstraint((0, 1), -1, 2, Side.SAME), r'point -1 is not in 0..3'),
        (SideConstraint((0, 1), 1, 2, Side.SAME), r'\(0, 1, 1, 2\) are not all different'),
        (SideConstraint((0, 1), 2, 3, 2), r'side=2.* -1, 0 or \+1'),
    ],
)
def test_wrong_sides(constraint, text):
    with pytest.raises(InvalidProblemError, match=text):
        Problem(*bounds(4, TRIANGLE), sides=[constraint])


@pytest.mark.parametrize(
    ('chirality', 'text'),
    [
        (Chirality((0, 1), 1), r'points=\(0, 1\).* 3 points'),
        (Chirality((0, 1, 4), 1), r'point 4 is not in 0..3'),
        (Chirality((0, 1, 1), 1), r'\(0, 1, 1\) are not all different'),
        (Chirality((0, 1, 2), 0), r'sign=0.* -1 or \+1'),
    ],
)
def test_wrong_chiralities(chirality, text):
    with pytest.raises(InvalidProblemError, match=text):
        Problem(*bounds(4, TRIANGLE), chiralities=[chirality])


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('resolution', 0.0),
        ('resolution', -0.1),
        ('resolution', float('nan')),
        ('resolution', float('inf')),
        ('max_boxes', 0),
        ('max_seconds', 0.0),
        ('max_seconds', -1.0),
        ('max_seconds', float('nan')),
    ],
)
def test_wrong_options(field, value):
    with pytest.raises(ValueError, match=f'{field} is {value}'):
        SolverOptions(**{field: value})


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


def test_lists_and_integers_will_do():
    problem = Problem([[0, 1], [1, 0]], [[0, 4], [4, 0]])
    assert problem.n_points == 2
    assert problem.upper.dtype == np.float64
