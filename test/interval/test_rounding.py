# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rounding and intervals of single numbers, against exact rationals and vectors of IEEE 1788."""

from fractions import Fraction
import math
import re
import struct

from hypothesis import assume, example, given, strategies as st
import numpy as np
import pytest

from dg_localization.interval import arrays, bounds, rounding, scalars as interval
from dg_localization.interval.rounding import sqrt_down, sqrt_up

ANY = st.floats(allow_nan=False, allow_infinity=False)
MODERATE = st.floats(-1e150, 1e150)


def ulps_between(x, y):
    """Return how many units in the last place of the larger number two numbers are apart."""
    unit = math.ulp(max(abs(x), abs(y)))
    return abs(Fraction(x) - Fraction(y)) / Fraction(unit)


@given(ANY)
@example(0.0)
@example(5e-324)
@example(2.2250738585072014e-308)
@example(math.nextafter(1.0, 0.0))
@example(-1.7976931348623157e308)
def test_up_and_down_move_by_one_or_two_units(x):
    higher, lower = rounding.up(x), rounding.down(x)
    assert higher >= math.nextafter(x, math.inf)
    assert lower <= math.nextafter(x, -math.inf)
    for moved in (higher, lower):
        assert math.isinf(moved) or ulps_between(x, moved) <= 2
    assert lower == -rounding.up(-x)


def test_infinities_are_missing_bounds_and_overflow_is_a_bound_on_the_near_side():
    largest = math.nextafter(math.inf, 0.0)
    assert rounding.LARGEST == largest
    assert rounding.up(math.inf) == rounding.sqrt_up(math.inf) == math.inf
    assert rounding.down(math.inf) == rounding.square_down(1e200) == rounding.down(largest)
    assert rounding.up(-math.inf) == -rounding.down(math.inf)
    assert bounds.sum_up(1.0, math.inf, -math.inf) == math.inf
    assert bounds.sum_down(1.0, math.inf, -math.inf) == -math.inf
    assert bounds.sum_up(-math.inf, 1.0) < -1e308
    assert bounds.quotient_up(1.0, 0.0) == math.inf
    assert bounds.quotient_down(1.0, 0.0) == 0.0


@given(st.lists(MODERATE, min_size=1, max_size=5))
@example([1.0, 2.0**-60, -1.0])
@example([0.1])
def test_sums_hold_the_exact_one(terms):
    low, high = bounds.sum_down(*terms), bounds.sum_up(*terms)
    assert low <= sum(map(Fraction, terms)) <= high
    assert len(terms) > 1 or low == high


@given(MODERATE, MODERATE)
@example(0.0, math.inf)
@example(-math.inf, 0.0)
def test_products_and_quotients_hold_the_exact_one(x, y):
    low, high = bounds.product_down(x, y), bounds.product_up(x, y)
    if x == 0.0 or y == 0.0:
        assert low == high == 0.0
        return
    assert low <= Fraction(x) * Fraction(y) <= high and ulps_between(low, high) <= 8
    x, y = abs(x), abs(y)
    if 1e-150 < x and 1e-150 < y:
        low, high = bounds.quotient_down(x, y), bounds.quotient_up(x, y)
        assert 0.0 <= low <= Fraction(x) / Fraction(y) <= high and ulps_between(low, high) <= 8


@given(st.floats(0.0, 1e154))
@example(1e-170)
@example(5e-324)
def test_squares_and_roots(x):
    exact = Fraction(x)
    low, high = rounding.square_down(x), rounding.square_up(x)
    assert 0 <= low <= exact**2 <= high and ulps_between(low, high) <= 5
    low, high = rounding.sqrt_down(x), rounding.sqrt_up(x)
    assert 0 <= Fraction(low) ** 2 <= exact <= Fraction(high) ** 2 and ulps_between(low, high) <= 5
    assert rounding.sqrt_up(-x) == rounding.sqrt_down(-x) == 0.0 or x == 0.0


@given(st.floats(allow_nan=False))
@example(math.inf)
def test_kernels_arrays_and_plain_functions_round_alike(x):
    for name in ('square_up', 'square_down', 'sqrt_up', 'sqrt_down'):
        assert getattr(bounds, name)(x) == getattr(rounding, name)(x)
    with np.errstate(over='ignore'):
        assert rounding.up(x) == rounding.step_up(x) == arrays.up(x)
        assert rounding.down(x) == rounding.step_down(x) == arrays.down(x)


@given(st.floats(0.0, 1e150), st.floats(0.0, 1e150))
def test_squared_distances(lower_m, width_m):
    upper_m = lower_m + width_m
    lower_m2, upper_m2 = bounds.squared_distance(lower_m, upper_m)
    assert 0.0 <= lower_m2 <= Fraction(lower_m) ** 2
    assert Fraction(upper_m) ** 2 <= upper_m2


@pytest.mark.parametrize('lower_m', [-2.0, 0.0, 1.0, math.inf])
def test_no_distance_is_negative(lower_m):
    lower_m2, upper_m2 = bounds.squared_distance(lower_m, -1.0)
    assert lower_m2 > upper_m2
    assert bounds.squared_distance(-3.0, math.inf) == (0.0, math.inf)


