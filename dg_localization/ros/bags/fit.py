# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Error bounds from the readings of a bag, by a ground truth or by their scatter."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dg_localization.calibration.bounds import (
    READINGS,
    Choice,
    ErrorShape,
    fit_half_width_rad,
    fit_range,
    missing_m,
    range_holds,
    rounded_outward,
    shape_of,
)
from dg_localization.calibration.odometry import ALL, learn_odometry
from dg_localization.calibration.truth import range_errors_m
from dg_localization.fleet import LinkKey, LinkKind, SensorBounds
from dg_localization.ros.bags.bag import BagError
from dg_localization.ros.bags.offline import Recording
from dg_localization.ros.bags.samples import Errors, Gatherer, errors_of
from dg_localization.ros.bags.truth import apart_text
from dg_localization.ros.interface.links import ANY_OBSERVER
from dg_localization.ros.interface.parameters.table import fields_of

Pair: TypeAlias = tuple[str, str]
"""Observer and target; an empty name means all."""

EVERYTHING: Pair = ('', '')

Bounds: TypeAlias = dict[str, float]
"""Bounds by the name of the parameter without its prefix."""

GROUPS = ('link', 'sensor', 'all')
UNITS = {LinkKind.RANGE: 'm', LinkKind.BEARING: 'rad'}
# Readings of one link closer in time are reported together; at most `NAMED` times are reported.
GAP_S, NAMED = 1.0, 20
# The delays that can be found, the time over which the change of a distance is computed, and the
# share of the variance of the errors that a delay must explain.
DELAYS_S, STEP_S, EXPLAINED = (0.02, 1.0), 0.05, 0.5


# A bag does not show latencies, gaps and tilts of odometry, nor which readings are invalid.
NOT_LEARNED = {'latency', 'max_gap', 'restart_gap', 'tilt'}
NOT_LEARNED |= {'beyond_max_is_far', 'min_reading', 'max_reading'}


class GroupFit(NamedTuple):
    """
    The bounds of one group of readings.

    Attributes
    ----------
    bounds : Bounds
    excluded : int
        The number of its readings outside the bounds.
    text : str
        A summary of the errors, and of how well they support the bounds.

    """

    bounds: Bounds
    excluded: int
    text: str


