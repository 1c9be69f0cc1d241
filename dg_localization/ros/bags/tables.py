# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Tables of a report for a person, and runs of ticks that have something in common."""

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Key = TypeVar('Key', bound=Hashable)

PARTS = 3
"""So many runs of equal rows are listed one by one."""


@dataclass
class Run(Generic[Key]):
    """Ticks in a row that have `what` in common, from the first to the last, in s of the bag."""

    what: Key
    first_s: float
    last_s: float
    ticks: int = 1


class Runs(list[Run[Key]]):
    """The runs of all that was added, in the order of their beginnings."""

    def __init__(self) -> None:
        super().__init__()
        self._open: dict[Key, tuple[int, Run[Key]]] = {}

    def add(self, what: Key, tick: int, at_s: float) -> None:
        """Lengthen the run that ended with the tick before, or begin one."""
        number, run = self._open.get(what, (-2, None))
        if run is not None and number == tick - 1:
            run.last_s, run.ticks = at_s, run.ticks + 1
        else:
            run = Run(what, at_s, at_s)
            self.append(run)
        self._open[what] = (tick, run)

    def merged(self) -> dict[Key, str]:
        """Return when each of them was, in words."""
        by_key: dict[Key, list[Run[Key]]] = {}
        for run in self:
            by_key.setdefault(run.what, []).append(run)
        return {what: _span_text(runs) for what, runs in by_key.items()}


def _span_text(runs: list[Run[Key]]) -> str:
    if len(runs) <= PARTS:
        return ', '.join(_one_span(run.first_s, run.last_s, ticks(run.ticks)) for run in runs)
    count = ticks(sum(run.ticks for run in runs))
    return _one_span(runs[0].first_s, runs[-1].last_s, f'{count} in {len(runs)} parts')


def _one_span(first_s: float, last_s: float, count: str) -> str:
    return f'{first_s:.1f} to {last_s:.1f} s ({count})'


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
