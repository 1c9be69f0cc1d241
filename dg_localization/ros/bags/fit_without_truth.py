# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the readings of a bag tell of their errors without a ground truth."""

from collections.abc import Iterable, Iterator, Sequence
import math
from typing import Any

import numpy as np

from dg_localization.calibration.bounds import (
    Choice,
    fit_half_width_rad,
    missing_m,
    residuals,
    rounded_outward,
    shortest_band,
)
from dg_localization.fleet import LinkKind, RangeErrorModel
from dg_localization.ros.bags.bag import BagError
from dg_localization.ros.bags.fitted import (
    Fit,
    FloatArray,
    GroupFit,
    gathered,
    range_parameters,
    with_readings,
)
from dg_localization.ros.bags.samples import Samples
from dg_localization.ros.interface.parameters.settings import Settings


def fit_without_truth(
    samples: Samples,
    settings: Settings,
    per: str,
    choice: Choice,
    bias_m: Sequence[float] | None,
) -> Fit:
    """Learn what readings tell of themselves."""
    ranges, bearings = {}, {}
    for key, rows in samples.ranges.items():
        stamps, values = _in_order(rows)
        scatter = residuals(stamps, values)
        known = np.isfinite(scatter)
        ranges[key] = scatter[known], values[known]
    for key, seen in samples.rays.items() if settings.fleet.dimension == 2 else ():
        stamps, angles = _in_order([(s, math.atan2(ray[1], ray[0])) for s, ray in seen])
        scatter = residuals(stamps, angles, angles=True)
        bearings[key] = (scatter[np.isfinite(scatter)],)
    fit = Fit(
        judged=with_readings({**ranges, **bearings}),
        # A bias of ranges that is known is known of all pairs.
        kept=frozenset({LinkKind.BEARING} | ({LinkKind.RANGE} if bias_m is None else set())),
        ranges={
            pair: _scatter_group(
                scatter, readings, settings.fleet.range_error_of(*pair), choice, bias_m
            )
            for pair, (scatter, readings) in gathered(ranges, per).items()
        },
        bearings={
            pair: _angle_scatter_group(
                scatter, settings.fleet.bearing_half_width_of(*pair), choice
            )
            for pair, (scatter,) in gathered(bearings, per).items()
        },
    )
    if not (fit.ranges or fit.bearings):
        raise BagError('no input has five readings within a second: nothing can be learned')
    fit.notes += _limits_without_truth(samples, bias_m)
    return fit


def _in_order(rows: Iterable[tuple[float, Any]]) -> tuple[FloatArray, FloatArray]:
    stamps, values = np.array(sorted(rows)).T
    return stamps, values


def _scatter_group(
    scatter_m: FloatArray,
    readings_m: FloatArray,
    stated: RangeErrorModel,
    choice: Choice,
    bias_m: Sequence[float] | None,
) -> GroupFit:
    """Return the stated bounds, no narrower than the scatter; those around a known bias."""
    low_m, high_m = shortest_band(scatter_m, choice.keep)
    seen = f'scatter {low_m:.2f} to {high_m:.2f} m'
    if bias_m is not None:
        beyond = int(np.count_nonzero((scatter_m < low_m) | (scatter_m > high_m)))
        extra_m = choice.margin * (high_m - low_m)
        model = rounded_outward(bias_m[0] + low_m - extra_m, bias_m[1] + high_m + extra_m)
        return GroupFit(len(scatter_m), beyond, seen, range_parameters(model))
    relative = stated.max_error_relative - stated.min_error_relative
    stated_m = np.abs(stated.max_error_m - stated.min_error_m + relative * readings_m)
    extra_m, beyond = missing_m(scatter_m, 0.5 * stated_m, choice)
    if extra_m > 0.0:
        seen += (
            f', which the stated bounds, {stated_m.min():.2f} m apart at the shortest reading, '
            'cannot hold: widened'
        )
    wide = rounded_outward(stated.min_error_m - extra_m, stated.max_error_m + extra_m)
    bounds = {
        **range_parameters(stated),
        'min_error': wide.min_error_m,
        'max_error': wide.max_error_m,
    }
    return GroupFit(len(scatter_m), beyond, seen, bounds)


def _angle_scatter_group(scatter_rad: FloatArray, stated_rad: float, choice: Choice) -> GroupFit:
    """Return the stated half width, no narrower than the scatter."""
    needed_rad = fit_half_width_rad(scatter_rad, choice)
    seen = f'scatter {scatter_rad.min():.3f} to {scatter_rad.max():.3f} rad'
    half_width_rad = max(needed_rad, stated_rad)
    excluded = int(np.count_nonzero(np.abs(scatter_rad) > half_width_rad))
    return GroupFit(len(scatter_rad), excluded, seen, {'half_width': half_width_rad})


def _limits_without_truth(samples: Samples, bias_m: Sequence[float] | None) -> Iterator[str]:
    """Yield what a recording without truth cannot tell."""
    yield (
        'Without a ground truth only the scatter of the readings is seen. An error that all '
        'readings of a pair share for a second and longer, a bias, is not seen.'
    )
    if bias_m is None:
        yield (
            'Without --truth the bounds are those that you stated, widened where the scatter does '
            'not fit between them. They become narrower with --truth, or with --bias LOW HIGH, '
            'known from elsewhere.'
        )
    else:
        yield f'The bias is taken to be between {bias_m[0]:g} and {bias_m[1]:g} m, as stated.'
    if samples.rays:
        yield 'A camera that is mounted askew has a bias, too: half widths are not narrowed.'
    if samples.odometry:
        yield 'Without a ground truth scale and bounds of odometry cannot be learned.'