@dataclass
class LearnedBounds:
    """
    Bounds learned from a bag.

    Attributes
    ----------
    groups : dict of LinkKind to dict of (str, str) to GroupFit
        Fits for ranges and bearings by observer and target: groups of a sensor have an empty
        target, groups of all have two empty names.
    odometry : Bounds
        Bounds for all robots.
    robot_odometry : dict of str to Bounds
        Bounds by robot.
    judged : frozenset of LinkKey
        The inputs of ranges and bearings that had a reading to learn from.
    is_widened : bool
        Whether bounds are only widened, never narrowed.
    offsets_s : dict of LinkKey to float
        Corrections to add to the stamps of links.
    notes : list of str
        Sentences on the results and on bounds that cannot be learned.

    """

    groups: dict[LinkKind, dict[Pair, GroupFit]] = field(default_factory=dict)
    odometry: Bounds = field(default_factory=dict)
    robot_odometry: dict[str, Bounds] = field(default_factory=dict)
    judged: frozenset[LinkKey] = frozenset()
    is_widened: bool = False
    offsets_s: dict[LinkKey, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def group_of(self, kind: LinkKind, pair: Pair) -> GroupFit | None:
        """Return the smallest group of ranges or of bearings that a link belongs to."""
        # Peers have no target, and the bounds of their observer.
        found = self.groups.get(kind, {})
        return next((found[group] for group in _groups(pair, 'link') if group in found), None)

    def of_all(self, kind: LinkKind) -> GroupFit | None:
        """Return the bounds of all ranges or of all bearings, if there are any."""
        return self.groups.get(kind, {}).get(EVERYTHING)

    def is_judged(self, kind: LinkKind, pair: Pair) -> bool:
        """Return whether a link, or one of its peers, had a range or a bearing to learn from."""
        observer, target = pair
        return any(
            key.kind is kind
            and observer in (key.observer, ANY_OBSERVER)
            and target in (key.target, '')
            for key in self.judged
        )


def _groups(pair: Pair, per: str) -> tuple[Pair, ...]:
    """Return the groups that a pair belongs to, the smallest first."""
    return (pair, (pair[0], ''), EVERYTHING)[GROUPS.index(per) :]


def _gathered(errors: Mapping[LinkKey, Errors], kind: LinkKind, per: str) -> dict[Pair, Errors]:
    """Join the readings of all members of each group that is large enough."""
    members: dict[Pair, list[Errors]] = defaultdict(list)
    for key, one in errors.items():
        if key.kind is kind and len(one.errors):
            for group in _groups((key.observer, key.target), per):
                members[group].append(one)
    joined = {group: Errors.joined(found) for group, found in members.items()}
    return {
        group: one
        for group, one in joined.items()
        if len(one.errors) >= (1 if group == EVERYTHING else READINGS)
    }


def bounds_of(model: Any, prefix: str) -> Bounds:
    """Return the learned parameters of a model by name, without those that stay as stated."""
    numbers = {name: getattr(model, field) for name, field in fields_of(model, prefix).items()}
    learned = numbers.keys() - NOT_LEARNED
    return {name: float(x) for name, x in numbers.items() if name in learned and x is not None}


def fit(gatherer: Gatherer, recording: Recording, per: str, choice: Choice) -> LearnedBounds:
    """
    Learn bounds from readings and a ground truth, or from their scatter without one.

    Without a truth, bounds never become narrower than the stated ones.
    """
    fleet, truth = gatherer.config, recording.truth
    learned, tracks = LearnedBounds(is_widened=truth is None), truth.tracks if truth else None
    stated = errors_of(gatherer, tracks)
    _add_delays(learned, stated, recording)
    errors = errors_of(gatherer, tracks, learned.offsets_s)
    learned.judged = frozenset(key for key, one in errors.items() if len(one.errors))
    for kind in (LinkKind.RANGE, LinkKind.BEARING):
        gathered, shape = _gathered(errors, kind, per), ErrorShape()
        if truth and kind is LinkKind.RANGE and EVERYTHING in gathered:
            shape = shape_of(gathered[EVERYTHING].values, gathered[EVERYTHING].errors, choice)
        learned.groups[kind] = {
            pair: _known_group(kind, one, choice, shape, fleet.dimension)
            if truth
            else _scatter_group(kind, one, choice, _stated(gatherer, kind, pair))
            for pair, one in gathered.items()
        }
    if truth is None:
        if not learned.judged:
            raise BagError('no input has five readings within a second: nothing can be learned')
        learned.notes += _limits_without_truth(gatherer)
        return learned
    models, notes = learn_odometry(
        gatherer.odometry, fleet, truth.tracks, choice, of_each=per != 'all'
    )
    bounds = {robot: bounds_of(model, 'odometry.') for robot, model in models.items()}
    learned.odometry, learned.robot_odometry = bounds.pop(ALL, {}), bounds
    learned.notes += notes
    if not (learned.judged or learned.odometry):
        raise BagError(
            "no reading has a ground truth at its time: check 'stamp_source', and the names. "
            + apart_text(truth.stamps_s(), gatherer.stamps_s(), 'the readings')
        )
    unknown = sum(map(len, gatherer.readings.values()))
    if unknown := unknown - sum(len(one.errors) for one in stated.values()):
        learned.notes.append(
            f'{unknown} readings have no ground truth, of places or headings, at their time.'
        )
    excluded = sum(group.excluded for kind in learned.groups if (group := learned.of_all(kind)))
    if excluded and not (fleet.window_outliers or fleet.max_outliers):
        learned.notes.append(
            f'The bounds exclude {excluded} readings. window_outliers: 1 tolerates one wrong '
            'reading of each pair in memory.seconds, max_outliers: 1 one of a moment.'
        )
    learned.notes += broken_bounds(gatherer, stated)
    return learned


def _stated(gatherer: Gatherer, kind: LinkKind, pair: Pair) -> SensorBounds:
    """Return the stated bounds of the readings of a group; the widest if there are several."""
    of_group = gatherer.stated.get(LinkKey(kind, *pair), {gatherer.config.sensor_bounds})
    if kind is LinkKind.BEARING:
        return max(of_group, key=attrgetter('bearing_half_width_rad'))
    return max(of_group, key=lambda one: one.range_error.max_error_m - one.range_error.min_error_m)


def _known_group(
    kind: LinkKind, one: Errors, choice: Choice, shape: ErrorShape, dimension: int
) -> GroupFit:
    """Return bounds for known errors, checked by learning from the first half of the readings."""

    def learn(part: Errors, is_half: bool = False) -> SensorBounds:
        if kind is LinkKind.BEARING:
            return SensorBounds(bearing_half_width_rad=fit_half_width_rad(part.errors, choice))
        own = shape_of(part.values, part.errors, choice) if is_half else shape
        return SensorBounds(fit_range(part.values, part.errors, choice, own))

    learned, median = learn(one), float(np.median(one.errors))
    if kind is LinkKind.RANGE:
        bounds, seen = bounds_of(learned.range_error, 'range.'), f'median {median:.2f}'
    else:
        bounds, seen = {'half_width': learned.bearing_half_width_rad}, f'median {median:.3f}'
        if dimension == 2:
            # In space the errors are angles without a sign, so the median is no expected error.
            bounds['expected_error'] = median
    excluded = int(np.count_nonzero(_breaking(learned, kind, one)))
    text = f'{_seen(kind, one, "error")}, {seen}; {_percent(excluded, one)} excluded'
    for row in (one.errors.argmin(), one.errors.argmax()) if len(one.errors) > 2 else ():
        others = learn(one.chosen(np.arange(len(one.errors)) != row))
        if np.median(_widths(others, kind, one)) < 0.5 * np.median(_widths(learned, kind, one)):
            text += (
                f'; one reading, {one.links[row]} at {one.stamps_s[row]:.3f} s, off by '
                f'{one.errors[row]:.2f} {UNITS[kind]}, sets a bound: without it the bounds are '
                'less than half as wide, and a smaller --keep leaves it out'
            )
    is_first = one.stamps_s <= 0.5 * (one.stamps_s.min() + one.stamps_s.max())
    first, second = one.chosen(is_first), one.chosen(~is_first)
    if min(len(first.errors), len(second.errors)) >= READINGS:
        rest = _percent(int(np.count_nonzero(_breaking(learn(first, True), kind, second))), second)
        text += f'; learned from the first half alone, {rest} of the second excluded'
    return GroupFit(bounds, excluded, text)


def _seen(kind: LinkKind, one: Errors, what: str) -> str:
    digits, low, high = 2 if kind is LinkKind.RANGE else 3, one.errors.min(), one.errors.max()
    span = f'{low:.{digits}f} to {high:.{digits}f} {UNITS[kind]}'
    return f'{len(one.errors)} readings, {what} {span}'


def _widths(bounds: SensorBounds, kind: LinkKind, one: Errors) -> NDArray[np.float64]:
    """Return the width of the bounds for each reading."""
    if kind is LinkKind.BEARING:
        return np.full(len(one.errors), 2.0 * bounds.bearing_half_width_rad)
    model = bounds.range_error
    relative = model.max_error_relative - model.min_error_relative
    return np.abs(model.max_error_m - model.min_error_m + relative * one.values)


def _percent(count: int, one: Errors) -> str:
    return f'{100.0 * count / len(one.errors):.2f} %'


def _scatter_group(kind: LinkKind, one: Errors, choice: Choice, stated: SensorBounds) -> GroupFit:
    """Return the stated bounds, widened to the scatter of the readings."""
    text = _seen(kind, one, 'scatter')
    if kind is LinkKind.BEARING:
        half_width_rad = fit_half_width_rad(one.errors, choice)
        bounds = {'half_width': max(half_width_rad, stated.bearing_half_width_rad)}
        excluded = int(np.count_nonzero(np.abs(one.errors) > bounds['half_width']))
    else:
        model, stated_m = stated.range_error, _widths(stated, kind, one)
        extra_m, excluded = missing_m(one.errors, 0.5 * stated_m, choice)
        if extra_m > 0.0:
            text += f', too wide for the stated bounds, {stated_m.min():.2f} m apart: widened'
        wide_m = rounded_outward((model.min_error_m - extra_m, model.max_error_m + extra_m))
        bounds = bounds_of(model, 'range.')
        bounds |= dict(zip(('min_error', 'max_error'), wide_m, strict=True))
    return GroupFit(bounds, excluded, f'{text}; {_percent(excluded, one)} excluded')


def _add_delays(
    learned: LearnedBounds, errors: Mapping[LinkKey, Errors], recording: Recording
) -> None:
    """
    Find ranges whose stamps are late or early, and the corrections for the stamps of links.

    A range that is stamped late by t belongs to the distance at a time t before: its error is -t
    times the rate of the distance, and a regression on that rate finds it.
    """
    links = {link.key for link in recording.links.values()}
    if recording.truth is None:
        return
    tracks, dimension = recording.truth.tracks, recording.truth.fleet.dimension
    for key, one in errors.items():
        if key.kind is not LinkKind.RANGE or len(one.errors) < READINGS:
            continue
        ends, zeros = (tracks[key.observer], tracks[key.target]), np.zeros(len(one.errors))
        ahead, behind = (
            -range_errors_m(*ends, one.stamps_s + step_s, zeros, dimension)
            for step_s in (STEP_S, -STEP_S)
        )
        rates = (ahead - behind) / (2.0 * STEP_S)
        known = np.isfinite(rates)
        if np.count_nonzero(known) < READINGS or not rates[known].std():
            continue
        rate = rates[known] - rates[known].mean()
        off_m = one.errors[known] - np.median(one.errors[known])
        delay_s = -float(rate @ off_m / (rate @ rate))
        spread_s = float((off_m + delay_s * rate).std() / np.sqrt(rate @ rate))
        is_told = delay_s**2 * rate.var() > EXPLAINED * off_m.var()
        if not (is_told and DELAYS_S[0] < abs(delay_s) < DELAYS_S[1]):
            continue
        if key in links:
            learned.offsets_s[key] = -delay_s
        late = 'late' if delay_s > 0.0 else 'early'
        todo = 'its link states' if key in links else 'its input may state'
        learned.notes.append(
            f'Stamps of {key} are {abs(delay_s):.3f} s {late} (+-{2.0 * spread_s:.3f}), as its '
            f'errors change with the rate of the distance: {todo} stamp_offset={-delay_s:.3f}.'
        )


def _limits_without_truth(gatherer: Gatherer) -> Iterator[str]:
    """Yield notes on errors that a recording without truth cannot show."""
    yield 'Without a ground truth only the scatter of the readings is seen, not a bias of a pair.'
    yield 'Without --truth the bounds are those that you stated, or as wide as the scatter.'
    if any(key.kind is LinkKind.BEARING for key in gatherer.readings):
        yield 'A camera that is mounted askew has a bias, too: half widths are not narrowed.'
    if gatherer.odometry:
        yield 'Without a ground truth scale and bounds of odometry cannot be learned.'


def _breaking(bounds: SensorBounds, kind: LinkKind, one: Errors) -> NDArray[np.bool_]:
    """Return which readings violate bounds, as far as that is known."""
    if kind is LinkKind.BEARING:
        return np.abs(one.errors) > bounds.bearing_half_width_rad
    if bounds.range_error.sigma_factor > 0.0:
        # The bounds depend on the variance of each reading, which is not gathered.
        return np.zeros(len(one.errors), dtype=bool)
    pairs = zip(one.values.tolist(), one.errors.tolist(), strict=True)
    held = [range_holds(bounds.range_error, value, value - error) for value, error in pairs]
    return ~np.array(held, dtype=bool)


def broken_bounds(gatherer: Gatherer, errors: Mapping[LinkKey, Errors]) -> list[str]:
    """Return sentences on the readings that violate all their stated bounds, oldest first."""
    found = []
    for key, one in errors.items():
        broken = [_breaking(bounds, key.kind, one) for bounds in gatherer.stated[key]]
        wrong = one.chosen(np.all(broken, axis=0))
        ends = np.flatnonzero(np.diff(wrong.stamps_s) > GAP_S) + 1
        for times_s, sizes in zip(
            np.split(wrong.stamps_s, ends), np.split(np.abs(wrong.errors), ends), strict=True
        ):
            if len(times_s):
                text = (
                    f'The stated bounds of {key} are broken from {times_s[0]:.1f} to '
                    f'{times_s[-1]:.1f} s: {len(times_s)} times, by up to {sizes.max():.2f} '
                    f'{UNITS[key.kind]}'
                )
                found.append((float(times_s[0]), text))
    found.sort()
    # The truth is taken at the stamp, and is that of another place if the clock is wrong.
    condition = ', if stamps are right' if gatherer.config.stamp_error_s > 0.0 else ''
    sentences = [f'{text}{condition}.' for _, text in found[:NAMED]]
    if len(found) > NAMED:
        sentences.append(
            f'The stated bounds are broken {len(found) - NAMED} times more{condition}.'
        )
    return sentences
