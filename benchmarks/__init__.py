# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
How fast, how complete and how tight the solver is, next to others in the same run.

``problems``: data with known placements. ``cases``: who is asked for what, and the targets.
``exact``: what widths are measured against. ``contest``: times and scores a method.
``methods``: the other methods, each optional. ``startup``: import, compilation, and the kernels
without numba. ``truth``: the stored hulls. ``report``: tables and verdicts. Run with
``python -m benchmarks``.
"""

import os

# Targets are for one core, and threads that compete for it would slow the others down most.
for _library in ('OMP', 'OPENBLAS', 'MKL'):
    os.environ.setdefault(f'{_library}_NUM_THREADS', '1')
