# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Slices of yaws: no yaw falls between two."""

import math

from hypothesis import given, strategies as st
import numpy as np

from dg_localization.pairs.yaw_slices import MOST_PER_TURN, YawSlices

ANGLES = st.floats(-3.0 * math.pi, 3.0 * math.pi)
ARCS = st.one_of(st.just(0.0), st.just(2.0 * math.pi), st.floats(0.0, 2.0 * math.pi))
SHARES = st.floats(0.0, 1.0)


def holding(slices, yaw_rad):
    """Return which slices hold a yaw."""
    middle, half = slices.yaws.T
    return np.abs(np.vectorize(math.remainder)(yaw_rad - middle, math.tau)) <= half


@given(ANGLES, ARCS, SHARES, st.integers(1, 200))
def test_an_arc_has_few_slices_and_all_of_its_yaws(first, arc, share, most):
    slices = YawSlices.of_arc(first, first + arc, most)
    assert holding(slices, first + share * arc).any()
    assert len(slices) <= max(most, 33)
    assert slices.per_turn <= MOST_PER_TURN
    assert slices.numbers.max(initial=0) < slices.per_turn


@given(
    ANGLES,
    ARCS,
    SHARES,
    st.lists(
        st.tuples(
            st.sampled_from(['turned', 'spread', 'wider', 'thinner', 'some']),
            ANGLES,
            st.one_of(st.just(0.0), st.floats(0.0, 0.3), st.floats(0.0, 9.0)),
            st.sampled_from([-1.0, -0.3, 0.0, 1.0]),
        ),
        max_size=12,
    ),
)
def test_a_yaw_goes_from_slice_to_slice_and_is_not_lost(first, arc, share, changes):
    slices = YawSlices.of_arc(first, first + arc, 96)
    yaw_rad = first + share * arc
    for change, turn_rad, half_rad, err in changes:
        there = np.flatnonzero(holding(slices, yaw_rad))
        if change == 'turned':
            yaw_rad += turn_rad + err * half_rad
            slices = slices.turned(turn_rad, half_rad)
            assert np.all(holding(slices, yaw_rad)[there])
            continue
        if change == 'some':
            slices = slices[np.isin(np.arange(len(slices)), [*there, 0, len(slices) - 1])]
            assert holding(slices, yaw_rad).any()
            continue
        if change == 'wider' and slices.per_turn < 4 or slices.per_turn > 1000:
            continue
        slices, sources, targets = getattr(slices, change)()
        # Each slice that held it is joined to one that holds it.
        for source in there:
            assert holding(slices, yaw_rad)[targets[sources == source]].any()
        assert len(np.unique(slices.numbers % slices.per_turn)) == len(slices)
        if change == 'spread' and len(slices) < slices.per_turn:
            assert slices.beyond_rad < slices.width_rad + 1e-12


def test_slices_all_around_are_no_more_than_a_turn_has():
    slices = YawSlices.of_arc(-math.pi, math.pi, 96)
    for _turn in range(20):
        slices = slices.turned(1.0, 0.5).spread()[0]
        assert len(slices) == slices.per_turn == 64
        assert np.all(np.abs(slices.numbers) < 2 * slices.per_turn)


def test_no_slices_stay_no_slices():
    none = YawSlices.of_arc(0.0, 1.0, 9)[:0]
    for change in (none.spread, none.wider, none.thinner):
        slices, sources, targets = change()
        assert len(slices) == len(sources) == len(targets) == 0
