# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Interval operations against the vectors of IEEE 1788 and against exact rationals."""

import math
import re
import struct

from hypothesis import assume, given, strategies as st
import pytest

from dg_localization.interval import scalars as interval
from dg_localization.interval.rounding import sqrt_down, sqrt_up

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
    return all(
        0 <= e <= MOST_EXCESS + (abs(end) < LEAST_NORMAL * 4.0)
        for e, end in zip(excess, tightest, strict=True)
    )


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
