# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Covariances beside the truth, where all errors are in their bounds."""

import pytest

from benchmarks.covariances import CASES, Row

NAMES = 'moment memory memory-all-bias memory-exact ranges-drift latency silence straight'.split()


@pytest.mark.parametrize('name', NAMES)
def test_best_points_are_as_far_off_as_their_covariances_say(name):
    row = Row.of(CASES[name], seeds=20, count=8)
    assert (row.beyond <= 0.02).all()
    # A normal distribution has 0.79; bounds leave open how errors are distributed within them.
    assert 0.3 <= row.median_nees <= 1.4
