# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rotations about the vertical axis by intervals of angles."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.angles import angle_down, angle_up, cosine_and_sine
from dg_localization.interval.arrays import Interval

TURN = 2.0 * math.pi
"""A full turn, rounded."""

HALF_TURN_UP = angle_up(math.pi)
"""An upper bound of pi: all yaws lie between this and its negative."""

_PERIOD = Interval.between(angle_down(TURN), angle_up(TURN))


def principal(angle: Interval) -> Interval:
    """
    Return the same angles with middles within about a half turn of zero.

    Parameters
    ----------
    angle : Interval, shape (m,)
        In rad.

    Returns
    -------
    Interval, shape (m,)
        All angles if an interval is a full turn wide or unbounded.

    """
    known = angle.upper - angle.lower < TURN
    middle = np.where(known, 0.5 * angle.lower + 0.5 * angle.upper, 0.0)
    shifted = angle - Interval.point(np.round(middle / TURN)) * _PERIOD
    return Interval(
        np.where(known, shifted.lower, -HALF_TURN_UP), np.where(known, shifted.upper, HALF_TURN_UP)
    )


def turned(angle: Interval, points: Interval) -> Interval:
    """
    Return points rotated about the vertical axis.

    Parameters
    ----------
    angle : Interval, shape (m,) or (1,)
        In rad.
    points : Interval, shape (m, 3) or (1, 3)

    Returns
    -------
    Interval, shape (m, 3)

    """
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    ways = cosine_and_sine(principal(angle))
    of_x, of_y = ways * x, ways * y
    first, second = of_x[0] - of_y[1], of_x[1] + of_y[0]
    shape = first.lower.shape
    third = Interval(np.broadcast_to(z.lower, shape), np.broadcast_to(z.upper, shape))
    return Interval.stack([first, second, third])
