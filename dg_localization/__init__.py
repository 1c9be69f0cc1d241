# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Every placement of a robot fleet that agrees with interval distances and bearings.

The solver's interface is here; it needs neither ROS nor a first guess. See `solve`.
"""

import dg_localization.blas  # noqa: F401 (before NumPy)
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.problem import (
    Chirality,
    InvalidProblemError,
    Problem,
    Side,
    SideConstraint,
)
from dg_localization.solver.result import (
    Hypothesis,
    Joint,
    JointKind,
    Piece,
    Result,
    Statistics,
    Verdict,
)
from dg_localization.solver.solve import solve

__all__ = [
    'Cancel',
    'Chirality',
    'Hypothesis',
    'InvalidProblemError',
    'Joint',
    'JointKind',
    'Piece',
    'Problem',
    'Result',
    'Side',
    'SideConstraint',
    'SolverOptions',
    'Statistics',
    'Verdict',
    'solve',
]
