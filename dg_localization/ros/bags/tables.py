# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Tables and counts of a report, for a person."""

from collections.abc import Iterable
from typing import Any


def table(first: str, second: str, rows: Iterable[tuple[Any, Any]]) -> str:
    """Return a table that reads well as it is, too; nothing without rows."""
    cells = [(str(left), str(right)) for left, right in rows]
    if not cells:
        return ''
    wide = [max(map(len, column)) for column in zip((first, second), *cells, strict=True)]
    lines = [(first, second), ('-' * wide[0], '-' * wide[1]), *cells]
    return '\n'.join(f'| {left:<{wide[0]}} | {right:<{wide[1]}} |' for left, right in lines)


def ticks(number: int) -> str:
    """Return a number of ticks in words."""
    return '1 tick' if number == 1 else f'{number} ticks'


def span(first_s: float, last_s: float, number: int) -> str:
    """Return when something went on, in words."""
    return f'{first_s:.1f} to {last_s:.1f} s ({ticks(number)})'