@given(st.integers(0, 2**61), st.integers(0, 10**11))
@example(1_700_000_000_123_456_789, 0)
@example(1_700_000_000_123_456_789, 50_000_000)
def test_elapsed_time_of_stamps_in_nanoseconds(stamp_ns, passed_ns):
    first_s, second_s = stamp_ns / 10**9, (stamp_ns + passed_ns) / 10**9
    elapsed_s = Fraction(passed_ns, 10**9)
    of_arrays = arrays.elapsed_up(np.array([first_s, second_s]), np.array([second_s, first_s]))
    for bound_s in (
        bounds.elapsed_up(first_s, second_s),
        bounds.elapsed_up(second_s, first_s),
        *of_arrays.tolist(),
    ):
        assert elapsed_s <= bound_s <= elapsed_s + 8 * Fraction(math.ulp(second_s))


@given(st.lists(st.floats(-1e3, 1e3), min_size=4, max_size=4))
def test_rounding_error_bounds_a_sum_of_products(numbers):
    a, b, c, d = numbers
    computed = a * b - c * d
    exact = Fraction(a) * Fraction(b) - Fraction(c) * Fraction(d)
    magnitude = abs(a * b) + abs(c * d)
    assert abs(computed - exact) <= rounding.rounding_error(magnitude, 3.0)


EMPTY = (math.inf, -math.inf)
ENTIRE = (-math.inf, math.inf)
LEAST_NORMAL = 2.0**-1022
MOST_EXCESS = 2
"""Doubles between an end and the tightest one; one more near the least normal number."""


def reverse_square(square, x=ENTIRE):
    return interval.reverse_square(*x, *square)


def on_pairs(operation):
    return lambda *operands: operation(*(end for operand in operands for end in operand))


# Operation of the vectors: (their file, how many there are, what is tested).
OPERATIONS = {
    'add': ('elem', 31, on_pairs(interval.add)),
    'sub': ('elem', 31, on_pairs(interval.sub)),
    'mul': ('elem', 116, on_pairs(interval.mul)),
    'sqr': ('elem', 12, on_pairs(interval.square)),
    'intersection': ('set', 5, on_pairs(interval.intersection)),
    'convexHull': ('set', 5, on_pairs(interval.hull)),
    'sqrRev': ('rev', 11, reverse_square),
    'sqrRevBin': ('rev', 11, reverse_square),
}


def number(text):
    text = text.strip()
    if text.endswith('infinity'):
        return math.inf * (-1 if text.startswith('-') else 1)
    return float.fromhex(text) if 'x' in text.lower() else float(text)


def ends(text):
    """Return the ends of an interval of the vectors."""
    named = {'empty': EMPTY, 'entire': ENTIRE}
    return named[text] if text in named else tuple(map(number, text.split(',')))


def vectors(path, operation):
    """Yield (operands, tightest result) of an operation; decorated intervals are left out."""
    for line in path.read_text().splitlines():
        match = re.fullmatch(rf'\s*{operation} ((?:\[[^]]*\]\s*)+)= \[([^]]*)\];', line)
        if match and 'nai' not in line:
            operands, result = match.groups()
            yield [ends(text) for text in re.findall(r'\[([^]]*)\]', operands)], ends(result)


def rank(x):
    """Return the place of a double among all doubles, from 0 at zero."""
    (bits,) = struct.unpack('<q', struct.pack('<d', x))
    return bits if bits >= 0 else -(bits & 0x7FFF_FFFF_FFFF_FFFF)


def is_tight(computed, tightest):
    """Tell whether an interval holds the tightest one and exceeds it by no more than it may."""
    excess = rank(tightest[0]) - rank(computed[0]), rank(computed[1]) - rank(tightest[1])
    ends = zip(excess, tightest, strict=True)
    return all(0 <= e <= MOST_EXCESS + (abs(end) < LEAST_NORMAL * 4.0) for e, end in ends)


@pytest.mark.parametrize('operation', OPERATIONS)
def test_vectors_of_the_standard(shared, operation):
    name, count, compute = OPERATIONS[operation]
    cases = list(vectors(shared / f'data/itf1788/libieeep1788_{name}.itl', operation))
    assert len(cases) == count
    for operands, tightest in cases:
        computed = compute(*operands)
        if tightest == EMPTY:
            assert computed == EMPTY, operands
        else:
            assert is_tight(computed, tightest), operands


ENDS = st.floats(allow_nan=False)


def intervals():
    """Draw intervals of any size, points, half-lines and all numbers among them."""
    pairs = st.one_of(st.tuples(ENDS, ENDS), ENDS.map(lambda x: (x, x)))
    return pairs.map(sorted).map(tuple).filter(lambda i: i[0] < math.inf and i[1] > -math.inf)


@given(intervals(), intervals())
def test_reverse_square_is_the_hull_of_both_roots(x, square):
    """Exact ends of the argument stay; roots are bounds, one or two units away."""
    assume(square[1] >= 0.0)
    near, far = sqrt_down(square[0]), sqrt_up(square[1])
    parts = [(max(x[0], start), min(x[1], end)) for start, end in ((-far, -near), (near, far))]
    parts = [part for part in parts if part[0] <= part[1]]
    expected = (parts[0][0], parts[-1][1]) if parts else EMPTY
    assert interval.reverse_square(*x, *square) == expected
