# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Readings of a bag beside the truth: their errors, and when they break the stated bounds."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from dg_localization.calibration.bounds import range_holds
from dg_localization.calibration.truth import TrueTrack, range_errors_m, ray_errors_rad
from dg_localization.fleet import FleetConfig, LinkKey, LinkKind
from dg_localization.ros.bags.fitted import LEAST_READINGS, BoolArray, FloatArray
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


DELAY_S, STEP_S = 0.02, 0.05
"""The shortest delay that is told, and the time over which distances are seen to change."""

DEVIATIONS = 4.0
"""A delay is told that is this many of its standard deviations."""


def compared(
    kind: LinkKind, samples: Samples, tracks: Mapping[str, TrueTrack], dimension: int
) -> dict[LinkKey, Compared]:
    """Return the ranges or the rays of a bag beside the truth."""
    is_range, found = kind is LinkKind.RANGE, {}
    errors_of = range_errors_m if is_range else ray_errors_rad
    for key, rows in (samples.ranges if is_range else samples.rays).items():
        if {key.observer, key.target} <= tracks.keys():
            stamps_s, read = (np.array(column) for column in zip(*rows, strict=True))
            ends = tracks[key.observer], tracks[key.target]
            errors = errors_of(*ends, stamps_s, read, dimension)
            known = np.isfinite(errors)
            values = read if is_range else np.full(len(stamps_s), np.nan)
            found[key] = Compared(stamps_s[known], values[known], errors[known])
    return found


def gross_text(stamps_s: FloatArray, errors: FloatArray, kept: BoolArray, unit: str) -> str:
    """Return which single reading sets a bound that would be half as wide without; or nothing."""
    held = np.flatnonzero(kept)
    if len(held) < 3:
        return ''
    ordered = held[np.argsort(errors[held], kind='stable')]
    for one, rest in ((ordered[-1], ordered[:-1]), (ordered[0], ordered[1:])):
        if np.ptp(errors[held]) > 2.0 * np.ptp(errors[rest]):
            return (
                f'; one reading at {stamps_s[one]:.3f} s, off by {errors[one]:.2f} {unit}, sets a '
                f'bound that would be less than half as wide without it ({errors[rest].min():.2f} '
                f'to {errors[rest].max():.2f} {unit}): a smaller --keep leaves it out'
            )
    return ''


def delay_texts(
    ranges: Mapping[LinkKey, Compared], tracks: Mapping[str, TrueTrack], dimension: int
) -> Iterator[str]:
    """
    Yield which inputs have stamps that are late or early, and by how much.

    A range that is stamped late by t is that of the distance t before: its error is -t times the
    rate of the distance, and the slope of a regression on that rate shows it.
    """
    for key, one in ranges.items():
        ends = tracks[key.observer], tracks[key.target]
        # The distance is what no range at all is less than.
        ahead, behind = (
            -range_errors_m(*ends, one.stamps_s + step, np.zeros(len(one.stamps_s)), dimension)
            for step in (STEP_S, -STEP_S)
        )
        rates = (ahead - behind) / (2.0 * STEP_S)
        known = np.isfinite(rates)
        if np.count_nonzero(known) < LEAST_READINGS or not rates[known].std():
            continue
        rate = rates[known] - rates[known].mean()
        errors = one.errors[known] - np.median(one.errors[known])
        delay_s = -float(rate @ errors / (rate @ rate))
        spread_s = float((errors + delay_s * rate).std() / np.sqrt(rate @ rate))
        if abs(delay_s) > max(DELAY_S, DEVIATIONS * spread_s):
            late = 'late' if delay_s > 0.0 else 'early'
            yield (
                f'Stamps of {key} are {abs(delay_s):.3f} s {late} (+-{2.0 * spread_s:.3f}), as '
                f'its errors change with the rate of the distance: its link may state '
                f'stamp_offset={-delay_s:.3f}.'
            )


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
