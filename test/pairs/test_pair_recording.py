# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""One robot and the landmarks as two bodies, on a recording with wrong readings and true poses."""

import numpy as np

from benchmarks.pairs import Recording, odometry_error
from dg_localization.pairs import PairOptions, cover_poses


def test_the_truth_is_inside_every_window(shared):
    folder = shared / 'data/mrclam/excerpt_D7_t200_440'
    widths_m, off_m = [], []
    for robot in range(1, 6):
        recording = Recording.load(folder, robot)
        start_s = recording.truth[0, 0]
        for now_s in np.arange(start_s + 95.0, start_s + 235.0, 35.0):
            readings = recording.readings(float(now_s), odometry_error(0.2))
            assert len(readings) > 100
            cover = cover_poses(readings, PairOptions(max_outliers=5))
            position_m, yaw_rad = recording.pose(float(now_s))
            assert cover.contains(position_m, yaw_rad), (robot, now_s)
            widths_m.append(cover.hull.widths_m.max())
            middle = 0.5 * (cover.hull.lower_m + cover.hull.upper_m)
            off_m.append(np.linalg.norm(middle - position_m))
    assert np.median(widths_m) < 4.5
    assert np.median(off_m) < 0.7
