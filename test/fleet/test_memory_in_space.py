# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Robots that fly among anchors: what they measured before, and their odometry, still counts."""

from dataclasses import replace

from flights import ERROR, Flight
import numpy as np
import pytest

from dg_localization import Verdict


@pytest.mark.parametrize('rays', [False, True])
@pytest.mark.parametrize('steepest_rad', [0.3, 1.2])
@pytest.mark.parametrize('seed', range(3))
def test_no_pose_is_lost(seed, steepest_rad, rays):
    flight = Flight(seed, steepest_rad=steepest_rad, rays=rays)
    for estimate in flight.fly(12.0):
        assert estimate.verdict is not Verdict.INFEASIBLE
        assert not estimate.forgotten
        assert not flight.lost(estimate), flight.time_s


def test_positions_are_sharper_and_headings_known():
    flight, forgetful = Flight(7), Flight(7, memory_s=0.0)
    *_, estimate = flight.fly(12.0)
    *_, moment = forgetful.fly(12.0)
    widths = [
        np.max([np.ptp(p.enclosure_m, axis=1) for p in e.placements], axis=0)
        for e in (estimate, moment)
    ]
    assert np.all(widths[0][:, :2] < 1.5) and np.all(widths[0] < 0.6 * widths[1])
    (placement,) = estimate.placements
    assert placement.heading_known.all() and np.all(placement.heading_half_width_rad < 1.0)
    assert not any(p.heading_known.any() for p in moment.placements)


def test_of_a_robot_whose_odometry_may_be_tilted_nothing_is_remembered():
    """Its roll and pitch are not bounded, and the others remember all the same."""
    error = replace(ERROR, tilt_rad=None)
    flight = Flight(7, robot_odometry_error={'r1': error})
    forgetful = Flight(7, memory_s=0.0)
    for estimate in flight.fly(12.0):
        assert not flight.lost(estimate), flight.time_s
    *_, moment = forgetful.fly(12.0)
    widths = [
        np.max([np.ptp(p.enclosure_m, axis=1).max(axis=1) for p in e.placements], axis=0)
        for e in (estimate, moment)
    ]
    assert widths[0][0] < 0.6 * widths[1][0]
    placement = estimate.placements[0]
    assert placement.heading_known.tolist() == [True, False]


def test_a_robot_that_measures_nothing_for_a_moment_stays_placed():
    flight = Flight(3)
    *_, before = flight.fly(10.0)
    assert np.isfinite(before.placements[0].enclosure_m).all()
    for estimate in flight.fly(3.0, measures=lambda robot: robot == 'r0'):
        assert np.isfinite(estimate.placements[0].enclosure_m).all()
        assert not flight.lost(estimate)


def test_wrong_readings_lose_nothing_where_they_are_tolerated():
    flight = Flight(5, window_outliers=3)
    for number, estimate in enumerate(flight.fly(12.0)):
        if number in (3, 6, 9):
            stamps = flight.time_s, flight.time_s
            flight.localizer.add_range('r1', 'a0', 1.0, *stamps)
        assert not flight.lost(estimate), flight.time_s


def test_a_body_that_stands_on_end_has_no_heading():
    """Near a pitch of 90 degrees roll and yaw are not told apart, and nothing is claimed."""
    flight = Flight(2, robots=1, steepest_rad=1.57)
    assert all(not flight.lost(estimate) for estimate in flight.fly(15.0))
