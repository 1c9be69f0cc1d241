# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Chiralities that one observer sees: the sign of q + 1 points from q rays (Section 3).

A sign counts only when it is the same over the whole error of the rays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math

import numpy as np

from dg_localization.fleet.constraints.rays import RayBundle, RayPairs
from dg_localization.fleet.directions import angles_rad
from dg_localization.fleet.vocabulary import RayReading
from dg_localization.interval.angles import angle_up
from dg_localization.solver.problem import Chirality


def planar_chiralities(pairs: RayPairs) -> Iterator[Chirality]:
    """Yield the chirality of an observer with two targets where the sign is certain."""
    sizes = np.abs(pairs.angles_rad)
    certain = (pairs.half_widths_rad < sizes) & (sizes + pairs.half_widths_rad < math.pi)
    for row in np.flatnonzero(certain):
        sign = 1 if pairs.angles_rad[row] > 0.0 else -1
        yield Chirality(tuple(pairs.corners[row].tolist()), sign)


def spatial_chiralities(bundle: RayBundle) -> Iterator[Chirality]:
    """Yield the chirality of an observer with three targets where the sign is certain."""
    for rays in bundle.triples():
        sign = _spatial_sign(rays)
        if sign != 0:
            yield Chirality(bundle.corner(rays), sign)


def _spatial_sign(rays: Sequence[RayReading]) -> int:
    """
    Return the sign of the determinant of three rays, or 0 when in doubt.

    With unit vectors u', v', w' within the half widths of u, v, w, the determinant changes by
    det(u'-u, v, w) + det(u', v'-v, w) + det(u', v', w'-w). A difference is at most
    2 sin(half width / 2) long, and the vector product it meets at most the sine of an angle.
    """
    u, v, w = (ray.direction for ray in rays)
    e_u, e_v, e_w = (ray.half_width_rad for ray in rays)
    if max(e_u, e_v, e_w) >= math.pi / 2:
        return 0
    vw, uw, uv = angles_rad(np.array([v, u, u]), np.array([w, w, v])).tolist()
    change = (
        2.0 * math.sin(e_u / 2.0) * _greatest_sine(vw, 0.0)
        + 2.0 * math.sin(e_v / 2.0) * _greatest_sine(uw, e_u)
        + 2.0 * math.sin(e_w / 2.0) * _greatest_sine(uv, e_u + e_v)
    )
    volume = float(np.linalg.det(np.stack([u, v, w])))
    # The determinant of unit vectors is as exact as an angle.
    if abs(volume) <= angle_up(change):
        return 0
    return 1 if volume > 0.0 else -1


def _greatest_sine(angle_rad: float, half_width_rad: float) -> float:
    """Return the greatest sine of an angle in [0, pi] within the half width."""
    if abs(angle_rad - math.pi / 2) <= half_width_rad:
        return 1.0
    return max(math.sin(angle_rad - half_width_rad), math.sin(angle_rad + half_width_rad))
