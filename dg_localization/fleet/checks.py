# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Checks of single settings."""

from __future__ import annotations

import math

FARTHEST_M = 1e9
"""Farther from the origin coordinates have too few digits, and their squares may overflow."""


class ConfigError(ValueError):
    """A setting has a value it cannot have."""


def require_number(
    name: str,
    value: float,
    *,
    at_least: float = -math.inf,
    at_most: float = math.inf,
    finite: bool = True,
) -> None:
    """Raise `ConfigError` unless `value` is a number within the limits."""
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if number and at_least <= value <= at_most and (math.isfinite(value) or not finite):
        return
    kind = 'a finite number' if finite else 'a number'
    limits = []
    if at_least > -math.inf:
        limits.append(f'>= {at_least:g}')
    if at_most < math.inf:
        limits.append(f'<= {at_most:g}')
    wanted = ' '.join([kind, ' and '.join(limits)]).strip()
    raise ConfigError(f'{name}: {value!r} is not allowed, it must be {wanted}')


def require_coordinate(name: str, value: float) -> None:
    """Raise `ConfigError` unless `value` is a coordinate in m within `FARTHEST_M`."""
    require_number(name, value, at_least=-FARTHEST_M, at_most=FARTHEST_M)


def require_integer(name: str, value: int, at_least: int) -> None:
    """Raise `ConfigError` unless `value` is an integer of at least `at_least`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < at_least:
        raise ConfigError(f'{name}: {value!r} is not allowed, it must be an integer >= {at_least}')
