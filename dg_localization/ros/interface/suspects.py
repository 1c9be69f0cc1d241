# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Whom contradictions make suspect, in words for the diagnostics."""

from collections.abc import Iterator

from dg_localization.fleet import Estimate

LISTED = 8
"""The diagnostics show a person the first few."""

LEAST_COUNT = 3
LEAST_SHARE = 0.5
"""A sensor that was among the suspects so often, and in such a share of them, is named."""


def suspect_values(estimate: Estimate) -> dict[str, str]:
    """Return who is suspected now, and who was lately."""
    values = {}
    if estimate.suspects:
        more = len(estimate.suspects) - LISTED
        names = [str(suspect) for suspect in estimate.suspects[:LISTED]]
        values['suspects'] = ', '.join(names) + (f' and {more} more' if more > 0 else '')
    for number, offender in enumerate(estimate.offenders[:LISTED]):
        values[f'offender_{number}'] = str(offender)
    return values


def doubts_of_sensors(estimate: Estimate | None) -> Iterator[str]:
    """Yield which sensors were among the suspects in most contradictions lately."""
    for offender in () if estimate is None else estimate.offenders[:LISTED]:
        often = offender.count >= LEAST_COUNT
        if often and offender.count >= LEAST_SHARE * offender.contradictions:
            yield str(offender)
