"""What the solver answers: a verdict, the hypotheses, and how hard it was."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray


class Verdict(Enum):
    """What a solve proves."""

    COVERED = 'covered'
    """Every placement lies in some hypothesis; a hypothesis may still hold none."""

    INFEASIBLE = 'infeasible'
    """No placement agrees with the measurements: no box is left."""

    OUT_OF_BUDGET = 'out_of_budget'
    """A limit stopped the search; every placement lies in some hypothesis all the same."""


@dataclass(frozen=True)
class Statistics:
    """
    The effort of a search; ``processed = empty + split + kept``.

    `empty` counts the boxes proved to hold nothing, the paper's figure of merit (Section 4);
    `pending` boxes were waiting when a limit stopped the search.
    """

    processed: int
    empty: int
    split: int
    kept: int
    pending: int
    seconds: float


@dataclass(frozen=True)
class Hypothesis:
    """
    One connected component of the cover: a set of placements that may be continuous.

    Without a chirality in the problem it stands for its mirror image too.

    Attributes
    ----------
    lower, upper : ndarray, shape (n, n)
        The hull of the component: bounds of every squared distance in m^2.
    boxes : ndarray, shape (k, 2, n, n)
        Its boxes, lower and upper bounds in m^2.
    positions : ndarray, shape (n, q), or None
        One placement in m, as good as could be found; None when none could be computed.
    proved : bool
        Whether `positions` meets every constraint of the problem, checked with outward rounding.
    flexible : bool
        Whether the placements are a continuum even without measurement errors.

    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    boxes: NDArray[np.float64]
    positions: NDArray[np.float64] | None
    proved: bool
    flexible: bool


@dataclass(frozen=True)
class Result:
    """The answer to a problem."""

    verdict: Verdict
    hypotheses: tuple[Hypothesis, ...]
    statistics: Statistics
