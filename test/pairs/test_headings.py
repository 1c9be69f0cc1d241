# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Headings of bodies at known places: no truth is lost, and mirror images are ruled out."""

import math
import os

from moved_fleet import MovedFleet
import numpy as np
import pytest

from dg_localization.pairs import HeadingOptions, headings, narrow_headings

FLEETS = int(os.environ.get('DG_PROPERTY_FLEETS', '60'))
FINE = HeadingOptions(cells=64)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('kind', [{}, {'rays': True}, {'space': True}, {'error': 0.0}], ids=str)
def test_no_truth_is_lost(kind):
    lost = []
    for seed in range(FLEETS):
        fleet = MovedFleet(seed, **kind)
        if not fleet.holds(narrow_headings(fleet.lower, fleet.upper, fleet.readings, FINE)):
            lost.append(seed)
    assert not lost


@pytest.mark.parametrize('scale_m', [1e-200, 1e-6, 1e6, 1e100])
def test_no_truth_is_lost_at_any_scale(scale_m):
    for seed in range(10):
        fleet = MovedFleet(seed, scale_m=scale_m)
        assert fleet.holds(narrow_headings(fleet.lower, fleet.upper, fleet.readings, FINE)), seed


@pytest.mark.parametrize('liars', [1, 3])
def test_no_truth_is_lost_among_liars(liars):
    options = HeadingOptions(cells=32, max_outliers=liars)
    contradictions = 0
    for seed in range(FLEETS // 2):
        fleet = MovedFleet(seed, liars=liars)
        assert fleet.holds(narrow_headings(fleet.lower, fleet.upper, fleet.readings, options)), (
            seed
        )
        contradictions += not narrow_headings(fleet.lower, fleet.upper, fleet.readings).possible
    assert contradictions == FLEETS // 2


def test_mirror_images_are_ruled_out_by_a_pair():
    ruled_out, fleets = 0, 0
    for seed in range(FLEETS):
        fleet = MovedFleet(seed, error=0.002)
        if fleet.count < 3:
            continue
        fleets += 1
        found = narrow_headings(*fleet.mirrored(), fleet.readings, FINE)
        assert found.possible == (found.ruled_out_by is None)
        if not found.possible:
            ruled_out += 1
            assert found.ruled_out_by in fleet.readings
            assert not found.allowed.any()
    assert ruled_out > 0.8 * fleets


def test_finer_cells_and_more_readings_leave_less():
    for seed in range(10):
        fleet = MovedFleet(seed)
        coarse = narrow_headings(fleet.lower, fleet.upper, fleet.readings, HeadingOptions(32))
        fine = narrow_headings(fleet.lower, fleet.upper, fleet.readings, HeadingOptions(128))
        assert not np.any(fine.allowed & ~np.repeat(coarse.allowed, 4, axis=1))
        options = HeadingOptions(32, most_readings=4)
        sparse = narrow_headings(fleet.lower, fleet.upper, fleet.readings, options)
        assert not np.any(coarse.allowed & ~sparse.allowed)
        few = {pair: rows[:3] for pair, rows in fleet.readings.items()}
        loose = narrow_headings(fleet.lower, fleet.upper, few, HeadingOptions(32))
        assert not np.any(coarse.allowed & ~loose.allowed)
        assert coarse.allowed.sum() < loose.allowed.sum()


def test_headings_cut_places():
    cut = 0
    for seed in range(20):
        fleet = MovedFleet(seed, rays=True, error=0.001)
        lower, upper = fleet._bounds(1.0)
        found = narrow_headings(lower, upper, fleet.readings, FINE)
        assert fleet.holds(found)
        cut += np.sum(found.upper_m - found.lower_m) < 0.9 * np.sum(upper - lower)
    assert cut > 5


def test_what_is_not_tried_among_fine_cells_cuts_no_place(monkeypatch):
    loose, widths_m = [], []
    for seed in range(20):
        fleet = MovedFleet(seed, rays=seed % 2 == 0)
        few = {pair: rows[:2] for pair, rows in fleet.readings.items()}
        loose.append((fleet, few, *fleet._bounds(0.5)))
    found = [narrow_headings(lower, upper, few, FINE) for _, few, lower, upper in loose]
    monkeypatch.setattr(headings, 'ALL_TRIED', FINE.cells)
    for (fleet, few, lower, upper), part in zip(loose, found, strict=True):
        whole = narrow_headings(lower, upper, few, FINE)
        assert fleet.holds(part)
        assert np.all(part.lower_m <= whole.lower_m) and np.all(whole.upper_m <= part.upper_m)
        assert not np.any(whole.allowed & ~part.allowed)
        widths_m.append([np.sum(f.upper_m - f.lower_m) for f in (part, whole)])
    assert np.sum(widths_m, axis=0)[0] < 1.001 * np.sum(widths_m, axis=0)[1]


def test_stopped_at_any_time_it_is_complete():
    fleet = MovedFleet(5)
    for looks in (0, 1, 7, 40, 100):
        left = iter([False] * looks)
        found = narrow_headings(
            fleet.lower,
            fleet.upper,
            fleet.readings,
            stopped=lambda left=left: next(left, True),
        )
        assert not found.finished
        assert fleet.holds(found)


def test_what_is_not_known_stays_open():
    fleet = MovedFleet(3)
    lower, upper = fleet.lower.copy(), fleet.upper.copy()
    lower[0], upper[0] = -math.inf, math.inf
    found = narrow_headings(lower, upper, fleet.readings, FINE)
    assert found.possible and found.allowed[0].all()
    assert found.arc_rad(0)[1] - found.arc_rad(0)[0] >= 2.0 * math.pi
    nothing = narrow_headings(fleet.lower, fleet.upper, {})
    assert nothing.possible and nothing.allowed.all()


@pytest.mark.parametrize(
    'wrong',
    [
        {'cells': 48},
        {'cells': 8},
        {'max_outliers': -1},
        {'max_rounds': 0},
        {'most_readings': 0},
    ],
    ids=str,
)
def test_what_is_no_option_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        HeadingOptions(**wrong)


def test_an_impossible_hypothesis_has_no_arcs():
    fleet = MovedFleet(1, liars=1)
    found = narrow_headings(fleet.lower, fleet.upper, fleet.readings)
    with pytest.raises(ValueError, match='body 0 has no heading'):
        found.arc_rad(0)
