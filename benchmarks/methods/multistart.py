# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Least squares from random starts (scipy): fast, but nothing tells when all has been found.

The residual of a pair is how far its distance lies outside its range.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
import time

import numpy as np
from scipy.optimize import least_squares

from benchmarks.cases import Case
from benchmarks.contest import Effort, Row, Score, attainable_resolution, measure
from benchmarks.exact import measured_pairs, unknown_pairs
from benchmarks.problems import FloatArray, squared_distances

NAME = 'multistart'
STARTS = 50
AGREES_M = 1e-6


def missing() -> str | None:
    """Say what is missing, if anything."""
    return None


def descend(case: Case, start: FloatArray) -> FloatArray | None:
    """Return the placement a start leads to, None when it does not agree with the ranges."""
    first, second = np.array(measured_pairs(case.problem)).T
    low = np.sqrt(case.problem.lower[first, second])
    high = np.sqrt(case.problem.upper[first, second])
    rows_ = np.arange(len(first))

    def residuals(flat: FloatArray) -> FloatArray:
        positions = flat.reshape(start.shape)
        lengths = np.linalg.norm(positions[first] - positions[second], axis=1)
        return lengths - np.clip(lengths, low, high)

    def jacobian(flat: FloatArray) -> FloatArray:
        positions = flat.reshape(start.shape)
        edges = positions[first] - positions[second]
        lengths = np.linalg.norm(edges, axis=1)
        directions = edges / np.maximum(lengths, 1e-12)[:, None]
        directions[(lengths > low) & (lengths < high)] = 0.0
        derivative = np.zeros((len(first), *start.shape))
        derivative[rows_, first] = directions
        derivative[rows_, second] = -directions
        return derivative.reshape(len(first), -1)

    end = least_squares(residuals, start.ravel(), jacobian, max_nfev=200, xtol=1e-14).x
    return end.reshape(start.shape) if np.abs(residuals(end)).max() < AGREES_M else None


def rows(case: Case, effort: Effort) -> Iterator[Row]:
    """Descend from random starts; a known placement is found when an end lies near it."""
    seeds = count()
    tolerance = attainable_resolution(case)
    pairs = tuple(np.array(unknown_pairs(case.problem)).T)
    known = [np.sqrt(squared_distances(placement)[pairs]) for placement in case.placements]
    measured = np.isfinite(case.problem.upper)
    edge = float(np.sqrt(case.problem.upper[measured]).max()) * case.problem.n_points ** (
        1.0 / case.problem.dimension
    )

    numbers: list[int] = []

    def batch() -> tuple[int, int]:
        random = np.random.default_rng(next(seeds))
        deadline = time.perf_counter() + effort.measuring
        found: set[int] = set()
        started = agreeing = 0
        while started < STARTS and time.perf_counter() < deadline:
            started += 1
            end = descend(case, random.uniform(0.0, edge, case.placements[0].shape))
            if end is None:
                continue
            agreeing += 1
            errors = [np.abs(np.sqrt(squared_distances(end)[pairs]) - d).max() for d in known]
            if min(errors) <= tolerance:
                found.add(int(np.argmin(errors)))
        numbers.append(len(found))
        return started, agreeing

    (started, agreeing), timing = measure(batch, effort)
    worst = min(numbers)
    remark = f'{worst} to {max(numbers)} found; {agreeing} starts agree with the ranges; no proof'
    yield Row(f'least squares, {started} starts', timing, score=Score(worst), remark=remark)
