# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Why an estimate does not settle where the fleet is, in words for the diagnostics."""

from collections.abc import Iterable, Iterator

import numpy as np

from dg_localization.fleet import Estimate
from dg_localization.solver.result import Verdict

LISTED_ROBOTS = 8
"""So many are named; the others have statuses of their own."""


def doubts_of_fleet(estimate: Estimate, localized_width_m: float) -> Iterator[str]:
    """Yield why a fleet with placements is not called localized."""
    yield from doubts_of_width(estimate, range(len(estimate.robots)), localized_width_m)
    yield from _doubts_of_robots(estimate)
    yield from doubts_of_placements(estimate)
    yield from doubts_of_frame(estimate)


def _doubts_of_robots(estimate: Estimate) -> Iterator[str]:
    """Yield which robots are nowhere; those of groups are in frames of their own."""
    grouped = {robot for group in estimate.groups for robot in group.robots}
    bounded = [np.isfinite(one.enclosure_m).all(axis=(1, 2)) for one in estimate.placements]
    rows = np.flatnonzero(~np.all(bounded, axis=0))
    names = [estimate.robots[row] for row in rows if estimate.robots[row] not in grouped]
    if names:
        more = f' and {len(names) - LISTED_ROBOTS} more' if len(names) > LISTED_ROBOTS else ''
        yield f'not bounded: {", ".join(names[:LISTED_ROBOTS])}{more}'


def doubts_of_placements(estimate: Estimate) -> Iterator[str]:
    """Yield why the placements do not settle where the fleet is."""
    if any(placement.dropped for placement in estimate.placements):
        yield 'contradicting inputs dropped'
    if estimate.n_hypotheses > 1:
        yield f'ambiguous: {estimate.n_hypotheses} hypotheses'
    if any(placement.flexible for placement in estimate.placements):
        yield 'flexible: robots may be able to move without any measurement changing'
    if estimate.verdict is Verdict.OUT_OF_BUDGET:
        yield 'out of budget: the hypotheses hold every placement, but may be too many or too wide'
    for forgotten in estimate.forgotten:
        yield f'forgotten: {forgotten.text}'


def doubts_of_width(
    estimate: Estimate, rows: Iterable[int], localized_width_m: float
) -> Iterator[str]:
    """Yield that one hypothesis is left, but leaves much room to some robots."""
    if estimate.n_hypotheses != 1:
        return
    enclosures = estimate.placements[0].enclosure_m[list(rows)]
    # A robot that is not connected has a warning of its own.
    widths = [float(np.ptp(box, axis=0).max()) for box in enclosures if np.isfinite(box).all()]
    width_m = max(widths, default=0.0)
    if width_m > localized_width_m:
        yield f'one hypothesis, {width_m:.1f} m wide'


def doubts_of_frame(estimate: Estimate) -> Iterator[str]:
    """Yield why coordinates are not in the frame that was asked for, or in that of before."""
    if estimate.frame_change:
        yield estimate.frame_change
    if estimate.frame_doubt:
        yield estimate.frame_doubt
    if estimate.groups:
        yield f'{len(estimate.groups)} more in frames of their own'
