# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Robots that start in formation and go alike: shapes that a rounding error turns over."""

from dataclasses import replace

import numpy as np

from dg_localization.fleet import Anchor

FORMATIONS = ('none', 'none', 'in line', 'abreast', 'together')
SPACING_M = 1.5
ANCHORED_M = (-4.0, 3.0, 8.0, 12.0, 20.0)
"""Where anchors are on the line of the robots."""


def draw_formation(history, seed):
    """
    Return a history whose robots start in the formation that a seed draws, if any.

    In line or abreast they look the same way. Half of these go straight ahead, all alike, so that
    their shape stays; together, at one place, each goes its own way. The anchors of half of these
    fleets are on the line of the robots.
    """
    rng = np.random.default_rng([seed, 13])
    formation = str(rng.choice(FORMATIONS))
    if formation == 'none':
        return history
    dimension, are_together = history.config.dimension, formation == 'together'
    if not are_together and rng.random() < 0.5:
        for robot in range(len(history.drives)):
            history.go_straight(robot, np.random.default_rng([seed, 13, 1]))
    for robot, drive in enumerate(history.drives):
        start_m = np.zeros(dimension)
        if not are_together:
            start_m[int(formation == 'abreast')] = SPACING_M * robot
        drive.start(start_m, None if are_together else 0.0)
    if rng.random() < 0.5:
        anchors = {
            name: Anchor((x_m, *np.zeros(dimension - 1)))
            for name, x_m in zip(history.config.anchors, ANCHORED_M, strict=False)
        }
        history.config = replace(history.config, anchors=anchors)
    return history
