# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Intervals of arrays against exact rationals."""

from fractions import Fraction
import math

from hypothesis import given, strategies as st
import numpy as np
import pytest

from dg_localization.interval import arrays
from dg_localization.interval.arrays import Interval

NUMBERS = st.floats(-1e100, 1e100)


def intervals():
    return st.tuples(NUMBERS, NUMBERS).map(sorted)


OPERATIONS = {
    'sum': (lambda a, b: a + b, lambda x, y: x + y),
    'difference': (lambda a, b: a - b, lambda x, y: x - y),
    'product': (lambda a, b: a * b, lambda x, y: x * y),
    'square': (lambda a, b: a.square(), lambda x, y: x * x),
}


@pytest.mark.parametrize('name', OPERATIONS)
@given(intervals(), intervals(), st.integers(0, 3))
def test_results_of_members_are_members_of_the_result(name, first, second, corner):
    on_intervals, on_numbers = OPERATIONS[name]
    found = on_intervals(Interval.between(*first), Interval.between(*second))
    exact = on_numbers(Fraction(first[corner % 2]), Fraction(second[corner // 2]))
    assert found.lower <= exact <= found.upper


@given(intervals(), st.tuples(st.floats(1e-9, 1e9), st.floats(1e-9, 1e9)).map(sorted))
def test_quotients(first, divisor):
    found = Interval.between(*first).over(Interval.between(*divisor))
    for x in first:
        for y in divisor:
            assert found.lower <= Fraction(x) / Fraction(y) <= found.upper


def test_a_quotient_by_zero_may_be_anything():
    found = Interval.point([1.0]).over(Interval.between([0.0], [1.0]))
    assert found.lower <= 1.0
    assert found.upper == math.inf


@given(st.lists(st.integers(-1000, 1000), min_size=9, max_size=9))
def test_determinants_norms_and_vector_products_of_whole_numbers(numbers):
    rows = np.array(numbers, dtype=float).reshape(3, 3)
    (a, b, c), (d, e, f), (g, h, i) = rows
    exact = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    found = arrays.determinant(Interval.point(rows))
    assert found.lower <= exact <= found.upper
    assert found.upper - found.lower < 1e-3
    norms = arrays.squared_norm(Interval.point(rows))
    assert np.all((norms.lower <= (rows**2).sum(axis=1)) & ((rows**2).sum(axis=1) <= norms.upper))
    product = arrays.cross(Interval.point(rows[0]), Interval.point(rows[1]))
    assert np.all((product.lower <= np.cross(*rows[:2])) & (np.cross(*rows[:2]) <= product.upper))


@given(st.lists(st.integers(-100, 100), min_size=3, max_size=3).filter(any))
def test_unit_vectors(numbers):
    found = arrays.normalized(Interval.point(numbers))
    squared = sum(x * x for x in numbers)
    for low, high, x in zip(found.lower, found.upper, numbers, strict=True):
        # x / sqrt(squared) lies in [low, high], compared by signed squares.
        exact = Fraction(x * abs(x), squared)
        assert Fraction(low) * abs(Fraction(low)) <= exact <= Fraction(high) * abs(Fraction(high))
        assert high - low < 1e-14


def test_intersection_hull_sign_and_emptiness():
    a, b = Interval.between([0.0], [2.0]), Interval.between([1.0], [3.0])
    assert a.intersect(b) == Interval.between([1.0], [2.0])
    assert a.hull(b) == Interval.between([0.0], [3.0])
    assert not a.intersect(b).empty()
    assert a.intersect(Interval.between([4.0], [5.0])).empty()
    assert [Interval.between(*ends).sign() for ends in ((1, 2), (-2, -1), (-1, 1))] == [1, -1, 0]
