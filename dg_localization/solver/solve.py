# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The entry point of the solver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import cache
import math
import time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.interval.environment import default_environment
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.problem import (
    Chirality,
    InvalidProblemError,
    Problem,
    check_bounds,
)
from dg_localization.solver.result import Result, Statistics

FloatArray = NDArray[np.float64]


@default_environment()
def solve(
    problem: Problem,
    options: SolverOptions | None = None,
    cancel: Cancel | None = None,
    progress: Callable[[Statistics], None] | None = None,
    within: Sequence[tuple[ArrayLike, ArrayLike]] | None = None,
    executor: Executor | None = None,
) -> Result:
    """
    Return every placement that agrees with a problem, or a proof that there is none.

    Parameters
    ----------
    problem : Problem
        Interval distances, sides and chiralities.
    options : SolverOptions, optional
        Resolution and limits.
    cancel : object with ``is_set()``, optional
        Stops the search when set; boxes that were not examined stay in the answer.
    progress : callable, optional
        Called with the statistics so far after every box.
    within : sequence of (lower, upper), optional
        Boxes that are known to hold every placement of interest, such as boxes of an earlier
        answer: lower and upper bounds of all squared distances in m^2, shape (n, n) each.
    executor : concurrent.futures.Executor, optional
        Executor whose workers (threads, processes or machines) solve the independent parts of
        large fleets. The answer is the same, unless a time limit stops it. Tasks that run when the
        call is cancelled end when their own time is over.

    Returns
    -------
    Result
        The verdict, the pieces, the hypotheses that hold every placement, and the effort.
        ``Verdict.INFEASIBLE`` is a proof that there is no placement.

    Raises
    ------
    InvalidProblemError
        If a box of `within` is not of the shape of the problem.
    TypeError
        If `problem` is no Problem, or `options` are no SolverOptions.

    Notes
    -----
    The first call in a process loads the kernels; the first on a machine compiles them. Neither
    counts as time of the search. `dg_localization.fleet.warm_up` does both in advance and reports
    its progress. Without numba nothing is compiled, and the kernels run in Python. During the call
    the thread uses the default floating-point environment.

    """
    options = SolverOptions() if options is None else options
    for name, value, kind in (('problem', problem, Problem), ('options', options, SolverOptions)):
        if not isinstance(value, kind):
            raise TypeError(f'{name} must be of type {kind.__name__}, not {type(value).__name__}')
    # The kernels import numba, which takes longer than the rest of the package.
    from dg_localization.solver.assemble.answer import solve_in_pieces
    from dg_localization.solver.search.budget import Budget

    load_kernels()
    boxes = None if within is None else _boxes(problem, within)
    submit = None if executor is None else lambda *task: executor.submit(_with_kernels, *task)
    return solve_in_pieces(problem, Budget(options, cancel, progress, submit), boxes)


def _with_kernels(function: Callable[..., Any], *args: Any) -> Any:
    """Return the result of a function after the kernels are loaded."""
    load_kernels()
    return function(*args)


def _boxes(
    problem: Problem, within: Sequence[tuple[ArrayLike, ArrayLike]]
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the checked boxes of `within` as arrays."""
    boxes = []
    shape = (problem.n_points, problem.n_points)
    for x, box in enumerate(within):
        try:
            lower, upper = box
        except (TypeError, ValueError):
            text = f'within[{x}] is no pair of lower and upper bounds'
            raise InvalidProblemError(text) from None
        names = (f'within[{x}]: lower', f'within[{x}]: upper')
        lower, upper = check_bounds(lower, upper, names)
        for name, bound in zip(names, (lower, upper), strict=True):
            if bound.shape != shape or np.isnan(bound).any():
                raise InvalidProblemError(
                    f'{name} has shape {bound.shape}, numbers of shape {shape} are needed'
                )
        if (lower == np.inf).any():
            raise InvalidProblemError(f'{names[0]} is inf somewhere, a finite number is needed')
        if lower.diagonal().any() or upper.diagonal().any():
            raise InvalidProblemError(f'within[{x}] is not 0 everywhere on the diagonal')
        boxes.append((np.maximum(lower, lower.T), np.minimum(upper, upper.T)))
    return boxes


@cache
@default_environment()
def load_kernels() -> float:
    """
    Load the compiled kernels, or compile them the first time on a machine (about a minute).

    `solve` does so if needed; a program that must answer in time calls this first. Without numba
    there is nothing to load.

    Returns
    -------
    float
        The time taken, in seconds.

    See Also
    --------
    dg_localization.fleet.warm_up : loads the kernels of the fleet as well.

    """
    from dg_localization.interval.kernels import COMPILED
    from dg_localization.solver.assemble.answer import solve_in_pieces
    from dg_localization.solver.search.budget import Budget

    start = time.perf_counter()
    if not COMPILED:
        return 0.0
    options = SolverOptions(max_boxes=8, tighten_seconds=math.inf)
    problems = [_braced(3, 2, 2), _braced(9, 7)]
    for dimension in (2, 3):
        problems += [_joined_simplices(dimension, closed=closed) for closed in (False, True)]
        problems.append(_cross_polytope(dimension))
    for problem in problems:
        for hypothesis in solve_in_pieces(problem, Budget(options)).hypotheses:
            np.isfinite(hypothesis.upper)
            bool(hypothesis.proved)
    return time.perf_counter() - start


def _joined_simplices(dimension: int, closed: bool) -> Problem:
    """
    Return two simplices that share a face, and three further points.

    The first point is measured from a corner, the second not at all. The third is not measured
    either or, in a closed fleet, from both apexes, whose mutual distance is not measured.
    """
    n_points = dimension + 5
    apexes = (dimension, dimension + 1)
    upper = np.full((n_points, n_points), np.inf)
    upper[: dimension + 2, : dimension + 2] = 1.0
    upper[apexes], upper[apexes[::-1]] = np.inf, np.inf
    closing = [(corner, n_points - 1) for corner in (*apexes, 0)[:dimension]] if closed else []
    for first, second in ((0, n_points - 3), *closing):
        upper[first, second] = upper[second, first] = 1.0
    np.fill_diagonal(upper, 0.0)
    lower = np.where(np.isfinite(upper), 0.9 * upper, 0.0)
    face = tuple(range(dimension))
    chiralities = [Chirality((*face, apex), 1) for apex in apexes]
    return Problem(lower, upper, dimension, chiralities=chiralities)


def _cross_polytope(dimension: int) -> Problem:
    """Return a rigid piece with unmeasured pairs: opposite corners about a center."""
    corners = np.vstack([np.zeros(dimension), np.eye(dimension), -np.eye(dimension)])
    upper = 1.1 * ((corners[:, None] - corners[None]) ** 2).sum(axis=-1)
    lower = upper / 1.2
    upper[upper > 4.0], lower[lower > 3.0] = np.inf, 0.0
    return Problem(lower, upper, dimension)


def _braced(*shape: int) -> Problem:
    """Return a piece that is large enough for patches or, in space, to be placed by points."""
    corners = np.argwhere(np.ones(shape))
    squared = ((corners[:, None] - corners[None]) ** 2).sum(axis=-1)
    measured = squared < 2.5
    # In space a corner with few pairs keeps the piece from being solved in one box.
    measured[0, 3] = measured[3, 0] = False
    upper = np.where(measured, 1.02 * squared, np.inf)
    return Problem(np.where(measured, squared, 0.0), upper, len(shape))
