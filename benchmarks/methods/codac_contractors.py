# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Codac 2: interval contractors on the distance equations in Cartesian coordinates.

The frame is pinned to q mutually measured points, so that a minimally rigid problem has as many
coordinates as equations. ``CtcInverse``, with its centered form, contracts vectors of equations,
``CtcFixpoint`` repeats it, and the widest coordinate is bisected. What was found to matter:

- The frame. Through the pair with the most common neighbors the paper's fleet takes 15 nodes;
  through P2 and P1 it takes 25, and the boxes are wider.
- Sides. As signs of single determinants, propagated from one side to the next, they are cheaper
  than as products of two, and they remove the mirror image.
- Square systems. The manipulator's nine equations in one vector lose all six solutions
  (Codac 2.1.2); eight in one vector and the ninth on its own lose none.
- In space the differences of two legs of one platform point are linear; adding them helps.

The times are those of the search alone: neither building the contractors nor turning boxes into
distances is counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
import importlib
from importlib.util import find_spec
from itertools import combinations
import time
from typing import Any

import numpy as np

from benchmarks.cases import Case
from benchmarks.contest import Effort, Hull, Row, attainable_resolution, measure, score
from benchmarks.exact import measured_pairs
from benchmarks.methods.algebra import Expression, determinant, minus, parity, plus
from dg_localization import Problem, SideConstraint

codac: Any = None
"""Imported where it is used, in a process of its own: it makes the importing one round upward."""

NAME = 'codac'

FIXPOINT_RATIO = 0.1
LONGEST_VECTOR = 10
"""``codac.vec`` takes no more."""
RIGID = 1e-9
"""Frame points whose distances are known this well, relatively, get constant coordinates."""


def missing() -> str | None:
    """Say what is missing, if anything."""
    return None if find_spec('codac') else 'codac is not installed (pip install codac)'


def best_frame(problem: Problem) -> tuple[int, ...]:
    """Return q mutually measured points, those with the most common neighbors."""
    measured = np.isfinite(problem.upper)
    return max(
        (
            points
            for points in combinations(range(problem.n_points), problem.dimension)
            if all(measured[pair] for pair in combinations(points, 2))
        ),
        key=lambda points: measured[list(points)].all(axis=0).sum(),
    )


def signs_of(sides: Sequence[SideConstraint]) -> dict[tuple[int, ...], int]:
    """
    Propagate sides to chiralities.

    Parameters
    ----------
    sides : sequence of SideConstraint
        Sides, each of which relates the chiralities of two simplices.

    Returns
    -------
    dict
        Sorted points of a simplex to its sign; the first is +1, which leaves out the mirror
        images. Sides that are not connected with the first are not used.

    """
    links: dict[tuple[int, ...], list[tuple[tuple[int, ...], int]]] = {}
    for side in sides:
        first, second = (*side.face, side.first), (*side.face, side.second)
        sign = -int(side.side) * parity(first) * parity(second)
        one, other = tuple(sorted(first)), tuple(sorted(second))
        links.setdefault(one, []).append((other, sign))
        links.setdefault(other, []).append((one, sign))
    if not links:
        return {}
    queue = [next(iter(links))]
    signs = {queue[0]: 1}
    for simplex in queue:
        for neighbor, sign in links[simplex]:
            if neighbor not in signs:
                signs[neighbor] = signs[simplex] * sign
                queue.append(neighbor)
    return signs


def _half_lines() -> dict[int, Any]:
    return {1: codac.Interval(0.0, np.inf), -1: codac.Interval(-np.inf, 0.0)}


@dataclass(frozen=True)
class Formulation:
    """How the equations are given to Codac."""

    label: str
    spare_last: bool = True
    """Whether the last equation of a square system is kept apart."""
    linear: bool = False
    """Whether differences of equations to pinned points are added."""
    fixpoint: bool = True
    """Whether a box is contracted until that gains little, or once before it is bisected."""
    frame: tuple[int, ...] | None = None
    """The pinned points; None takes the best."""
    products: bool = False
    """Whether a side is given as the sign of a product of two determinants."""


