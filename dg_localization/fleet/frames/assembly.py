# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Assembly: from the points of a plan to a placement with one row for each point of the fleet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.estimate import Placement
from dg_localization.fleet.frames.headings import Heading
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.interval.arrays import Interval

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class PlacedPoints:
    """
    Some points of the fleet in the fixed frame.

    Parameters
    ----------
    points : tuple of int
        Their indices into the points of the fleet.
    positions_m : numpy.ndarray, shape (k, q)
    enclosure : Interval, shape (k, q)
        In m.
    headings : mapping of int to Heading
        By index into the points of the fleet, as far as they are known.
    covariances : numpy.ndarray, shape (k, 6, 6)
        Of positions and rotations.
    fitted_yaws_rad : numpy.ndarray, shape (k,)
        Of the best point; NaN where none was fitted.
    distances : Interval, shape (k, k)
        In m.

    """

    points: tuple[int, ...]
    positions_m: FloatArray
    enclosure: Interval
    headings: Mapping[int, Heading]
    covariances: FloatArray
    fitted_yaws_rad: FloatArray
    distances: Interval


def assemble(
    config: FleetConfig,
    placed: PlacedPoints,
    *,
    proved: bool,
    flexible: bool,
    mirrored: bool,
    dropped: frozenset[LinkKey],
) -> Placement:
    """Return a placement of the whole fleet, unknown where the points are not among those."""
    n_points, n_robots = len(config.points), len(config.robots)
    # The rows after those are sensors.
    landmarks = slice(n_robots, n_robots + len(config.landmarks))
    points = list(placed.points)
    positions = np.full((n_points, config.dimension), np.nan)
    positions[points] = placed.positions_m
    boxes = np.empty((n_points, 2, config.dimension))
    boxes[:, 0], boxes[:, 1] = -np.inf, np.inf
    boxes[points, 0], boxes[points, 1] = placed.enclosure.lower, placed.enclosure.upper
    covariances = np.full((n_points, 6, 6), np.nan)
    covariances[points] = placed.covariances
    fitted_yaws = np.full(n_points, np.nan)
    fitted_yaws[points] = placed.fitted_yaws_rad
    orientations = np.full((n_robots, 4), np.nan)
    half_widths = np.full(n_robots, np.pi)
    for point, heading in placed.headings.items():
        if point < n_robots:
            orientations[point] = heading.orientation_xyzw
            half_widths[point] = heading.half_width_rad
    apart = np.zeros((2, n_points, n_points))
    apart[1] = np.inf
    among = np.ix_(points, points)
    apart[0][among], apart[1][among] = placed.distances.lower, placed.distances.upper
    np.fill_diagonal(apart[1], 0.0)
    return Placement(
        positions_m=positions[:n_robots],
        enclosure_m=boxes[:n_robots],
        orientations_xyzw=orientations,
        heading_known=~np.isnan(orientations[:, 0]),
        heading_half_width_rad=half_widths,
        proved=proved,
        flexible=flexible,
        mirrored=mirrored,
        landmarks_m=positions[landmarks],
        landmark_enclosure_m=boxes[landmarks],
        lower_m=apart[0, :n_robots, :n_robots],
        upper_m=apart[1, :n_robots, :n_robots],
        dropped=tuple(sorted(dropped)),
        covariances=covariances[:n_robots],
        fitted_yaws_rad=fitted_yaws[:n_robots],
    )
