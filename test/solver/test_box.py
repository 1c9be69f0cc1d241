# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The ranges of a box with their gaps, as sets of numbers."""

from hypothesis import given, strategies as st
import numpy as np

from dg_localization.solver.box import GAP_LOWER, GAP_UPPER, LOWER, UPPER, cut_at, exclude, narrow

PROBES = np.arange(0.0, 12.25, 0.25)
ENDS = st.integers(0, 12).map(float)
SORTED = st.tuples(ENDS, ENDS).map(sorted)


@st.composite
def boxes(draw):
    """Draw a box of two points whose gap, if any, lies inside its range."""
    low, high = draw(SORTED)
    box = np.zeros((4, 2, 2))
    box[LOWER, 0, 1] = box[LOWER, 1, 0] = low
    box[UPPER, 0, 1] = box[UPPER, 1, 0] = high
    gap_low, gap_high = draw(SORTED)
    if low <= gap_low < gap_high <= high:
        box[GAP_LOWER, 0, 1] = box[GAP_LOWER, 1, 0] = gap_low
        box[GAP_UPPER, 0, 1] = box[GAP_UPPER, 1, 0] = gap_high
    return box


def members(box):
    """Return which of the probes a box holds."""
    low, high, gap_low, gap_high = box[:, 0, 1]
    return (low <= PROBES) & (PROBES <= high) & ~((gap_low < PROBES) & (PROBES < gap_high))


def check(box, wanted, left):
    assert np.array_equal(box, box.transpose(0, 2, 1))
    assert left == (box[LOWER, 0, 1] <= box[UPPER, 0, 1])
    lost = wanted & ~members(box) if left else wanted
    assert not lost.any()


@given(boxes(), SORTED)
def test_narrow_is_the_intersection(box, interval):
    wanted = members(box) & (interval[0] <= PROBES) & (PROBES <= interval[1])
    left = narrow(box, 0, 1, *interval)
    check(box, wanted, left)
    if left:
        assert np.array_equal(members(box), wanted)


@given(boxes(), SORTED)
def test_exclude_loses_nothing_but_the_gap(box, gap):
    range_before = box[LOWER, 0, 1], box[UPPER, 0, 1]
    wanted = members(box) & ~((gap[0] < PROBES) & (PROBES < gap[1]))
    check(box, wanted, exclude(box, 0, 1, *gap))
    assert range_before[0] <= box[LOWER, 0, 1] and box[UPPER, 0, 1] <= range_before[1]


@given(boxes(), SORTED)
def test_the_parts_of_a_cut_box_lose_nothing_but_what_is_between_them(box, ends):
    low_end, high_start = ends
    below, above = cut_at(box, (0, 1), low_end, high_start)
    wanted = members(box) & ~((low_end < PROBES) & (PROBES < high_start))
    assert not (wanted & ~(members(below) | members(above))).any()
    assert np.array_equal(below, below.transpose(0, 2, 1))
    assert np.array_equal(above, above.transpose(0, 2, 1))
