# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Intervals of arrays, angles and numbers from outside, against exact numbers and many digits."""

from decimal import Decimal
from fractions import Fraction
import math

from hypothesis import example, given, strategies as st
import mpmath
import numpy as np
import pytest

from dg_localization.interval import angles, arrays
from dg_localization.interval.arrays import Interval
from dg_localization.interval.intake import lower_bounds, upper_bounds

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


FRACTIONS = st.floats(0.0, 1.0)
HALF_TURN = st.floats(-math.pi, math.pi)
EXACT = {'cosine': mpmath.cos, 'sine': mpmath.sin}


def between(low, high, fraction):
    return min(max(low + fraction * (high - low), low), high)


def holds(name, ends, fraction, bounds, excess):
    """Check that bounds hold a value between two angles, and exceed their range by little."""
    low, high = bounds
    with mpmath.workprec(200):
        value = EXACT[name](mpmath.mpf(between(*ends, fraction)))
        assert -1.0 <= low <= value <= high <= 1.0
        extremes = [EXACT[name](mpmath.mpf(end)) for end in ends]
        quarters = [k * mpmath.pi / 2 for k in range(-9, 10)]
        extremes += [EXACT[name](x) for x in quarters if ends[0] < x < ends[1]]
        assert low >= min(extremes) - excess and high <= max(extremes) + excess


def ends_of(name, low_rad, high_rad):
    """Return the bounds of a function of one angle between two others."""
    found = getattr(angles, name)(Interval.between(low_rad, high_rad))
    return float(found.lower), float(found.upper)


@pytest.mark.parametrize('name', ['cosine', 'sine'])
@given(
    low_rad=st.floats(-angles.LARGEST_ANGLE_RAD, angles.LARGEST_ANGLE_RAD),
    width_rad=st.floats(0.0, 7.0),
    fraction=FRACTIONS,
)
@example(low_rad=0.0, width_rad=math.pi, fraction=1.0)
@example(low_rad=-math.pi, width_rad=0.0, fraction=0.0)
@example(low_rad=math.pi / 2, width_rad=math.pi, fraction=1.0)
@example(low_rad=2.0 * math.pi, width_rad=1e-16, fraction=0.0)
def test_sines_and_cosines_of_arrays(name, low_rad, width_rad, fraction):
    ends = low_rad, min(low_rad + width_rad, angles.LARGEST_ANGLE_RAD)
    # A sine is the cosine of an angle that is a quarter turn less.
    excess = 1e-13 if max(map(abs, ends)) < 10.0 else 2.0
    holds(name, ends, fraction, ends_of(name, *ends), excess)


@pytest.mark.parametrize('angle_rad', [15.0, -1e9, math.inf, -math.inf])
def test_angles_that_went_round_too_often_bound_nothing(angle_rad):
    for name in EXACT:
        assert ends_of(name, angle_rad, angle_rad) == (-1.0, 1.0)


@given(FRACTIONS, st.floats(0.0, math.pi))
@example(1.0, 0.0)
@example(1e-300, 0.0)
def test_arcsines_and_chords(x, angle_rad):
    with mpmath.workprec(200):
        exact_rad = mpmath.asin(mpmath.mpf(x))
        assert exact_rad <= angles.arcsine_up(x) <= exact_rad + 2e-14
        exact = 2 * mpmath.sin(mpmath.mpf(angle_rad) / 2)
        assert exact <= angles.chord_up(angle_rad) <= exact + 1e-13
    assert math.pi / 2 < angles.arcsine_up(1.5) < math.pi / 2 + 1e-13


@given(HALF_TURN, HALF_TURN)
def test_a_computed_angle_lies_between_its_bounds(yaw_rad, other_rad):
    computed_rad = math.atan2(math.sin(yaw_rad), math.cos(yaw_rad)) + other_rad
    with mpmath.workprec(200):
        exact_rad = mpmath.mpf(yaw_rad) + mpmath.mpf(other_rad)
    assert angles.angle_down(computed_rad) <= exact_rad <= angles.angle_up(computed_rad)


@given(st.floats(-12.0, 12.0), st.floats(0.0, 4.0), st.floats(-1.0, 1.0))
def test_rotations_hold_every_matrix_within_the_half_width(angle_rad, half_width_rad, fraction):
    matrix = angles.rotation_2d(angle_rad, half_width_rad)
    with mpmath.workprec(200):
        inside_rad = mpmath.mpf(angle_rad) + mpmath.mpf(fraction) * mpmath.mpf(half_width_rad)
        x, y = mpmath.cos(inside_rad), mpmath.sin(inside_rad)
        for row, column, value in ((0, 0, x), (0, 1, -y), (1, 0, y), (1, 1, x)):
            assert matrix.lower[row, column] <= value <= matrix.upper[row, column]


