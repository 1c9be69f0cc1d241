# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Whether the hulls computed here agree with those stored beside the project."""

from __future__ import annotations

from collections.abc import Iterator
import json

import numpy as np

from benchmarks.contest import Figure
from benchmarks.exact import exact_hull, unknown_pairs
from benchmarks.problems import DATA, fleet, fleet_placements

STORED = DATA.parent / 'truth' / 'fleet.json'
TOLERANCE_M2 = 1e-6


def figures() -> Iterator[Figure]:
    """Compare the exact hulls of the paper's fleet; nothing where there are none stored."""
    if not STORED.exists():
        return
    problem = fleet()
    pairs = unknown_pairs(problem)
    difference = 0.0
    for placement, solution in zip(
        fleet_placements(), json.loads(STORED.read_text())['solutions'], strict=True
    ):
        stored = np.array([solution['hull'][f's{i + 1}{j + 1}'] for i, j in pairs])
        computed = exact_hull(problem, placement, pairs)
        difference = max(difference, float(np.abs(computed - stored).max()))
    yield Figure(
        "exact hulls of the paper's fleet against the stored ones",
        f'{difference:.1e} m^2 apart',
        f'{TOLERANCE_M2:g} m^2',
        difference <= TOLERANCE_M2,
    )
