# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A curve of placements next to isolated ones (the paper's Figure 7)."""

from flex import (
    SQUARED_M2,
    cover,
    cover_distance_m,
    flex_curve_m,
    flex_placements,
    isolated_placements,
    linkage,
    unknown_bounds_m,
    unknown_distances_m,
)
import numpy as np
import pytest
from solver_cases import covers, squared_distances

from dg_localization import SolverOptions, Verdict, solve
from dg_localization.solver.place.rigidity import is_flexible

RESOLUTION_M = 0.2


@pytest.fixture(scope='module')
def result():
    return solve(linkage(), SolverOptions(resolution=RESOLUTION_M))


def relaxed(positions):
    """Return the placement that Gauss-Newton steps find, or None where they find none."""
    pairs = np.array(list(SQUARED_M2))
    wanted = np.array(list(SQUARED_M2.values()))
    for _ in range(50):
        arms = positions[pairs[:, 0]] - positions[pairs[:, 1]]
        rows = np.zeros((len(pairs), *positions.shape))
        rows[np.arange(len(pairs)), pairs[:, 0]] = 2.0 * arms
        rows[np.arange(len(pairs)), pairs[:, 1]] = -2.0 * arms
        missing = wanted - (arms * arms).sum(axis=1)
        if np.abs(missing).max() < 1e-9:
            return positions
        step = np.linalg.lstsq(rows.reshape(len(pairs), -1), missing, rcond=1e-9)[0]
        positions = positions + step.reshape(positions.shape)
    return None


def test_the_linkage_has_these_placements_and_no_others():
    random = np.random.default_rng(0)
    found = [relaxed(random.uniform(-8.0, 8.0, (5, 2))) for _ in range(300)]
    found = unknown_distances_m(
        np.array([positions for positions in found if positions is not None])
    )
    isolated = unknown_distances_m(isolated_placements())
    far = np.linalg.norm(found[:, None] - isolated, axis=2) > 1e-3
    flex = np.array([np.linalg.norm(flex_curve_m() - place, axis=1).min() for place in found])
    assert (~far).any(axis=0).all() and (flex < 2e-3).any()
    assert (far.all(axis=1) == (flex < 2e-3)).all()


def test_two_isolated_hypotheses_and_a_flex(result):
    assert result.verdict is Verdict.COVERED
    assert sorted(hypothesis.flexible for hypothesis in result.hypotheses) == [False, False, True]
    assert sorted(len(hypothesis.boxes) for hypothesis in result.hypotheses)[:2] == [1, 1]
    assert all(hypothesis.proved for hypothesis in result.hypotheses)


def test_flexible_is_what_the_rigidity_of_the_placements_says():
    measured = np.isfinite(linkage().upper)
    assert not any(is_flexible(placement, measured) for placement in isolated_placements())
    around = flex_placements(np.linspace(0.0, 2.0 * np.pi, 50))
    assert all(is_flexible(placement, measured) for placement in around)


def test_no_placement_of_the_curve_is_lost(result):
    around = flex_placements(np.linspace(0.0, 2.0 * np.pi, 2000))
    for placement in (*around, *isolated_placements()):
        squared = squared_distances(placement)
        # The coordinates are rounded; the known distances are not the question here.
        for (i, j), squared_m2 in SQUARED_M2.items():
            assert squared[i, j] == pytest.approx(squared_m2, rel=1e-14)
            squared[i, j] = squared[j, i] = squared_m2
        assert covers(result, squared)


def test_the_cover_shrinks_with_the_resolution():
    curve_m = flex_curve_m()
    resolutions_m = np.array([1.6, 0.8, 0.4, 0.2])
    distances_m = []
    for resolution_m in resolutions_m:
        _, flex = cover(resolution_m)
        distances_m.append(cover_distance_m(unknown_bounds_m(flex), curve_m))
    assert (distances_m <= 0.8 * resolutions_m).all()
    assert np.polyfit(np.log(resolutions_m), np.log(distances_m), 1)[0] > 0.9
