# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""One robot and the landmarks as two bodies, on a recording with wrong readings and true poses."""

import numpy as np

from benchmarks.robots import (
    BEARING_ERROR_RAD,
    RANGE_ERROR,
    SPEED_M_S,
    TURN_RATE_RAD_S,
    Recording,
    odometry_error,
    rotation,
)
from dg_localization.fleet.odometry import MotionLimits, OdometryPath
from dg_localization.interval.arrays import Interval
from dg_localization.poses import PairOptions, PairReadings, cover_poses

WINDOW_S = 90.0


def readings_of(recording, now_s):
    times = recording.sightings[:, 0]
    seen = recording.sightings[(times > now_s - WINDOW_S) & (times <= now_s)]
    stamps, positions, yaws = recording.track
    used = slice(
        max(0, np.searchsorted(stamps, now_s - WINDOW_S) - 1),
        np.searchsorted(stamps, now_s, side='right') + 1,
    )
    rotations = [rotation(yaw) for yaw in yaws[used]]
    limits = MotionLimits(speed_m_s=SPEED_M_S, turn_rate_rad_s=TURN_RATE_RAD_S)
    path = OdometryPath(stamps[used], positions[used], rotations, odometry_error(0.2), limits)
    poses = path.past_poses(seen[:, 0], now_s)
    bearings, ranges = seen[:, 3], seen[:, 2]
    directions = np.stack([np.cos(bearings), np.sin(bearings), 0.0 * bearings], axis=-1)
    places = np.array([[*recording.landmarks[int(subject)], 0.0] for subject in seen[:, 1]])
    return PairReadings.of(
        Interval.point(places.reshape(-1, 3)),
        poses.points_now(Interval.point(np.zeros((len(seen), 3)))),
        Interval(ranges * (1.0 - RANGE_ERROR), ranges * (1.0 + RANGE_ERROR)),
        *poses.rays_now(directions, np.full(len(seen), BEARING_ERROR_RAD)),
        True,
    )


def test_the_truth_is_inside_every_window(shared):
    folder = shared / 'data/mrclam/excerpt_D7_t200_440'
    widths_m, off_m = [], []
    for robot in range(1, 6):
        recording = Recording.load(folder, robot)
        start_s = recording.truth[0, 0]
        for now_s in np.arange(start_s + 95.0, start_s + 235.0, 35.0):
            readings = readings_of(recording, float(now_s))
            assert len(readings) > 100
            cover = cover_poses(readings, PairOptions(max_outliers=5))
            position_m, yaw_rad = recording.pose(float(now_s))
            assert cover.contains(position_m, yaw_rad), (robot, now_s)
            place_m = cover.position_m
            widths_m.append((place_m.upper - place_m.lower).max())
            middle = 0.5 * (place_m.lower + place_m.upper)
            off_m.append(np.linalg.norm(middle - position_m))
    assert np.median(widths_m) < 4.5
    assert np.median(off_m) < 0.7
