# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The number of newest readings of a pair that agree, if its pose set is empty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dg_localization.poses.readings import PairReadings
from dg_localization.poses.search import PairOptions, cover_poses

FEW_BOXES = 500
"""Most boxes of a search: usually few suffice to show that a set is empty."""


def count_agreeing(
    readings: PairReadings,
    options: PairOptions | None = None,
    *,
    height_m: tuple[float, float] = (0.0, 0.0),
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """
    Count the newest readings that agree with each other, and with the odometries since.

    More readings leave fewer poses: bisection finds the least number that leaves none. If the
    newer ones are right, the oldest of these is wrong, or an odometry broke its bounds since.

    Parameters
    ----------
    readings : PairReadings
        Newest first.
    options : PairOptions, optional
    height_m : tuple of float, optional
        As for `cover_poses`.
    stopped : callable, optional
        Called between bounded steps; readings not proved to disagree count as agreeing.

    Returns
    -------
    int
        The greatest number of newest readings that are not proved to contradict each other. If it
        is below ``len(readings)``, the reading with this index contradicts newer ones.

    """
    options = replace(options or PairOptions(), max_boxes=FEW_BOXES)
    agreeing, contradicting = 0, len(readings) + 1
    while contradicting - agreeing > 1:
        tried = (agreeing + contradicting) // 2
        newest = readings[np.arange(tried)]
        cover = cover_poses(newest, options, height_m=height_m, stopped=stopped)
        if cover.empty:
            contradicting = tried
        else:
            agreeing = tried
    return agreeing
