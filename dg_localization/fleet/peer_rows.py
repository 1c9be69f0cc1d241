# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What one robot measured of others at one time: rows of a target, and its distance or a ray."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from typing import TypeAlias

from numpy.typing import ArrayLike

from dg_localization.fleet.error_models import quoted
from dg_localization.fleet.vocabulary import Rejection, RejectionReason

PeerMeasurement: TypeAlias = tuple[str, float | ArrayLike]
"""The target, and its distance in m or the ray to it."""

_NO_ROWS = (str, bytes, Mapping)
_NO_PAIR = (str, bytes, Mapping, Set)
"""What has members that could be taken for rows, or for a target and a value."""


def read_rows(
    readings: Iterable[PeerMeasurement],
) -> tuple[list[PeerMeasurement], Rejection | None]:
    """Return the rows of peers up to where they cannot be read, and why they cannot, if so."""
    rows: list[PeerMeasurement] = []
    try:
        for row in () if isinstance(readings, _NO_ROWS) else readings:
            rows.append(row)
    except Exception as error:  # whatever the iterable raises while it is read
        why = f'cannot be read ({quoted(error)})'
    else:
        if not isinstance(readings, _NO_ROWS):
            return rows, None
        why = 'are not allowed'
    text = (
        f'peers {quoted(readings)} {why}, they must be pairs of a target, and its distance in m '
        'or the ray to it'
    )
    return rows, Rejection(RejectionReason.INVALID_PEER, text)


def read_row(row: PeerMeasurement) -> PeerMeasurement | Rejection:
    """Return the name of a target, and its distance or the ray to it, or why there are none."""
    try:
        target, value = () if isinstance(row, _NO_PAIR) else row
        return str(target), value
    except Exception:  # whatever the row raises while it is read
        text = (
            f'peer {quoted(row)} is not allowed, it must be a target, and its distance in m or '
            'the ray to it'
        )
        return Rejection(RejectionReason.INVALID_PEER, text)
