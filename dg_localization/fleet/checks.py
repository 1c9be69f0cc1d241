# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Checks of single settings. They return the value that the settings keep."""

from __future__ import annotations

from collections.abc import Collection, Mapping
import math
from numbers import Integral, Real
from types import MappingProxyType
from typing import Any

from dg_localization.solver.checks import is_whole

FARTHEST_M = 1e9
"""Coordinates farther from the origin have too few digits, and their squares may overflow."""


class ConfigError(ValueError):
    """A setting has a value that is not allowed."""


def not_allowed(name: str, value: object, wanted: str) -> ConfigError:
    """Return the error for a wrong value of a setting."""
    return ConfigError(f'{name}: {value!r} is not allowed, {wanted}')


def keep(settings: object, **values: object) -> None:
    """Set fields of a frozen dataclass during its construction."""
    for name, value in values.items():
        object.__setattr__(settings, name, value)


def keep_numbers(settings: object, prefix: str, limits: Mapping[str, Mapping[str, Any]]) -> None:
    """
    Keep fields as numbers within limits, as integers if the default is one.

    None is kept if it is the default.
    """
    for name, within in limits.items():
        value, default = getattr(settings, name), getattr(type(settings), name, 0.0)
        if value is not None or default is not None:
            required = require_integer if isinstance(default, int) else require_number
            keep(settings, **{name: required(f'{prefix}{name}', value, **within)})


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
    limits = [f'>= {at_least:g}'] * (at_least > -math.inf) + [f'<= {at_most:g}'] * (
        at_most < math.inf
    )
    kind = 'a finite number' if finite else 'a number'
    raise not_allowed(name, value, f'it must be {kind} {" and ".join(limits)}'.strip())


def _as_float(value: object) -> float:
    """
    Return a number of Python or NumPy as a float; NaN if it is no number.

    A number that no float represents counts as none: a rounded bound might exclude the truth.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        return math.nan
    exact = int(value) if isinstance(value, Integral) else value
    try:
        number = float(value)
    except OverflowError:
        return math.nan
    return number if number == exact else math.nan


def require_coordinates(name: str, values: object) -> tuple[float, ...]:
    """Return coordinates in m as floats; raise `ConfigError` on one beyond `FARTHEST_M`."""
    listed = require_members(name, values, 'numbers')
    return tuple(require_number(name, v, at_least=-FARTHEST_M, at_most=FARTHEST_M) for v in listed)


def require_integer(name: str, value: object, *, at_least: float) -> int:
    """Return `value` as an int; raise `ConfigError` unless it is an integer >= `at_least`."""
    if is_whole(value) and value >= at_least:
        return int(value)
    raise not_allowed(name, value, f'it must be an integer >= {at_least:g}')


def require_kind(name: str, value: object, kind: type) -> None:
    """Raise `ConfigError` unless `value` is of a type."""
    if not isinstance(value, kind):
        article = 'an' if kind.__name__[0] in 'AEIOU' else 'a'
        raise not_allowed(name, value, f'it must be {article} {kind.__name__}')


def require_name(name: str, value: object) -> None:
    """Raise `ConfigError` unless `value` is a name."""
    if not isinstance(value, str) or not value:
        raise not_allowed(name, value, 'a name must be a string and not be empty')


def require_one_of(name: str, value: object, allowed: Collection[str]) -> None:
    """Raise `ConfigError` unless `value` is one of some names."""
    if value not in allowed:
        raise not_allowed(name, value, f'it must be one of {list(allowed)}')


def require_members(name: str, value: Any, wanted: str) -> tuple[Any, ...]:
    """Return the members of a sequence; raise `ConfigError` if it is none, such as a string."""
    if not isinstance(value, (str, bytes)):
        try:
            return tuple(value)
        except TypeError:
            pass
    raise not_allowed(name, value, f'it must be a sequence of {wanted}')


def require_mapping(name: str, value: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a read-only copy; raise `ConfigError` unless it is a mapping."""
    require_kind(name, value, Mapping)
    return MappingProxyType(dict(value))


def unlocked(value: Any) -> Any:
    """Return a mapping of `require_mapping` as a dict, recursively; other values unchanged."""
    if isinstance(value, Mapping):
        return {key: unlocked(inside) for key, inside in value.items()}
    return value
