# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Hypotheses whose placements hardly anybody asks for, such as those of parts of a problem."""

from __future__ import annotations

from functools import cached_property
from typing import TypeAlias

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.solver.box import UPPER, FloatArray
from dg_localization.solver.place.hypotheses import hulls_of, never, placement_in
from dg_localization.solver.place.rigidity import is_flexible
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis

Placement: TypeAlias = tuple[FloatArray | None, bool]
"""A placement in m, None where none could be computed, and whether it is proved."""


class UnplacedHypothesis(Hypothesis):
    """
    A hypothesis whose placement is sought when it is first asked for.

    What it is made of is not its fields: `dataclasses.replace` cannot copy it.
    """

    def _seek(self) -> Placement:
        """Return a placement, and whether it is proved to agree."""
        raise NotImplementedError

    @cached_property
    @default_environment()
    def _placed(self) -> Placement:
        return self._seek()

    @property
    def positions(self) -> FloatArray | None:
        """One placement in m, shape (n, q); None where none could be computed."""
        return self._placed[0]

    @property
    def proved(self) -> bool:
        """Whether it meets every constraint of the problem and lies in a box."""
        return self._placed[1]


class HypothesisOfBoxes(UnplacedHypothesis):
    """A hypothesis of a cover."""

    _problem: Problem
    _inside: list[FloatArray]

    def __init__(self, problem: Problem, hull: FloatArray, boxes: list[FloatArray]) -> None:
        # The base class is frozen.
        lower, upper = hull
        self.__dict__.update(lower=lower, upper=upper, _problem=problem, _inside=boxes)

    @property
    def boxes(self) -> FloatArray:
        """Its boxes, lower and upper bounds in m^2, shape (k, 2, n, n)."""
        return np.array([box[: UPPER + 1] for box in self._inside])

    def _seek(self) -> tuple[FloatArray, bool]:
        return placement_in(self._problem, self._inside, [], never)

    @cached_property
    @default_environment()
    def flexible(self) -> bool:
        """Whether the placements are a continuum even without measurement errors, or may be."""
        measured = np.isfinite(self._problem.upper)
        if measured.all():
            return False
        return self.positions is None or not self.proved or is_flexible(self.positions, measured)


def unplaced_hypotheses_of(
    problem: Problem, boxes: list[FloatArray]
) -> tuple[HypothesisOfBoxes, ...]:
    """Return the hypotheses of a cover, whose placements are sought only when asked for."""
    return tuple(
        HypothesisOfBoxes(problem, hull, [boxes[index] for index in indices])
        for hull, indices in hulls_of(boxes)
    )
