# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Checks of single settings. What they return is what the settings keep."""

from __future__ import annotations

from collections.abc import Mapping
import math
from numbers import Integral, Real
from types import MappingProxyType
from typing import Any

from dg_localization.solver.checks import is_whole

FARTHEST_M = 1e9
"""Farther from the origin coordinates have too few digits, and their squares may overflow."""


class ConfigError(ValueError):
    """A setting has a value it cannot have."""


def keep(settings: object, **values: object) -> None:
    """Set fields of a frozen dataclass, while it is made."""
    for name, value in values.items():
        object.__setattr__(settings, name, value)


def require_number(
    name: str,
    value: object,
    *,
    at_least: float = -math.inf,
    at_most: float = math.inf,
    finite: bool = True,
) -> float:
    """Return `value` as a float; raise `ConfigError` unless it is a number within the limits."""
    number = _as_float(value)
    if at_least <= number <= at_most and (math.isfinite(number) or not finite):
        return number
    kind = 'a finite number' if finite else 'a number'
    limits = []
    if at_least > -math.inf:
        limits.append(f'>= {at_least:g}')
    if at_most < math.inf:
        limits.append(f'<= {at_most:g}')
    wanted = ' '.join([kind, ' and '.join(limits)]).strip()
    raise ConfigError(f'{name}: {value!r} is not allowed, it must be {wanted}')


def _as_float(value: object) -> float:
    """
    Return a number of Python or NumPy as a float; NaN where it is none.

    One that no float holds counts as none: rounded, a bound might exclude what it bounds.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        return math.nan
    exact = int(value) if isinstance(value, Integral) else value
    try:
        number = float(value)
    except OverflowError:
        return math.nan
    return number if number == exact else math.nan


def require_coordinate(name: str, value: object) -> float:
    """Return `value` as a float; raise `ConfigError` unless it is in m within `FARTHEST_M`."""
    return require_number(name, value, at_least=-FARTHEST_M, at_most=FARTHEST_M)


def require_integer(name: str, value: object, at_least: int) -> int:
    """Return `value` as an int; raise `ConfigError` unless it is one of at least `at_least`."""
    if is_whole(value) and value >= at_least:
        return int(value)
    raise ConfigError(f'{name}: {value!r} is not allowed, it must be an integer >= {at_least}')


def require_kind(name: str, value: object, kind: type) -> None:
    """Raise `ConfigError` unless `value` is of a type."""
    if not isinstance(value, kind):
        article = 'an' if kind.__name__[0] in 'AEIOU' else 'a'
        raise ConfigError(
            f'{name}: {value!r} is not allowed, it must be {article} {kind.__name__}'
        )


def require_name(name: str, value: object) -> None:
    """Raise `ConfigError` unless `value` is a name."""
    if not isinstance(value, str) or not value:
        raise ConfigError(
            f'{name}: {value!r} is not allowed, a name must be a string and not be empty'
        )


def require_members(name: str, value: Any, wanted: str) -> tuple[Any, ...]:
    """Return what a sequence holds; raise `ConfigError` where it is none, such as a string."""
    if not isinstance(value, (str, bytes)):
        try:
            return tuple(value)
        except TypeError:
            pass
    raise ConfigError(f'{name}: {value!r} is not allowed, it must be a sequence of {wanted}')


def require_mapping(name: str, value: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a copy that nobody can change; raise `ConfigError` unless it is a mapping."""
    require_kind(name, value, Mapping)
    return MappingProxyType(dict(value))


def unlocked(value: Any) -> Any:
    """Return a dict of what `require_mapping` returned, also inside; anything else as it is."""
    if isinstance(value, Mapping):
        return {key: unlocked(inside) for key, inside in value.items()}
    return value
