# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the diagnostics are made from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
import math

from dg_localization.fleet import Estimate, InputState, LinkKey
from dg_localization.ros.interface.links import Link

# What a sensor or a stranger sends may be quoted, and diagnostics are recorded for days.
MOST_CHARACTERS = 300


def shortened(text: str) -> str:
    """Return a text that quotes others, cut to a length that people read."""
    return text if len(text) <= MOST_CHARACTERS else f'{text[: MOST_CHARACTERS - 4]} ...'


def listed(texts: list[str], most: int) -> str:
    """Return the first of some texts, and how many there are besides."""
    more = len(texts) - most
    return f'{", ".join(texts[:most])}{f" and {more} more" if more > 0 else ""}'


@dataclass(frozen=True)
class Malformed:
    """How many messages of a topic could not be read, what was wrong with the last, and when."""

    count: int
    last: str
    last_s: float = -math.inf


NONE_MALFORMED = Malformed(0, '')


@dataclass(frozen=True)
class Report:
    """
    Everything that the diagnostics are made from.

    Attributes
    ----------
    node : str
        Full name of the node; all statuses begin with it.
    trouble : str
        Why there can be no estimate, such as that the node is inactive; empty when there can.
    failure : str
        What went wrong inside when the last estimate failed; empty when none did.
    warnings : tuple of str
        What an operator must know whatever the estimate is.
    now_s : float
        The time of the diagnostics.
    lifetime_s : float
        How old an estimate may become before it is late.
    estimate : Estimate or None
        The newest one.
    robots : tuple of str
        The fleet.
    links : tuple of Link
        The inputs the node listens to.
    inputs : mapping of LinkKey to InputState
        What has arrived.
    malformed : mapping of str to Malformed
        By topic, the messages that could not be read.
    wrong_types : mapping of Link to tuple of str
        Inputs whose topic has endpoints of other types, with these types.
    rejecting : mapping of LinkKey to str
        Inputs that have rejected most of their readings lately, with a sentence on why.
    wanted_rate_hz : float
        How often the fleet is to be localized.
    rate_hz : float or None
        How often it has been localized lately; None while that is not known.
    localized_width_m : float
        A fleet with a wider enclosure is not called localized.
    seconds : mapping of str to float
        What the parts of the last answer took.

    """

    node: str
    trouble: str
    failure: str
    warnings: tuple[str, ...]
    now_s: float
    lifetime_s: float
    estimate: Estimate | None
    robots: tuple[str, ...]
    links: tuple[Link, ...]
    inputs: Mapping[LinkKey, InputState]
    malformed: Mapping[str, Malformed]
    wrong_types: Mapping[Link, tuple[str, ...]]
    rejecting: Mapping[LinkKey, str] = field(default_factory=dict)
    wanted_rate_hz: float = 0.0
    rate_hz: float | None = None
    localized_width_m: float = math.inf
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def late(self) -> str:
        """Why the estimate is too old to be relied on; empty when it is not."""
        if self.estimate is None or self.now_s - self.estimate.stamp_s <= self.lifetime_s:
            return ''
        age_s = self.now_s - self.estimate.stamp_s
        return f'late: the last answer is {age_s:.1f} s old, more than {self.lifetime_s:.1f} s'


def robots_of(key: LinkKey) -> set[str]:
    """Return the ends of a link; for a sensor, the robot that it is on."""
    return {name.partition('/')[0] for name in (key.observer, key.target)}
