"""The solver's front door."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Result, SolverOptions, Statistics, Verdict

if TYPE_CHECKING:
    from dg_localization.solver.search import Cancel


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
    The first call in a process loads the kernels; the first on a machine compiles them.

    """
    # The kernels import numba, which takes longer than the rest of the package together.
    from dg_localization.solver.hypotheses import hypotheses_of
    from dg_localization.solver.search import search

    cover = search(problem, options or SolverOptions(), cancel, progress)
    hypotheses = hypotheses_of(problem, cover.kept + cover.pending)
    if cover.pending:
        verdict = Verdict.OUT_OF_BUDGET
    elif hypotheses:
        verdict = Verdict.COVERED
    else:
        verdict = Verdict.INFEASIBLE
    return Result(verdict, hypotheses, cover.statistics)
