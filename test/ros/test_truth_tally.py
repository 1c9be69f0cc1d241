# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Answers that are counted beside a truth: of the fleet and of groups apart from it."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from dg_localization.calibration.answers import FleetTruth  # noqa: E402
from dg_localization.calibration.truth import TrueTrack  # noqa: E402
from dg_localization.fleet import (  # noqa: E402
    Estimate,
    FixedFrame,
    FleetConfig,
    FrameKind,
    Group,
    Placement,
)
from dg_localization.ros.bags.truth_tally import TruthTally  # noqa: E402

ROBOTS = ('r1', 'r2', 'r3', 'r4')
PLACES = {'r1': (0.0, 0.0), 'r2': (4.0, 0.0), 'r3': (10.0, 0.0), 'r4': (10.0, 3.0)}
ANCHORS = FixedFrame(FrameKind.ANCHORS, ('anchor',))
OWN = FixedFrame(FrameKind.ROBOTS, ('r3', 'r4'))


def placement(places):
    """Return a placement that knows some robots to 0.1 m."""
    positions_m = np.array([places.get(robot, (np.nan, np.nan)) for robot in ROBOTS])
    known = np.isfinite(positions_m)
    low = np.where(known, positions_m - 0.1, -np.inf)
    high = np.where(known, positions_m + 0.1, np.inf)
    return Placement(
        positions_m=positions_m,
        enclosure_m=np.stack([low, high], axis=1),
        orientations_xyzw=np.full((4, 4), np.nan),
        heading_known=np.zeros(4, dtype=bool),
        heading_half_width_rad=np.full(4, np.pi),
        proved=True,
        flexible=False,
        mirrored=False,
        landmarks_m=np.empty((0, 2)),
        landmark_enclosure_m=np.empty((0, 2, 2)),
        lower_m=np.zeros((4, 4)),
        upper_m=np.where(np.eye(4, dtype=bool), 0.0, np.inf),
    )


def tallied(of_fleet, of_group, fleet_hypotheses=1, group_hypotheses=1):
    """Return the tally of one answer with a group apart."""
    tracks = {name: TrueTrack.at_rest((*place, 0.0)) for name, place in PLACES.items()}
    tally = TruthTally(FleetTruth(FleetConfig(robots=ROBOTS), tracks))
    group = Group(('r3', 'r4'), OWN, (placement(of_group),), group_hypotheses)
    estimate = Estimate(
        0.5,
        ROBOTS,
        None,
        '',
        (placement(of_fleet),),
        fleet_hypotheses,
        frame=ANCHORS,
        groups=(group,),
    )
    tally.add(estimate, SimpleNamespace(stamp_s=0.5), 0.5)
    return tally


RIGHT, WRONG = {'r1': (0.0, 0.0), 'r2': (4.0, 0.0)}, {'r1': (0.0, 0.0), 'r2': (7.0, 7.0)}
GROUP_RIGHT = {'r3': (0.0, 0.0), 'r4': (3.0, 0.0)}
GROUP_WRONG = {'r3': (0.0, 0.0), 'r4': (2.0, 2.0)}


def test_a_miss_is_told_though_another_answer_is_not_listed_whole():
    tally = tallied(WRONG, GROUP_RIGHT, group_hypotheses=5)
    assert (tally.compared, tally.held, tally.unlisted) == (1, 0, 0)
    assert [miss.robots for miss in tally.misses] == [('r2',)]
    tally = tallied(RIGHT, GROUP_WRONG, group_hypotheses=5)
    assert (tally.held, tally.unlisted, tally.misses) == (0, 1, [])
    tally = tallied(RIGHT, GROUP_RIGHT, group_hypotheses=5)
    assert (tally.held, tally.unlisted, tally.misses) == (1, 0, [])
