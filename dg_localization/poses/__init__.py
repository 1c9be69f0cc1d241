# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Poses of bodies from the readings between them.

Set inversion over a window of readings that odometry carries to now, without fleets and ROS.
"""

from dg_localization.poses.blame import find_suspects
from dg_localization.poses.consistency import count_agreeing
from dg_localization.poses.cover import Cover
from dg_localization.poses.joint import JointPoses, narrow_jointly
from dg_localization.poses.readings import NO_RAY_RAD, PairReadings, PastPoses
from dg_localization.poses.search import PairOptions, cover_poses

__all__ = [
    'NO_RAY_RAD',
    'Cover',
    'JointPoses',
    'PairOptions',
    'PairReadings',
    'PastPoses',
    'count_agreeing',
    'cover_poses',
    'find_suspects',
    'narrow_jointly',
]
