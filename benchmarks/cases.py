# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The cases: a problem, what is known of it, who is asked, and what is aimed at."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.problems import (
    CONVEX,
    OCTAHEDRAL_SIDES,
    FloatArray,
    dietmaier,
    dietmaier_file,
    fleet,
    fleet_placements,
    octahedral,
    octahedral_placements,
    random_fleet,
)
from dg_localization import Problem


@dataclass(frozen=True)
class Target:
    """What is aimed at; None where nothing is."""

    seconds: float | None = None
    boxes: int | None = None
    empty: int | None = None
    hypotheses: int | None = None
    width: float | None = None
    """Largest width of an unknown pair as a multiple of the reference width."""
    speedup: float | None = None
    """Against the fastest Codac formulation that found everything."""


@dataclass(frozen=True, eq=False)
class Case:
    """
    One problem.

    Attributes
    ----------
    name, title : str
        For the command line, and for people.
    problem : Problem
        The data.
    placements : tuple of ndarray, shape (n, q)
        The placements an answer has to contain, in m; mirror images are left out.
    resolution : float
        In m, for the solver and the other methods.
    tighten_seconds : float
        Until when the solver narrows finished boxes by linear programs, in s.
    hull : {'exact', 'linearized', None}
        What the widths are compared with.
    others : tuple of str
        Who else is asked.
    target : Target
        What is aimed at.
    max_seconds : float
        Limit for the solver.
    max_boxes : int
        Limit for the solver.
    quick : bool
        Whether it belongs to the short run.

    """

    name: str
    title: str
    problem: Problem
    placements: tuple[FloatArray, ...]
    target: Target
    resolution: float = 0.05
    tighten_seconds: float = 0.0
    hull: str | None = None
    others: tuple[str, ...] = ()
    max_seconds: float = 30.0
    max_boxes: int = 20000
    quick: bool = True


RANDOM_TARGETS = {
    (2, 10): Target(seconds=2e-3, width=1.1),
    (2, 20): Target(seconds=10e-3, width=1.1),
    (2, 50): Target(seconds=100e-3, width=1.1),
    (2, 100): Target(seconds=0.5),
    (3, 6): Target(seconds=5e-3),
    (3, 10): Target(seconds=30e-3),
    (3, 20): Target(seconds=300e-3),
}


def _random_case(n_points: int, dimension: int, relative_error: float, seed: int) -> Case:
    problem, positions = random_fleet(n_points, dimension, relative_error, seed)
    percent = f'{100.0 * relative_error:g}'
    n_ranges = np.isfinite(problem.upper[np.triu_indices(n_points, 1)]).sum()
    target = RANDOM_TARGETS[dimension, n_points]
    return Case(
        name=f'random{dimension}d-n{n_points}-{percent}pc-s{seed}',
        title=f'random {dimension}D fleet, n = {n_points}, {n_ranges} ranges to {percent} %, '
        f'seed {seed}',
        problem=problem,
        placements=(positions,),
        target=target,
        hull='linearized',
        others=('codac', 'multistart') if n_points <= 50 else (),
        quick=n_points <= 10,
    )


def _fleet_cases() -> Iterator[Case]:
    placements = fleet_placements()
    others = ('codac', 'multistart', 'mds')
    yield Case(
        name='fleet',
        title="paper's fleet, no sides",
        problem=fleet(),
        placements=placements,
        target=Target(seconds=1e-3, boxes=15, empty=0, hypotheses=8, speedup=30.0),
        hull='exact',
        others=others,
    )
    yield Case(
        name='fleet-sides',
        title="paper's fleet, three sides, one pass",
        problem=fleet(sides=True),
        placements=placements[:1],
        target=Target(seconds=0.15e-3, boxes=1, hypotheses=1, speedup=60.0),
        hull='exact',
        others=('codac', 'scip'),
    )
    yield Case(
        name='fleet-sides-tight',
        title="paper's fleet, three sides, tightened",
        problem=fleet(sides=True),
        placements=placements[:1],
        target=Target(seconds=5e-3, hypotheses=1, width=1.02),
        tighten_seconds=np.inf,
        hull='exact',
    )
    for percent in (1, 3, 5):
        yield Case(
            name=f'fleet-{percent}pc',
            title=f"paper's fleet, ranges to {percent} %, no sides, tightened",
            problem=fleet(percent / 100.0),
            placements=placements,
            target=Target(boxes=31, hypotheses=8, width=1.5 if percent == 3 else None),
            tighten_seconds=np.inf,
            hull='exact',
            others=('codac',) if percent == 3 else (),
            quick=percent == 3,
        )
        yield Case(
            name=f'fleet-sides-{percent}pc',
            title=f"paper's fleet, ranges to {percent} %, three sides, tightened",
            problem=fleet(percent / 100.0, sides=True),
            placements=placements[:1],
            target=Target(boxes=31, hypotheses=1, width=1.5 if percent == 3 else None),
            tighten_seconds=np.inf,
            hull='exact',
            others=('codac', 'scip') if percent == 3 else (),
            quick=percent == 3,
        )


def _octahedral_cases() -> Iterator[Case]:
    placements = octahedral_placements()
    for name, sides, kept, target in (
        (
            '',
            (),
            range(6),
            Target(seconds=12e-3, boxes=15, empty=2, hypotheses=6, speedup=100.0),
        ),
        ('sides', OCTAHEDRAL_SIDES, (1, 3), Target(boxes=5, hypotheses=2)),
        ('convex', (*OCTAHEDRAL_SIDES, CONVEX), (3,), Target(boxes=3, hypotheses=1)),
    ):
        yield Case(
            name=f'octahedral-{name}' if name else 'octahedral',
            title=f'octahedral manipulator, {len(sides) or "no"} sides',
            problem=octahedral(sides),
            placements=tuple(placements[number] for number in kept),
            target=target,
            resolution=1e-3,
            others=('codac',) if sides else ('codac', 'multistart'),
        )


def _random_cases() -> Iterator[Case]:
    for dimension, n_points, relative_error, seeds in (
        (2, 10, 0.03, (0, 1)),
        (2, 10, 0.001, (0,)),
        (2, 20, 0.03, (0,)),
        (2, 50, 0.03, (0,)),
        (2, 50, 0.001, (0,)),
        (2, 100, 0.03, (0,)),
        (2, 100, 0.001, (0,)),
        (3, 6, 0.01, (0, 1)),
        (3, 10, 0.01, (0,)),
        (3, 20, 0.01, (0,)),
    ):
        for seed in seeds:
            yield _random_case(n_points, dimension, relative_error, seed)


def _dietmaier_cases() -> Iterator[Case]:
    if dietmaier_file().exists():
        problem, placements = dietmaier()
        yield Case(
            name='dietmaier',
            title="Dietmaier's platform, 12 points, 40 postures",
            problem=problem,
            placements=placements,
            target=Target(hypotheses=40),
            resolution=1e-3,
            max_seconds=60.0,
            quick=False,
        )


FAMILIES: tuple[Callable[[], Iterator[Case]], ...] = (
    _fleet_cases,
    _octahedral_cases,
    _random_cases,
    _dietmaier_cases,
)


def all_cases() -> list[Case]:
    """Return all cases, those whose data are missing left out."""
    return [case for family in FAMILIES for case in family()]
