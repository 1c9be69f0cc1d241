# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds that hold most of the observed errors.

The narrowest bounds that keep a chosen share of the readings, widened by a margin on both sides,
since future errors may be larger.
"""

from collections.abc import Iterable
from dataclasses import dataclass
import math
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.fleet.config import RangeErrorModel
from dg_localization.fleet.error_models import distance_bounds_m

DECIMALS = 4
"""Decimals of bounds in m, in rad, and as a fraction, which are rounded outward."""

READINGS = 20
"""Least readings of a link, or windows of the odometry of a robot, for its own bounds."""

SLOPES, STEPS = 21, 5
"""Number of slopes (errors per m) tried at a time, and number of refinements of the best one."""

WORTH_A_SLOPE = 0.9
"""Bounds with a slope must be narrower than others by this factor."""


class Columns:
    """A table: the fields of a dataclass are arrays with the same number of rows."""

    def chosen(self, rows: NDArray[np.bool_]) -> Self:
        """Return some of the rows."""
        return type(self)(*(column[rows] for column in vars(self).values()))

    @classmethod
    def joined(cls, parts: Iterable[Self]) -> Self:
        """Return the rows of all parts, at least one."""
        columns = zip(*(vars(part).values() for part in parts), strict=True)
        return cls(*map(np.concatenate, columns))


@dataclass(frozen=True)
class Choice:
    """
    The requirements on bounds.

    Parameters
    ----------
    keep : float
        The least share of the readings that they hold, in (0, 1].
    margin : float
        The widening at each end, as a share of their width; not negative.

    """

    keep: float = 0.999
    margin: float = 0.1


class ErrorShape(NamedTuple):
    """The growth of range errors with the range: bounds as fractions, or a slope."""

    relative: bool = False
    slope: float = 0.0


def shortest_band(values: ArrayLike, keep: float) -> tuple[float, float]:
    """
    Return the shortest interval that holds a share of values.

    Parameters
    ----------
    values : array_like, shape (n,)
        Not empty.
    keep : float
        The share, in (0, 1].

    """
    ordered = np.sort(np.asarray(values, dtype=float))
    kept = n_kept(len(ordered), keep)
    widths = ordered[kept - 1 :] - ordered[: len(ordered) - kept + 1]
    first = int(np.argmin(widths))
    return float(ordered[first]), float(ordered[first + kept - 1])


def n_kept(count: int, keep: float) -> int:
    """Return the least number of `count` values that is at least the share `keep`."""
    # 0.9 of 10 must be 9, although the product in floating point is slightly more.
    return max(1, math.ceil(keep * count - 1e-9))


def fit_range(
    readings_m: ArrayLike, errors_m: ArrayLike, choice: Choice, shape: ErrorShape
) -> RangeErrorModel:
    """
    Return the bounds of range errors, and the likeliest error.

    They are constant if a fraction would be 1 or more, which no model allows.

    Parameters
    ----------
    readings_m, errors_m : array_like, shape (n,)
        Readings, and readings minus true distances.
    choice : Choice
    shape : ErrorShape

    """
    readings, errors = np.asarray(readings_m, dtype=float), np.asarray(errors_m, dtype=float)
    if shape.relative:
        fractions = errors / readings
        low, high = rounded_outward(_widened(shortest_band(fractions, choice.keep), choice.margin))
        if high < 1.0:
            likeliest_m = float(np.median(errors))
            return RangeErrorModel(0.0, 0.0, low, high, expected_error_m=likeliest_m)
    rest_m = errors - shape.slope * readings
    low_m, high_m = rounded_outward(_widened(shortest_band(rest_m, choice.keep), choice.margin))
    return RangeErrorModel(
        *(low_m, high_m, shape.slope, shape.slope),
        expected_error_m=float(np.median(rest_m)),
        expected_error_relative=shape.slope,
    )


def shape_of(readings_m: ArrayLike, errors_m: ArrayLike, choice: Choice) -> ErrorShape:
    """
    Return the growth of errors whose bounds are narrowest at the mean reading.

    Parameters
    ----------
    readings_m, errors_m : array_like, shape (n,)
        Readings of all pairs: a pair with a constant distance does not show the growth.
    choice : Choice

    """
    readings, errors = np.asarray(readings_m, dtype=float), np.asarray(errors_m, dtype=float)
    low_m, high_m = shortest_band(errors, choice.keep)
    shape, width_m = ErrorShape(), high_m - low_m
    if np.all(readings > 0.0):
        low, high = shortest_band(errors / readings, choice.keep)
        wide_m = (high - low) * float(np.mean(readings))
        if _widened((low, high), choice.margin)[1] < 0.99 and wide_m < width_m:
            shape, width_m = ErrorShape(relative=True), wide_m
    slope, reach = 0.0, 0.5
    for _ in range(STEPS):
        slopes = np.linspace(slope - reach, slope + reach, SLOPES)
        bands = [shortest_band(errors - one * readings, choice.keep) for one in slopes]
        widths_m = [high_m - low_m for low_m, high_m in bands]
        slope, reach = float(slopes[np.argmin(widths_m)]), 2.0 * reach / (SLOPES - 1)
    slope = round(slope, DECIMALS)
    return ErrorShape(slope=slope) if min(widths_m) < WORTH_A_SLOPE * width_m else shape


WINDOW_S = 1.0
"""Within this time, readings of one pair minus a steady motion differ only by their errors."""

LEAST_NEIGHBORS = 2
"""Least neighbors on each side of a reading."""


def residuals(stamps_s: ArrayLike, values: ArrayLike, angles: bool = False) -> NDArray[np.float64]:
    """
    Return the residual of each reading against its neighbors in time.

    Parameters
    ----------
    stamps_s : array_like, shape (n,)
        Increasing.
    values : array_like, shape (n,)
        Ranges in m, or angles in rad.
    angles : bool, optional
        Whether they are angles, which differ by less than half a turn.

    Returns
    -------
    ndarray, shape (n,)
        The reading minus the median of equally many neighbors on either side, within half a
        second: a steady motion cancels. NaN if there are fewer than two on a side.

    """
    stamps, readings = np.asarray(stamps_s, dtype=float), np.asarray(values, dtype=float)
    first = np.searchsorted(stamps, stamps - WINDOW_S / 2.0, side='left')
    last = np.searchsorted(stamps, stamps + WINDOW_S / 2.0, side='right') - 1
    found = np.full(len(stamps), np.nan)
    for i in range(len(stamps)):
        reach = min(i - first[i], last[i] - i)
        if reach >= LEAST_NEIGHBORS:
            around = np.concatenate([readings[i - reach : i], readings[i + 1 : i + reach + 1]])
            ahead = around - readings[i]
            found[i] = -np.median(without_turns(ahead) if angles else ahead)
    return found


def missing_m(scatter_m: ArrayLike, half_widths_m: ArrayLike, choice: Choice) -> tuple[float, int]:
    """
    Return the width missing from bounds at each end for a scatter about an unknown bias.

    The bias is assumed in the middle of the kept scatter. The half widths are those of the bounds
    at each reading: at a short range they may be narrower. The second value is the number of
    readings that no bias brings within the widened bounds together with the kept ones.
    """
    scatter, halves = np.asarray(scatter_m, dtype=float), np.asarray(half_widths_m, dtype=float)
    sizes = np.abs(scatter - np.mean(shortest_band(scatter, choice.keep)))
    lacking = (1.0 + 2.0 * choice.margin) * sizes - halves
    held = np.argsort(lacking)[: n_kept(len(scatter), choice.keep)]
    missing = max(0.0, float(lacking[held[-1]]))
    low, high = scatter - halves - missing, scatter + halves + missing
    beyond = (low > high[held].min()) | (high < low[held].max())
    beyond[held] = False
    return missing, int(np.count_nonzero(beyond))


def fit_half_width_rad(errors_rad: ArrayLike, choice: Choice) -> float:
    """
    Return the bound of the angles between rays and true directions.

    Parameters
    ----------
    errors_rad : array_like, shape (n,)
    choice : Choice

    """
    sizes = np.sort(np.abs(errors_rad))
    widest = float(sizes[n_kept(len(sizes), choice.keep) - 1])
    return min(math.pi, rounded_outward((0.0, widest * (1.0 + choice.margin)))[1])


def range_holds(model: RangeErrorModel, reading_m: float, distance_m: float) -> bool:
    """Return whether the bounds of a reading hold the true distance."""
    low_m, high_m = distance_bounds_m(model, reading_m)
    return low_m <= distance_m <= high_m


def without_turns(angles_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles wrapped to [-pi, pi]."""
    return np.remainder(angles_rad + np.pi, 2.0 * np.pi) - np.pi


def _widened(band: tuple[float, float], margin: float) -> tuple[float, float]:
    extra = margin * (band[1] - band[0])
    return band[0] - extra, band[1] + extra


def rounded_outward(band: tuple[float, float]) -> tuple[float, float]:
    """Round outward to the printed decimals."""
    scale = 10.0**DECIMALS
    return math.floor(band[0] * scale) / scale, math.ceil(band[1] * scale) / scale