class Model:
    """The contractor and the first box of a problem."""

    def __init__(self, problem: Problem, formulation: Formulation) -> None:
        self.problem = problem
        self.frame = formulation.frame or best_frame(problem)
        self._constants = self._rigid_frame()
        self._unknowns = self._number_unknowns()
        self._x = codac.VectorVar(len(self._unknowns))
        self.contractor = self._contractor(formulation)
        self.box = self._first_box(not formulation.products)

    def _rigid_frame(self) -> dict[tuple[int, int], Any]:
        """Return the coordinates of frame points at exactly known distances, as intervals."""
        lower, upper = self.problem.lower, self.problem.upper
        pairs = list(combinations(self.frame, 2))
        if any(upper[pair] - lower[pair] > RIGID * upper[pair] for pair in pairs):
            return {}
        s = {pair: codac.Interval(lower[pair], upper[pair]) for pair in pairs}
        a, b, *rest = self.frame
        constants = {(b, 0): codac.sqrt(s[a, b])}
        for c in rest:
            along = (s[a, b] + s[a, c] - s[b, c]) / (2.0 * constants[b, 0])
            constants[c, 0] = along
            constants[c, 1] = codac.sqrt(s[a, c] - codac.sqr(along))
        return constants

    def _number_unknowns(self) -> dict[tuple[int, int], int]:
        zero = {
            (point, axis)
            for place, point in enumerate(self.frame)
            for axis in range(place, self.problem.dimension)
        }
        free = [
            (point, axis)
            for point in range(self.problem.n_points)
            for axis in range(self.problem.dimension)
            if (point, axis) not in zero and (point, axis) not in self._constants
        ]
        return {key: number for number, key in enumerate(free)}

    def _coordinate(self, point: int, axis: int) -> Expression:
        if (point, axis) in self._unknowns:
            return self._x[self._unknowns[point, axis]]
        return self._constants.get((point, axis))

    def _edge(self, i: int, j: int) -> list[Expression]:
        return [
            minus(self._coordinate(i, axis), self._coordinate(j, axis))
            for axis in range(self.problem.dimension)
        ]

    def _is_constant(self, point: int) -> bool:
        return not any((point, axis) in self._unknowns for axis in range(self.problem.dimension))

    def _equations(self) -> list[tuple[Expression, Any]]:
        equations = []
        for i, j in measured_pairs(self.problem):
            if self._is_constant(i) and self._is_constant(j):
                continue
            squared = None
            for difference in self._edge(i, j):
                if difference is not None:
                    squared = plus(squared, codac.sqr(difference))
            equations.append((squared, self._range(i, j)))
        return equations

    def _range(self, i: int, j: int) -> Any:
        return codac.Interval(self.problem.lower[i, j], self.problem.upper[i, j])

    def _linear_equations(self) -> list[tuple[Expression, Any]]:
        """Return |p - a|^2 - |p - b|^2 = 2 p (b - a) + |a|^2 - |b|^2 for constant a, b."""
        measured = np.isfinite(self.problem.upper)
        equations = []
        for a, b in combinations(self.frame, 2):
            for p in range(self.problem.n_points):
                if self._is_constant(p) or not (measured[p, a] and measured[p, b]):
                    continue
                total, value = None, self._range(p, a) - self._range(p, b)
                for axis, difference in enumerate(self._edge(b, a)):
                    if difference is not None:
                        term = (2.0 * difference) * self._coordinate(p, axis)
                        total = plus(total, term)
                    for point, sign in ((a, -1.0), (b, 1.0)):
                        if (point, axis) in self._constants:
                            value = value + sign * codac.sqr(self._constants[point, axis])
                equations.append((total, value))
        return equations

    def _signed_volume(self, first: int, *others: int) -> Expression:
        return determinant([self._edge(point, first) for point in others])

    def _products(self) -> list[tuple[Expression, Any]]:
        half_lines = _half_lines()
        return [
            (
                self._signed_volume(*side.face, side.first)
                * self._signed_volume(*side.face, side.second),
                half_lines[-int(side.side)],
            )
            for side in self.problem.sides
            if side.side
        ]

    def _signs(self) -> list[tuple[Expression, Any]]:
        half_lines = _half_lines()
        equations = []
        for simplex, sign in signs_of(self.problem.sides).items():
            volume = self._signed_volume(*simplex)
            if not isinstance(volume, codac.Interval):
                equations.append((volume, half_lines[sign]))
        return equations

    def _inverse(self, equations: Sequence[tuple[Expression, Any]]) -> Any:
        expressions, values = zip(*equations, strict=True)
        function = codac.AnalyticFunction([self._x], codac.vec(*expressions))
        return codac.CtcInverse(function, codac.IntervalVector(list(values)))

    def _contractor(self, formulation: Formulation) -> Any:
        equations = self._equations()
        groups = [
            equations[start : start + LONGEST_VECTOR]
            for start in range(0, len(equations), LONGEST_VECTOR)
        ]
        if formulation.spare_last and len(groups) == 1 and len(equations) == len(self._unknowns):
            groups = [equations[:-1], equations[-1:]]
        if formulation.linear:
            groups.insert(0, self._linear_equations())
        sides = self._products() if formulation.products else self._signs()
        groups += [[equation] for equation in sides]
        contractor = None
        for group in groups:
            part = self._inverse(group)
            contractor = part if contractor is None else contractor & part
        if formulation.fixpoint:
            return codac.CtcFixpoint(contractor, FIXPOINT_RATIO)
        return contractor

    def _first_box(self, with_sides: bool) -> Any:
        """Return a box in which the fleet lies whatever its shape, without the mirror images."""
        measured = np.isfinite(self.problem.upper)
        reach = float(np.sqrt(self.problem.upper[measured]).sum() / 2.0)
        box = codac.IntervalVector([[-reach, reach]] * len(self._unknowns))
        for place, point in enumerate(self.frame[1:]):
            if (point, place) in self._unknowns:
                box[self._unknowns[point, place]] = codac.Interval(0.0, reach)
        for apex, sign in self._apexes(with_sides).items():
            number = self._unknowns[apex, self.problem.dimension - 1]
            box[number] = codac.Interval(0.0, reach) if sign > 0 else codac.Interval(-reach, 0.0)
        return box

    def _apexes(self, with_sides: bool) -> dict[int, int]:
        """Return the points on a known side of the frame, or one to fix the mirror image."""
        signs = signs_of(self.problem.sides) if with_sides else {}
        apexes = [p for p in range(self.problem.n_points) if p not in self.frame]
        if not signs:
            return {apexes[0]: 1}
        simplices = {apex: (*self.frame, apex) for apex in apexes}
        return {
            apex: signs[tuple(sorted(simplex))] * parity(simplex)
            for apex, simplex in simplices.items()
            if tuple(sorted(simplex)) in signs
        }

    def hull(self, boxes: Sequence[Any]) -> Hull:
        """Return the squared distances of all pairs over some boxes."""
        shape = (self.problem.n_points, self.problem.n_points)
        hull = Hull(np.full(shape, np.inf), np.zeros(shape))
        np.fill_diagonal(hull.lower, 0.0)
        for box in boxes:
            for i, j in combinations(range(self.problem.n_points), 2):
                squared = codac.Interval(0.0)
                for axis in range(self.problem.dimension):
                    one, other = self._value(box, i, axis), self._value(box, j, axis)
                    squared = squared + codac.sqr(one - other)
                squared = squared & self._range(i, j)
                hull.lower[i, j] = hull.lower[j, i] = min(hull.lower[i, j], squared.lb())
                hull.upper[i, j] = hull.upper[j, i] = max(hull.upper[i, j], squared.ub())
        return hull

    def _value(self, box: Any, point: int, axis: int) -> Any:
        if (point, axis) in self._unknowns:
            return box[self._unknowns[point, axis]]
        return self._constants.get((point, axis), codac.Interval(0.0))


