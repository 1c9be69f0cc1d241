"""The solver's front door."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import time

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.problem import Chirality, Problem
from dg_localization.solver.result import Result, Statistics, Verdict


@default_environment()
def solve(
    problem: Problem,
    options: SolverOptions | None = None,
    cancel: Cancel | None = None,
    progress: Callable[[Statistics], None] | None = None,
) -> Result:
    """
    Return every placement that agrees with a problem, or the proof that there is none.

    Parameters
    ----------
    problem : Problem
        Interval distances, sides and chiralities.
    options : SolverOptions, optional
        Resolution and limits.
    cancel : object with ``is_set()``, optional
        Stops the search when set; what was not examined is part of the answer.
    progress : callable, optional
        Called with the statistics so far after every box.

    Returns
    -------
    Result
        The verdict, the hypotheses that hold every placement, and the effort. With
        ``Verdict.INFEASIBLE`` there is no hypothesis, and none was missed.

    Notes
    -----
    The first call in a process loads the kernels; the first on a machine compiles them. Neither
    counts as time of the search. See `load_kernels`. Without numba nothing is compiled, and the
    kernels run in Python. The floating-point environment of the thread
    is the default one during the call, whatever it was before.

    """
    # The kernels import numba, which takes longer than the rest of the package together.
    from dg_localization.solver.place.hypotheses import hypotheses_of
    from dg_localization.solver.search.search import search

    load_kernels()
    cover, statistics = search(problem, options or SolverOptions(), cancel, progress)
    hypotheses = hypotheses_of(problem, cover.kept + cover.pending)
    if cover.pending:
        verdict = Verdict.OUT_OF_BUDGET
    elif hypotheses:
        verdict = Verdict.COVERED
    else:
        verdict = Verdict.INFEASIBLE
    return Result(verdict, hypotheses, statistics)


@cache
@default_environment()
def load_kernels() -> float:
    """
    Load the compiled kernels, or compile them the first time on a machine (most of a minute).

    `solve` does so when it has to; a program that must answer in time calls this first. Without
    numba there is nothing to load.

    Returns
    -------
    float
        How long it took, in seconds.

    See Also
    --------
    dg_localization.fleet.warm_up : loads the kernels of the fleet as well.

    """
    from dg_localization.interval.kernels import COMPILED
    from dg_localization.solver.place.hypotheses import hypotheses_of
    from dg_localization.solver.search.search import search

    start = time.perf_counter()
    if not COMPILED:
        return 0.0
    # A flexible chain with a handedness, two of them to compare, and a point that nobody knows.
    upper = np.full((4, 4), np.inf)
    upper[[0, 1, 0, 2, 1, 2], [1, 0, 2, 0, 2, 1]] = 1.0
    np.fill_diagonal(upper, 0.0)
    lower = np.where(np.isfinite(upper), 0.9 * upper, 0.0)
    chiralities = (Chirality((0, 1, 2), 1), Chirality((0, 1, 3), 1))
    problem = Problem(lower, upper, 2, chiralities=chiralities)
    cover, _ = search(problem, SolverOptions(max_boxes=4))
    hypotheses_of(problem, cover.kept + cover.pending)
    return time.perf_counter() - start
