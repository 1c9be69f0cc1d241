# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What is remembered rules out placements, however few of them are listed."""

from circling import Circling
import numpy as np
import pytest

from dg_localization import SolverOptions


@pytest.mark.parametrize('least_listed', [None, 1])
def test_one_listed_placement_is_the_one_that_is_left(least_listed):
    """Also where only that one is looked at: a window that rules it out contradicts nothing."""
    solver = SolverOptions(max_boxes=200, max_hypotheses=least_listed or 64)
    rng = np.random.default_rng(9)
    fleet = Circling(4, noise=0.01, max_hypotheses=1, max_age_s=1.0, solver=solver)
    fleet.centers_m, fleet.rates = rng.uniform(-3.0, 3.0, (4, 2)), rng.uniform(0.2, 0.6, 4)
    estimates = list(fleet.drive(12.0))
    assert not any(estimate.forgotten for estimate in estimates)
    assert all(len(estimate.placements) == 1 for estimate in estimates)
    if not least_listed:
        assert [estimates[k].n_hypotheses for k in (0, -1)] == [2, 1]
