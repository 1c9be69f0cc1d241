# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Since when the readings of a pair agree: what is known when its set of poses runs empty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dg_localization.poses.readings import PairReadings
from dg_localization.poses.search import PairOptions, cover_poses

FEW_BOXES = 500
"""Mostly a set shows that it is empty before there are many boxes."""


def count_agreeing(
    readings: PairReadings,
    options: PairOptions | None = None,
    *,
    height_m: tuple[float, float] = (0.0, 0.0),
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """
    Count the newest readings that agree with each other, and with the odometries since.

    More readings leave fewer poses: the first number of them that leaves none is found by halving.
    Where readings are sound, an odometry broke its bounds after the oldest reading that makes
    the set empty, or that reading is wrong.

    Parameters
    ----------
    readings : PairReadings
        Newest first.
    options : PairOptions, optional
    height_m : tuple of float, optional
        As for `cover_poses`.
    stopped : callable, optional
        Asked between bounded steps; what is not proved to disagree counts as agreeing.

    Returns
    -------
    int
        The most of the newest readings that are not proved to contradict each other. Below
        ``len(readings)``, the reading with this index is the first that contradicts newer ones.

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
