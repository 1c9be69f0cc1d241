# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Numbers from outside against exact rationals."""

from decimal import Decimal
from fractions import Fraction
import math

from hypothesis import example, given, strategies as st
import numpy as np
import pytest

from dg_localization.interval.intake import lower_bounds, upper_bounds

LARGEST = math.nextafter(math.inf, 0.0)
NUMBERS = st.one_of(
    st.integers(),
    st.integers(-(2**70), 2**70),
    st.fractions(),
    st.decimals(allow_nan=False, allow_infinity=False),
    st.floats(allow_nan=False, allow_infinity=False),
)


def are_next_to(lower, exact, upper):
    """Tell whether two doubles are the tightest bounds of a rational."""
    lower, upper = float(lower), float(upper)  # those of NumPy are not compared exactly
    if lower == upper:
        return Fraction(lower) == exact
    return lower < exact < upper and math.nextafter(lower, math.inf) == upper


@given(st.lists(NUMBERS, min_size=1, max_size=6))
@example([2**53 + 1, 0.5])
@example([Decimal('1e400'), Decimal('-1e-400'), 10**400, -(10**400), Fraction(1, 10**400)])
@example([Decimal('1.00000000000000000000000000000000000000000000000001')])
def test_numbers_of_python_get_the_tightest_bounds(numbers):
    for number, lower, upper in zip(
        numbers, lower_bounds(numbers), upper_bounds(numbers), strict=True
    ):
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
