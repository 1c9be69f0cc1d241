# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Relative poses of two bodies from everything they measured of each other.

Set inversion over a window of readings that odometry carries to now. Knows no fleet and no ROS.
"""

from dg_localization.pairs.blame import find_suspects
from dg_localization.pairs.consistency import count_agreeing
from dg_localization.pairs.counted import CountedCover
from dg_localization.pairs.cover import Cover, Hull
from dg_localization.pairs.headings import (
    HeadingOptions,
    Headings,
    heading_cells,
    narrow_headings,
)
from dg_localization.pairs.joint import JointPoses, narrow_jointly
from dg_localization.pairs.mutual import MutualCover, Ranges, Ways
from dg_localization.pairs.readings import NO_RAY_RAD, PairReadings, PastPoses
from dg_localization.pairs.search import PairOptions, cover_poses

__all__ = [
    'NO_RAY_RAD',
    'CountedCover',
    'Cover',
    'HeadingOptions',
    'Headings',
    'Hull',
    'JointPoses',
    'MutualCover',
    'PairOptions',
    'PairReadings',
    'PastPoses',
    'Ranges',
    'Ways',
    'count_agreeing',
    'cover_poses',
    'find_suspects',
    'heading_cells',
    'narrow_headings',
    'narrow_jointly',
]
