# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Lists in texts for users."""

from collections.abc import Iterable

# Texts list the first few only; reports and topics hold everything.
LISTED = 8


def listed(texts: Iterable[object]) -> str:
    """Return the first of some texts, and the number of the others."""
    first = [*map(str, texts)]
    more = len(first) - LISTED
    return f'{", ".join(first[:LISTED])}{f" and {more} more" if more > 0 else ""}'