LARGEST = math.nextafter(math.inf, 0.0)
FINITE = {'allow_nan': False, 'allow_infinity': False}
RATIONALS = st.integers(), st.integers(-(2**70), 2**70), st.fractions()
REALS = st.one_of(*RATIONALS, st.decimals(**FINITE), st.floats(**FINITE))


def are_next_to(lower, exact, upper):
    """Tell whether two doubles are the tightest bounds of a rational."""
    lower, upper = float(lower), float(upper)  # those of NumPy are not compared exactly
    if lower == upper:
        return Fraction(lower) == exact
    return lower < exact < upper and math.nextafter(lower, math.inf) == upper


@given(st.lists(REALS, min_size=1, max_size=6))
@example([2**53 + 1, 0.5])
@example([Decimal('1e400'), Decimal('-1e-400'), 10**400, -(10**400), Fraction(1, 10**400)])
@example([Decimal('1.00000000000000000000000000000000000000000000000001')])
def test_numbers_of_python_get_the_tightest_bounds(numbers):
    bounds = lower_bounds(numbers), upper_bounds(numbers)
    for number, lower, upper in zip(numbers, *bounds, strict=True):
        assert are_next_to(lower, Fraction(number), upper)


@pytest.mark.parametrize('dtype', [np.int64, np.uint64])
@pytest.mark.parametrize('value', [0, 1, 2**53, 2**53 + 1, 2**60 + 1, 2**63 - 1])
def test_integers_of_numpy_get_the_tightest_bounds(dtype, value):
    for values in (np.array([value, 0], dtype=dtype), [dtype(value), 0.5]):
        assert are_next_to(lower_bounds(values)[0], value, upper_bounds(values)[0])


@pytest.mark.parametrize('dtype', [np.float16, np.float32, np.float64])
def test_doubles_and_shorter_numbers_are_exact(dtype):
    array = np.array([0.1, -0.0, np.inf, -np.inf, np.nan], dtype=dtype)
    for found in (lower_bounds(array), upper_bounds(array)):
        assert np.array_equal(found, array.astype(float), equal_nan=True)
        assert found is not array


@pytest.mark.parametrize('sign', [-1, 1])
def test_long_doubles_are_rounded_outward(sign):
    if np.finfo(np.longdouble).eps == np.finfo(float).eps:
        pytest.skip('a long double is a double here')
    tiny = np.finfo(np.longdouble).eps
    array = sign * (np.longdouble(1) + np.array([tiny, -tiny, 0]))
    lower, upper = lower_bounds(array), upper_bounds(array)
    assert (lower[:2] < array[:2]).all() and (array[:2] < upper[:2]).all()
    assert (np.nextafter(lower[:2], np.inf) == upper[:2]).all()
    assert lower[2] == upper[2] == sign


def test_what_overflows_is_bounded_by_the_largest_double():
    huge = [10**400, -(10**400)]
    assert lower_bounds(huge).tolist() == [LARGEST, -math.inf]
    assert upper_bounds(huge).tolist() == [math.inf, -LARGEST]
    if np.finfo(np.longdouble).max > LARGEST:
        array = np.array([np.finfo(np.longdouble).max, -np.finfo(np.longdouble).max])
        assert lower_bounds(array).tolist() == [LARGEST, -math.inf]
        assert upper_bounds(array).tolist() == [math.inf, -LARGEST]


@pytest.mark.parametrize(
    ('values', 'text'),
    [
        (np.ma.masked_array([1.0], mask=[False]), 'masked'),
        (np.array([1j]), 'complex128'),
        (np.array([True]), 'bool'),
        (np.array(['1']), '<U1'),
        ([1.0, '2'], r"\[1\] = '2'"),
        ([1.0, np.bool_(True)], r'\[1\] = '),
        ([[1.0], [2.0, 3.0]], r'\[0\] = \[1.0\]'),
        ([np.ones((2, 2)), np.ones((2, 3))], 'different lengths'),
        ([Decimal('sNaN')], 'NaN'),
    ],
)
def test_what_is_no_real_number_is_refused(values, text):
    for function in (lower_bounds, upper_bounds):
        with pytest.raises(ValueError, match=text):
            function(values)
