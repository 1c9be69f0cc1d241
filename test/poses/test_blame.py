# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which readings of a pair are to blame where not all of them agree."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.poses import PairOptions, PairReadings, cover_poses, find_suspects

PLACE_M = np.array([1.0, 2.0, 0.0])


def landmarks_seen(rng, count, off):
    """Return ranges from B, which stands still, to points around A; `off` is added to each."""
    points = np.concatenate([rng.uniform(-6.0, 6.0, (count, 2)), np.zeros((count, 1))], axis=1)
    apart = np.linalg.norm(points - PLACE_M, axis=1) * rng.uniform(0.985, 1.015, count)
    apart = np.maximum(apart + off, 0.0)
    return PairReadings.of(
        Interval.point(points),
        Interval.point(np.zeros((count, 3))),
        Interval(apart * 0.98, apart * 1.02),
    )


def test_readings_that_agree_make_nobody_suspect():
    readings = landmarks_seen(np.random.default_rng(0), 12, 0.0)
    cover = cover_poses(readings, PairOptions(max_outliers=2, resolution_m=0.1))
    assert len(find_suspects(readings, cover)) == 0


@pytest.mark.parametrize('wrong', [[3], [0, 7], [1, 2, 11]])
def test_the_wrong_readings_are_the_suspects(wrong):
    off = np.zeros(20)
    off[wrong] = [3.0, -2.5, 4.0][: len(wrong)]
    readings = landmarks_seen(np.random.default_rng(1), 20, off)
    cover = cover_poses(readings, PairOptions(max_outliers=len(wrong), resolution_m=0.1))
    assert find_suspects(readings, cover).tolist() == wrong


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), wrong=st.integers(0, 3), size=st.floats(0.0, 4.0))
def test_suspects_contradict_the_others(seed, wrong, size):
    rng = np.random.default_rng(seed)
    off = np.zeros(10)
    off[:wrong] = size * rng.choice([-1.0, 1.0], wrong)
    readings = landmarks_seen(rng, 10, off)
    cover = cover_poses(readings, PairOptions(max_outliers=3, resolution_m=0.2))
    suspects = find_suspects(readings, cover)
    if size == 0.0 or wrong == 0:
        assert len(suspects) == 0
    if len(suspects):
        assert cover_poses(readings, PairOptions(resolution_m=0.2)).empty
