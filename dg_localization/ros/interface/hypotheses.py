# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Hypotheses in the diagnostics, under the numbers that they keep while they live."""

from collections.abc import Iterable, Sequence

import numpy as np

from dg_localization.fleet import Placement

# The topics hold every placement; the diagnostics show a person the first few.
LISTED_HYPOTHESES = 8


def hypothesis_values(placements: Sequence[Placement]) -> dict[str, str]:
    """Return the numbers of all hypotheses, in the order of their poses, and what they are."""
    values = {
        'hypothesis_numbers': _numbers(placements),
        'proved_numbers': _numbers(placement for placement in placements if placement.proved),
    }
    for placement in placements[:LISTED_HYPOTHESES]:
        proof = 'proved' if placement.proved else 'not proved'
        width = 'not bounded'
        if np.isfinite(placement.enclosure_m).all():
            width = f'{np.ptp(placement.enclosure_m, axis=1).max():.2f} m wide'
        values[f'hypothesis_{placement.number}'] = f'{proof}, {width}'
    return values


def robot_values(placements: Sequence[Placement], row: int) -> dict[str, str]:
    """Return where the first hypotheses have one robot."""
    values = {}
    for placement in placements[:LISTED_HYPOTHESES]:
        position = ' '.join(f'{x:.3f}' for x in placement.positions_m[row])
        width = ' '.join(f'{x:.3f}' for x in np.ptp(placement.enclosure_m[row], axis=0))
        text = f'at {position} m, enclosure {width} m wide'
        values[f'hypothesis_{placement.number}'] = text
    return values


def _numbers(placements: Iterable[Placement]) -> str:
    return ' '.join(str(placement.number) for placement in placements)
