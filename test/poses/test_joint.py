# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Joint poses of a few bodies: no truth is lost, and mirror images are ruled out."""

import math
import os

from moved_fleet import MovedFleet
import numpy as np
import pytest

from dg_localization.poses import JointPoses, PairOptions, narrow_jointly

FLEETS = int(os.environ.get('DG_PROPERTY_FLEETS', '60'))


def boxes(most, programs=0, scale_m=1.0, outliers=0):
    return PairOptions(outliers, 0.05 * scale_m, most, programs)


def moved_fleet(seed, **kind):
    """Return a fleet in the plane, its places bounded without slack across it."""
    fleet = MovedFleet(seed, **kind)
    fleet.lower[:, 2] = fleet.upper[:, 2] = 0.0
    return fleet


def start_of(fleet):
    """Return the places of a fleet, and any headings."""
    turn = np.full(fleet.count, math.pi)
    return JointPoses(fleet.lower, fleet.upper, np.stack([-turn, turn], axis=1))


def holds(fleet, poses):
    """Return whether the true poses are left."""
    inside = (poses.lower_m <= fleet.places) & (fleet.places <= poses.upper_m)
    off = fleet.headings - poses.arcs_rad.mean(axis=1)
    off = np.abs(np.remainder(off + math.pi, 2.0 * math.pi) - math.pi)
    near = off <= 0.5 * np.ptp(poses.arcs_rad, axis=1) + 1e-9
    return poses.possible and bool(inside.all() and near.all())


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('programs', [0, 24])
@pytest.mark.parametrize('kind', [{}, {'rays': True}, {'error': 0.0}, {'error': 0.1}], ids=str)
def test_no_truth_is_lost(kind, programs):
    gains = []
    for seed in range(FLEETS):
        fleet = moved_fleet(seed, **kind)
        start = start_of(fleet)
        poses = narrow_jointly(start, fleet.readings, boxes(64, programs))
        assert holds(fleet, poses), seed
        gains.append(np.ptp(poses.arcs_rad, axis=1).sum() / np.ptp(start.arcs_rad, axis=1).sum())
        assert np.all(poses.lower_m >= start.lower_m)
        assert np.all(poses.upper_m <= start.upper_m)
    if kind.get('error') != 0.1:
        assert np.median(gains) < 0.9


@pytest.mark.parametrize('kind', [{'liars': 1}, {'liars': 2, 'rays': True}], ids=str)
def test_no_truth_is_lost_among_liars_of_each_pair(kind):
    for seed in range(FLEETS // 3):
        fleet = moved_fleet(seed, **kind)
        options = boxes(64, outliers=kind['liars'])
        assert holds(fleet, narrow_jointly(start_of(fleet), fleet.readings, options)), seed
