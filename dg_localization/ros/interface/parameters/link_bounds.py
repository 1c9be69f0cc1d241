# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Error bounds: those of all ranges, and those that links override."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
import math
from typing import Any

from dg_localization.fleet import LinkKind, LinkOverride, RangeErrorModel
from dg_localization.ros.interface.links import ANY_OBSERVER, OVERRIDES, RANGE_BOUNDS, Link
from dg_localization.ros.interface.parameters.spec import WrongParameterError

BEARING_FIELDS = {
    'half_width': 'bearing_half_width_rad',
    'expected_error': 'bearing_expected_error_rad',
}


def range_error_from(values: Mapping[str, Any], **overrides: float) -> RangeErrorModel:
    """Return the bounds of ranges, some of them overridden by name."""
    bounds = {name: overrides.get(name, values[f'range.{name}']) for name in RANGE_BOUNDS}
    expected_error = overrides.get('expected_error', values['range.expected_error'])
    return RangeErrorModel(
        min_error_m=bounds['min_error'],
        max_error_m=bounds['max_error'],
        min_error_relative=bounds['min_error_relative'],
        max_error_relative=bounds['max_error_relative'],
        sigma_factor=bounds['sigma_factor'],
        beyond_max_is_far=values['range.beyond_max_is_far'],
        expected_error_m=None if math.isnan(expected_error) else expected_error,
    )


def overrides_from(
    links: Iterable[Link], points: Iterable[str], values: Mapping[str, Any]
) -> tuple[LinkOverride, ...]:
    """Gather the bounds of ranges and of bearings between the same two points."""
    gathered: dict[tuple[str, str], LinkOverride] = {}
    # A link to one point wins over that to all peers of its observer.
    for link in sorted(links, key=lambda link: link.key.kind is not LinkKind.PEERS):
        bounds: dict[str, Any] = {}
        is_bearing = link.key.kind is LinkKind.BEARING
        of_ranges = () if is_bearing else OVERRIDES[LinkKind.RANGE]
        for name, field in BEARING_FIELDS.items():
            if name in link.overrides and name not in of_ranges:
                bounds[field] = link.overrides[name]
        try:
            if of_range := {k: v for k, v in link.overrides.items() if k in of_ranges}:
                bounds['range_error'] = range_error_from(values, **of_range)
            for pair in _pairs(link, points) if bounds else ():
                override = gathered.get(pair, LinkOverride(*pair))
                gathered[pair] = replace(override, **bounds)
        except ValueError as error:
            raise WrongParameterError(
                f"parameter 'links': the bounds of '{link.topic}' are not allowed: {error}"
            ) from None
    return tuple(gathered.values())


def _pairs(link: Link, points: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield each observer and target of a link; a link to peers has all targets."""
    observers = points if link.key.observer == ANY_OBSERVER else (link.key.observer,)
    targets = (link.key.target,) if link.key.target else points
    return ((one, other) for one in observers for other in targets if one != other)


def ends_of(link: Link) -> set[str]:
    """Return the observer and the target of a link."""
    return {link.key.observer, link.key.target}
