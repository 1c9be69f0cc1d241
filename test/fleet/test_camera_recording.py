# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Five real robots with cameras among fifteen landmarks: the surveyed truth is never lost."""

import math

import numpy as np
import pytest
from shapes import holds

from benchmarks.robots import Recording
from dg_localization import SolverOptions
from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    Localizer,
    OdometryErrorModel,
    RangeErrorModel,
)
from dg_localization.fleet.rotations import quaternion_of_yaw, rotations_about_z

NUMBERS = range(1, 6)
# Measurement stamps of this recording are late by about this much.
LATE_S = 0.05


class Recordings:
    """One excerpt: events in time, and where the robots truly were."""

    def __init__(self, folder):
        self.robots = {k: Recording.load(folder, k) for k in NUMBERS}
        self.landmarks = {f'm{k}': place for k, place in self.robots[1].landmarks.items()}
        self.events = []
        for k, robot in self.robots.items():
            for stamp_s, subject, range_m, bearing_rad in robot.all_sightings:
                if subject != k:
                    target = f'{"r" if subject in NUMBERS else "m"}{int(subject)}'
                    self.events.append((stamp_s - LATE_S, k, target, range_m, bearing_rad))
            for stamp_s, place, yaw in zip(*robot.track, strict=True):
                self.events.append((stamp_s, k, None, place, yaw))
        self.events.sort(key=lambda event: event[0])

    def poses_at(self, stamp_s):
        """Return places and yaws of all robots."""
        return zip(*(robot.pose(stamp_s) for robot in self.robots.values()), strict=True)


def played(localizer, recording, ticks):
    """Yield times and estimates of what was heard until then."""
    events = iter(recording.events)
    for now_s in ticks:
        for stamp_s, number, target, first, angle in events:
            robot, times_s = f'r{number}', (stamp_s, stamp_s)
            if target is None:
                localizer.add_odometry(robot, first, quaternion_of_yaw(angle), *times_s)
            else:
                localizer.add_range(robot, target, first, *times_s)
                ray = [math.cos(angle), math.sin(angle), 0.0]
                localizer.add_bearing(robot, target, ray, *times_s)
            if stamp_s > now_s:
                break
        yield now_s, localizer.step(now_s)


def holds_truth(estimate, recording, now_s):
    places, yaws = map(np.array, recording.poses_at(now_s))
    return holds(estimate, places[:, :2], rotations_about_z(yaws))


def config_of(recording, **settings):
    return FleetConfig(
        robots=[f'r{k}' for k in NUMBERS],
        anchors={name: Anchor(xy, 0.01) for name, xy in recording.landmarks.items()},
        max_age_s=2.0,
        odometry_error=OdometryErrorModel(
            translation_per_m=0.1, rotation_per_rad=0.2, constant_m=0.04, constant_rad=0.12
        ),
        range_error=RangeErrorModel(min_error_relative=-0.15, max_error_relative=0.15),
        bearing_half_width_rad=0.12,
        max_outliers=1,
        solver=SolverOptions(resolution=0.1, max_boxes=200),
        **settings,
    )


@pytest.mark.parametrize('excerpt', ['excerpt_D7_t515_545', 'excerpt_D7_t800_822'])
@pytest.mark.filterwarnings('ignore:loadtxt')
def test_the_surveyed_truth_is_in_a_placement_at_every_tick(shared, excerpt):
    recording = Recordings(shared / f'data/mrclam/{excerpt}')
    config = config_of(recording, max_speed_m_s=0.2, max_turn_rate_rad_s=0.6)
    localizer = Localizer(config)
    ticks = np.arange(recording.events[0][0] + 2.0, recording.events[-1][0], 1.5)
    for now_s, estimate in played(localizer, recording, ticks):
        assert estimate.frame.kind == 'anchors'
        assert holds_truth(estimate, recording, now_s), now_s


@pytest.mark.parametrize(('window_outliers', 'width_m'), [(0, 4.5), (5, 6.0)])
@pytest.mark.filterwarnings('ignore:loadtxt')
def test_four_minutes_of_memory_bound_every_robot(shared, window_outliers, width_m):
    recording = Recordings(shared / 'data/mrclam/excerpt_D7_t200_440')
    config = config_of(
        recording,
        max_speed_m_s=0.3,
        memory_s=60.0,
        memory_max_seconds=math.inf,
        window_outliers=window_outliers,
    )
    localizer = Localizer(config)
    start_s = recording.events[0][0]
    ticks = start_s + np.array([40.0, 70.0, 100.0, 130.0])
    widths = []
    for now_s, estimate in played(localizer, recording, ticks):
        # Some readings are gross errors.
        inside = holds_truth(estimate, recording, now_s)
        assert inside or not window_outliers, now_s
        widths.append(np.ptp(estimate.placements[0].enclosure_m, axis=1).max(axis=1))
        assert estimate.placements[0].heading_known.sum() >= 4
    assert np.isfinite(widths).all()
    assert np.median(widths) < width_m
