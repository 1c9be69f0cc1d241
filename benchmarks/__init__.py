"""
How fast, how complete and how tight the solver is, next to others in the same run.

``problems``: the cases with their known placements and targets. ``exact``: what widths are
measured against. ``peers``: the other methods, each optional. ``contest``: runs a case.
``startup``: import, compilation and the kernels without numba. ``truth``: the stored hulls.
``report``: tables and verdicts.
Run with ``python -m benchmarks``.
"""
