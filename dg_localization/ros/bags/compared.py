# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Readings of a bag beside the truth: their errors, and when they break the stated bounds."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from dg_localization.calibration.bounds import range_holds
from dg_localization.calibration.truth import TrueTrack, range_errors_m, ray_errors_rad
from dg_localization.fleet import FleetConfig, LinkKey
from dg_localization.ros.bags.fitted import FloatArray
from dg_localization.ros.bags.samples import Samples

LONGEST_GAP_S = 1.0
"""Readings of one link that are nearer in time are named together."""

MOST_NAMED = 20
"""Of the times when bounds are broken; the rest are counted."""


@dataclass(frozen=True, eq=False)
class Compared:
    """
    The readings of one input whose truth is known.

    Parameters
    ----------
    stamps_s, values, errors : numpy.ndarray, shape (m,)
        Values are ranges in m, and NaN for rays; errors are in m or in rad.

    """

    stamps_s: FloatArray
    values: FloatArray
    errors: FloatArray


def compared_ranges(
    samples: Samples, tracks: Mapping[str, TrueTrack], dimension: int
) -> dict[LinkKey, Compared]:
    """Return the ranges of a bag beside the truth."""
    found = {}
    for key, rows in samples.ranges.items():
        if {key.observer, key.target} <= tracks.keys():
            stamps_s, values = np.array(rows).T
            ends = tracks[key.observer], tracks[key.target]
            errors = range_errors_m(*ends, stamps_s, values, dimension)
            known = np.isfinite(errors)
            found[key] = Compared(stamps_s[known], values[known], errors[known])
    return found


def compared_rays(
    samples: Samples, tracks: Mapping[str, TrueTrack], dimension: int
) -> dict[LinkKey, Compared]:
    """Return the rays of a bag beside the truth."""
    found = {}
    for key, rows in samples.rays.items():
        if {key.observer, key.target} <= tracks.keys():
            stamps_s, rays = (np.array(column) for column in zip(*rows, strict=True))
            ends = tracks[key.observer], tracks[key.target]
            errors = ray_errors_rad(*ends, stamps_s, rays, dimension)
            known = np.isfinite(errors)
            nothing = np.full(int(known.sum()), np.nan)
            found[key] = Compared(stamps_s[known], nothing, errors[known])
    return found


def broken_bounds(
    fleet: FleetConfig, ranges: Mapping[LinkKey, Compared], rays: Mapping[LinkKey, Compared]
) -> list[str]:
    """Return sentences on the readings that break the bounds stated for them, oldest first."""
    found = []
    for key, one in ranges.items():
        model = fleet.range_error_of(key.observer, key.target)
        if model.sigma_factor > 0.0:
            # The bounds depend on the variance of each reading, which is not gathered.
            continue
        pairs = zip(one.values.tolist(), one.errors.tolist(), strict=True)
        held = [range_holds(model, value, value - error) for value, error in pairs]
        found += list(_spans(key, one, ~np.array(held, dtype=bool), 'm'))
    for key, one in rays.items():
        half_width_rad = fleet.bearing_half_width_of(key.observer, key.target)
        found += list(_spans(key, one, np.abs(one.errors) > half_width_rad, 'rad'))
    found.sort()
    # The truth is that of the stamp: a robot that moves is elsewhere when a clock is wrong.
    condition = ', if stamps are right' if fleet.stamp_error_s > 0.0 else ''
    sentences = [f'{text}{condition}.' for _, text in found[:MOST_NAMED]]
    if len(found) > MOST_NAMED:
        more = len(found) - MOST_NAMED
        sentences.append(f'The stated bounds are broken {more} times more{condition}.')
    return sentences


def _spans(
    key: LinkKey, one: Compared, broken: np.ndarray, unit: str
) -> Iterator[tuple[float, str]]:
    """Yield the first time of readings that break their bounds in a row, and a sentence."""
    order = np.argsort(one.stamps_s[broken], kind='stable')
    stamps_s, errors = one.stamps_s[broken][order], np.abs(one.errors[broken][order])
    ends = np.flatnonzero(np.diff(stamps_s) > LONGEST_GAP_S) + 1
    for times_s, sizes in zip(np.split(stamps_s, ends), np.split(errors, ends), strict=True):
        if len(times_s):
            yield (
                float(times_s[0]),
                f'The stated bounds of {key} are broken from {times_s[0]:.1f} to '
                f'{times_s[-1]:.1f} s: {len(times_s)} times, by readings that are off by up to '
                f'{sizes.max():.2f} {unit}',
            )
