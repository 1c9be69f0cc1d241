# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Triangulation: distances to points that are seen but not ranged, by the law of sines."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.angles import Angles
from dg_localization.fleet.constraints.distances import intersect_pair
from dg_localization.interval.angles import sine_bounds
from dg_localization.interval.bounds import (
    product_down,
    product_up,
    quotient_down,
    quotient_up,
    sqrt_down,
    sqrt_up,
    squared_distance,
)

FloatArray = NDArray[np.float64]


def triangulate(lower: FloatArray, upper: FloatArray, angles: Angles) -> None:
    """
    Bound the distances to points that are seen from both ends of a known distance, in place.

    With the angles A at a and B at b, the third is pi - A - B, and the sides are as the sines:
    d_ac = d_ab sin B / sin(A + B).

    Parameters
    ----------
    lower, upper : numpy.ndarray, shape (n, n)
        Bounds of the squared distances in m^2.
    angles : Angles

    """
    unranged = np.isinf(upper)
    if not unranged.any():
        return
    known = {
        (corner[0], frozenset(corner[1:])): (low, high)
        for corner, low, high in zip(
            angles.corners.tolist(), angles.low_rad.tolist(), angles.high_rad.tolist(), strict=True
        )
        if corner[1] != corner[2]
    }
    for (a, ends), at_a in known.items():
        for b in ends:
            (c,) = ends - {b}
            if not unranged[a, c] or unranged[a, b] or lower[a, b] > upper[a, b]:
                continue
            at_b = known.get((b, frozenset((a, c))))
            if at_b is None:
                continue
            base_m = (sqrt_down(lower[a, b]), sqrt_up(upper[a, b]))
            intersect_pair(lower, upper, a, c, *_third_side_m2(base_m, at_a, at_b))


def _third_side_m2(
    base_m: tuple[float, float], at_a: tuple[float, float], at_b: tuple[float, float]
) -> tuple[float, float]:
    """Return bounds of the square of d_ac from d_ab and the angles at a and b."""
    low_sum, high_sum = at_a[0] + at_b[0], min(math.pi, at_a[1] + at_b[1])
    sine_b_low, sine_b_high = sine_bounds(*at_b)
    sine_c_low, sine_c_high = sine_bounds(min(low_sum, math.pi), high_sum)
    d_lower_m = quotient_down(product_down(base_m[0], max(0.0, sine_b_low)), sine_c_high)
    d_upper_m = quotient_up(product_up(base_m[1], sine_b_high), max(0.0, sine_c_low))
    return squared_distance(d_lower_m, d_upper_m)
