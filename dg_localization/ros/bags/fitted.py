# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The bounds that were learned from a bag, group by group."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from dg_localization.calibration.bounds import vouched_share
from dg_localization.fleet import LinkKey, LinkKind, RangeErrorModel
from dg_localization.ros.interface.links import ANY_OBSERVER

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
Pair: TypeAlias = tuple[str, str]
"""Observer and target; an empty name stands for all."""

EVERYTHING: Pair = ('', '')
# The parameter of the likeliest error has this name for ranges and for bearings.
EXPECTED_ERROR, EXPECTED_ERROR_RELATIVE = 'expected_error', 'expected_error_relative'
# Fewer readings get the bounds of the next larger group.
LEAST_READINGS = 20


@dataclass(frozen=True)
class GroupFit:
    """
    The bounds of one group of readings.

    Attributes
    ----------
    count, excluded : int
        Its readings, and those that the bounds do not hold.
    seen : str
        What was seen, in words.
    bounds : dict of str to float
        By the name of the parameter without its prefix; with the likeliest error, where a truth
        shows it.
    share_of_rest : float, optional
        Of the readings of the second half of the recording, the share that bounds learned of the
        first half alone exclude; None where that was not tried.

    """

    count: int
    excluded: int
    seen: str
    bounds: dict[str, float]
    share_of_rest: float | None = None

    @property
    def text(self) -> str:
        """What was seen and what that is worth, in words."""
        share = 100.0 * self.excluded / self.count
        vouched = 100.0 * vouched_share(self.count)
        text = (
            f'{self.count} readings, {self.seen}; {share:.2f} % excluded; so many vouch for '
            f'{vouched:.1f} %'
        )
        if self.share_of_rest is None:
            return text
        rest = 100.0 * self.share_of_rest
        return f'{text}; learned of the first half alone, {rest:.2f} % of the second excluded'


@dataclass
class Fit:
    """
    What was learned from a bag.

    Attributes
    ----------
    ranges, bearings : dict of (str, str) to GroupFit
        By observer and target, those of a sensor with an empty target, of all with empty names.
    odometry : dict of str to float
        By the name of the parameter without its prefix; of all robots.
    robot_odometry : dict of str to dict of str to float
        The same by robot.
    judged : frozenset of LinkKey
        The inputs of ranges and bearings that had a reading to learn from.
    kept : frozenset of LinkKind
        Ranges, bearings, where no bounds become narrower than those stated.
    notes : list of str
        Sentences on what was learned, and what cannot be.

    """

    ranges: dict[Pair, GroupFit] = field(default_factory=dict)
    bearings: dict[Pair, GroupFit] = field(default_factory=dict)
    odometry: dict[str, float] = field(default_factory=dict)
    robot_odometry: dict[str, dict[str, float]] = field(default_factory=dict)
    judged: frozenset[LinkKey] = frozenset()
    kept: frozenset[LinkKind] = frozenset()
    notes: list[str] = field(default_factory=list)

    def group_of(self, kind: LinkKind, observer: str, target: str) -> GroupFit | None:
        """Return the smallest group of ranges or of bearings that a link belongs to."""
        groups = self._groups_of(kind)
        # Peers have no target, and the bounds of their observer.
        pairs = _groups((observer, target), 'link')
        return next((groups[pair] for pair in pairs if pair in groups), None)

    def of_all(self, kind: LinkKind) -> GroupFit | None:
        """Return the bounds of all ranges or of all bearings, if there are any."""
        return self._groups_of(kind).get(EVERYTHING)

    def _groups_of(self, kind: LinkKind) -> dict[Pair, GroupFit]:
        return self.ranges if kind is LinkKind.RANGE else self.bearings

    def is_judged(self, kind: LinkKind, observer: str, target: str) -> bool:
        """Return whether there was a range or a bearing of a link, or of its peers, to judge."""
        return any(
            key.kind is kind
            and observer in (key.observer, ANY_OBSERVER)
            and target in (key.target, '')
            for key in self.judged
        )


def _groups(pair: Pair, per: str) -> tuple[Pair, ...]:
    """Return the groups that a pair belongs to, the smallest first."""
    groups = (pair, (pair[0], ''), EVERYTHING)
    return groups[('link', 'sensor', 'all').index(per) :]


def gathered(
    columns: Mapping[LinkKey, Sequence[FloatArray]], per: str
) -> dict[Pair, list[FloatArray]]:
    """Join the columns of all members of each group that is large enough."""
    members: dict[Pair, list[Sequence[FloatArray]]] = defaultdict(list)
    for key, arrays in columns.items():
        for group in _groups((key.observer, key.target), per):
            members[group].append(arrays)
    joined = {
        group: [np.concatenate(column) for column in zip(*found, strict=True)]
        for group, found in members.items()
    }
    return {
        group: arrays
        for group, arrays in joined.items()
        if len(arrays[0]) >= (1 if group == EVERYTHING else LEAST_READINGS)
    }


def with_readings(columns: Mapping[LinkKey, Sequence[FloatArray]]) -> frozenset[LinkKey]:
    """Return the inputs that have a reading in their columns."""
    return frozenset(key for key, arrays in columns.items() if len(arrays[0]))


def range_parameters(model: RangeErrorModel) -> dict[str, float]:
    """Return bounds by the names of the parameters of the node."""
    return {
        'min_error': model.min_error_m,
        'max_error': model.max_error_m,
        'min_error_relative': model.min_error_relative,
        'max_error_relative': model.max_error_relative,
        'sigma_factor': model.sigma_factor,
    }