@dataclass(frozen=True)
class Paving:
    """The boxes a search kept, None when it ran out of time, and its effort."""

    kept: list[Any] | None
    processed: int
    empty: int


def pave(model: Model, resolution: float, max_seconds: float) -> Paving:
    """Contract and bisect until all coordinates are known to `resolution` in m."""
    deadline = time.perf_counter() + max_seconds
    # ``contract`` works in place: the model keeps its box.
    pending, kept = [codac.IntervalVector(model.box)], []
    processed = empty = 0
    while pending:
        if time.perf_counter() > deadline:
            return Paving(None, processed, empty)
        processed += 1
        box = model.contractor.contract(pending.pop())
        if box.is_empty():
            empty += 1
        elif box.max_diam() <= resolution:
            kept.append(box)
        else:
            pending.extend(box.bisect_largest())
    return Paving(kept, processed, empty)


def components(boxes: Sequence[Any]) -> list[list[Any]]:
    """Group boxes that touch."""
    left, groups = list(boxes), []
    while left:
        group = [left.pop()]
        for member in group:
            group += [other for other in left if other.intersects(member)]
            left = [other for other in left if not other.intersects(member)]
        groups.append(group)
    return groups


def formulations(case: Case) -> list[Formulation]:
    """Return the formulations worth showing for a case."""
    if case.name in ('fleet', 'fleet-sides'):
        return [
            Formulation('codac', spare_last=False),
            Formulation(
                'codac, plain: frame P2 P1, sides as products',
                spare_last=False,
                frame=(1, 0),
                products=True,
            ),
        ]
    if not case.name.startswith('octahedral'):
        return [Formulation('codac', spare_last=False)]
    shown = [
        Formulation('codac, 8 + 1 equations'),
        Formulation('codac, 8 + 1 and linear', linear=True),
        Formulation('codac, 8 + 1 and linear, no fixpoint', linear=True, fixpoint=False),
    ]
    if not case.problem.sides:
        shown.insert(0, Formulation('codac, default', spare_last=False))
    return shown


def rows(case: Case, effort: Effort) -> Iterator[Row]:
    """Solve a case with each formulation."""
    global codac
    codac = importlib.import_module('codac')
    resolution = attainable_resolution(case)
    for formulation in formulations(case):
        model = Model(case.problem, formulation)
        paving, timing = measure(partial(pave, model, resolution, effort.others), effort)
        if paving.kept is None:
            remark = f'none in {effort.others:g} s'
            yield Row(formulation.label, boxes=paving.processed, remark=remark)
            continue
        groups = components(paving.kept)
        yield Row(
            formulation.label,
            timing,
            paving.processed,
            paving.empty,
            len(groups),
            score(case, [model.hull(group) for group in groups]),
            f'to {resolution:.3g} m',
        )
