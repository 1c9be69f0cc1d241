# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Answers that are counted beside a truth: of the fleet and of groups apart from it."""

from dataclasses import replace
from types import SimpleNamespace

from estimates import placement_at
import numpy as np

from dg_localization.calibration.truth import FleetTruth, TrueTrack
from dg_localization.fleet import Estimate, FixedFrame, FleetConfig, FrameKind, Group
from dg_localization.ros.bags.truth_tally import TruthTally

ROBOTS = ('r1', 'r2', 'r3', 'r4')
PLACES = {'r1': (0.0, 0.0), 'r2': (4.0, 0.0), 'r3': (10.0, 0.0), 'r4': (10.0, 3.0)}
ANCHORS = FixedFrame(FrameKind.ANCHORS, ('anchor',))
OWN = FixedFrame(FrameKind.ROBOTS, ('r3', 'r4'))


def placement(places):
    return placement_at([places.get(robot, (np.nan, np.nan)) for robot in ROBOTS])


def tallied(of_fleet, of_group):
    """Return the tally of one answer with a group apart, of five hypotheses."""
    tracks = {name: TrueTrack.at_rest((*place, 0.0)) for name, place in PLACES.items()}
    tally = TruthTally(FleetTruth(FleetConfig(robots=ROBOTS), tracks))
    group = Group(('r3', 'r4'), OWN, (placement(of_group),), 5)
    made = Estimate(0.5, ROBOTS, None, '', (placement(of_fleet),), 1, frame=ANCHORS)
    tally.add(replace(made, groups=(group,)), SimpleNamespace(stamp_s=0.5), 0.5)
    return tally


RIGHT, WRONG = {'r1': (0.0, 0.0), 'r2': (4.0, 0.0)}, {'r1': (0.0, 0.0), 'r2': (7.0, 7.0)}
GROUP_RIGHT = {'r3': (0.0, 0.0), 'r4': (3.0, 0.0)}
GROUP_WRONG = {'r3': (0.0, 0.0), 'r4': (2.0, 2.0)}


def test_a_miss_is_told_though_another_answer_is_not_listed_whole():
    tally = tallied(WRONG, GROUP_RIGHT)
    assert [*tally.counts.values()] == [1, 0, 0, 0, 0]
    assert [miss['robots'] for miss in tally.misses] == [('r2',)]
    tally = tallied(RIGHT, GROUP_WRONG)
    assert [*tally.counts.values()] == [1, 0, 0, 1, 0] and not tally.misses
    tally = tallied(RIGHT, GROUP_RIGHT)
    assert [*tally.counts.values()] == [1, 1, 0, 0, 0] and not tally.misses
