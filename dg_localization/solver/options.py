"""Options of the solver: its resolution and its limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class SolverOptions:
    """
    How far the solver goes.

    Parameters
    ----------
    resolution : float
        A box is finished when all its distances are known to this many meters.
    max_boxes : int
        Most boxes to process.
    max_seconds : float
        Most time to spend, in seconds.
    tighten_slices : int
        How many slices of a finished box to examine, to bring its bounds towards the exact hull.
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
    tighten_slices: int = 0
    max_hypotheses: int = 64

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if not 0.0 < self.resolution < float('inf'):
            raise ValueError(f'resolution is {self.resolution} m, it must be positive and finite')
        if self.max_boxes < 1:
            raise ValueError(f'max_boxes is {self.max_boxes}, it must be at least 1')
        if not self.max_seconds > 0.0:
            raise ValueError(f'max_seconds is {self.max_seconds} s, it must be positive')
        if self.tighten_slices < 0:
            raise ValueError(f'tighten_slices is {self.tighten_slices}, it must not be negative')
        if self.max_hypotheses < 1:
            raise ValueError(f'max_hypotheses is {self.max_hypotheses}, it must be at least 1')


class Cancel(Protocol):
    """An object that can cancel a search, such as a `threading.Event`."""

    def is_set(self) -> bool:
        """Return whether to stop."""
        ...
