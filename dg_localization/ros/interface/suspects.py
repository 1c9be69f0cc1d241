# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Whom contradictions make suspect, in words for the diagnostics."""

from collections.abc import Iterator, Sequence

from dg_localization.fleet import Estimate, Suspect

LISTED = 8
"""The diagnostics show a person the first few."""

LEAST_COUNT = 3
LEAST_SHARE = 0.5
"""A sensor that was among the suspects so often, and in such a share of them, is named."""


def suspect_values(estimate: Estimate) -> dict[str, str]:
    """Return who is suspected now, and who was lately."""
    values = {}
    if estimate.suspects:
        values['suspects'] = _listed(estimate.suspects)
    if estimate.suspects_in_window:
        values['suspects_in_window'] = _listed(estimate.suspects_in_window)
    for number, offender in enumerate(estimate.offenders[:LISTED]):
        values[f'offender_{number}'] = str(offender)
    return values


def _listed(suspects: Sequence[Suspect]) -> str:
    """Return the first names of some, and how many there are besides."""
    more = len(suspects) - LISTED
    names = ', '.join(map(str, suspects[:LISTED]))
    return f'{names} and {more} more' if more > 0 else names


def doubts_of_sensors(estimate: Estimate | None) -> Iterator[str]:
    """Yield which sensors were among the suspects in most contradictions lately."""
    for offender in () if estimate is None else estimate.offenders[:LISTED]:
        often = offender.count >= LEAST_COUNT
        if often and offender.count >= LEAST_SHARE * offender.contradictions:
            yield str(offender)
