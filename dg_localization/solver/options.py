# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Options of the solver: its resolution and its limits."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from numbers import Real
from typing import Protocol

from dg_localization.solver.checks import is_whole

LARGEST_RESOLUTION_M = 1e154
"""Its square is finite; squares overflow from 1.35e154 on."""


@dataclass(frozen=True)
class SolverOptions:
    """
    The resolution and the limits of the solver.

    Parameters
    ----------
    resolution : float
        A box is finished when all its distances are known to this many meters.
    max_boxes : int
        Most boxes to process.
    max_seconds : float
        Most time to spend, in seconds.
    tighten_seconds : float
        Until this time of a call, in seconds, linear programs narrow the bounds of finished boxes;
        0 switches that off. Hypotheses of the whole fleet, which are built on demand, have as much
        time again.
    max_hypotheses : int
        Most hypotheses of the whole fleet to build from those of its pieces.

    Raises
    ------
    ValueError
        If a value is out of range.

    """

    resolution: float = 0.05
    max_boxes: int = 2000
    max_seconds: float = float('inf')
    tighten_seconds: float = 0.0
    max_hypotheses: int = 64

    def __post_init__(self) -> None:
        """Refuse values out of range; keep integers as those of Python."""
        self._check_real('resolution', ' m')
        self._check_real('max_seconds', ' s')
        self._check_real('tighten_seconds', ' s', zero=True)
        if not self.resolution <= LARGEST_RESOLUTION_M:
            text = f'must be positive and finite, at most {LARGEST_RESOLUTION_M} m'
            raise ValueError(f'resolution is {self.resolution} m, it {text}')
        for name in ('max_boxes', 'max_hypotheses'):
            value = getattr(self, name)
            if not is_whole(value) or value < 1:
                raise ValueError(f'{name} is {value}, it must be an integer of at least 1')
            object.__setattr__(self, name, int(value))

    def limited(self, max_boxes: int, max_seconds: float, tighten_seconds: float) -> SolverOptions:
        """Return a copy with other limits, which are valid by construction."""
        options = copy(self)
        options.__dict__.update(
            max_boxes=max_boxes, max_seconds=max_seconds, tighten_seconds=tighten_seconds
        )
        return options

    def _check_real(self, name: str, unit: str, zero: bool = False) -> None:
        """Refuse all but positive numbers, and zero where allowed; keep these as floats."""
        value = getattr(self, name)
        is_number = isinstance(value, Real) and not isinstance(value, bool)
        if not is_number or not (value > 0.0 or (zero and value == 0.0)):
            raise ValueError(f'{name} is {value}{unit}, it must be a positive number')
        object.__setattr__(self, name, float(value))


class Cancel(Protocol):
    """An object that can cancel a search, such as a `threading.Event`."""

    def is_set(self) -> bool:
        """Return whether the search is cancelled."""
        ...
