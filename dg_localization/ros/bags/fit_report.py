# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Learned bounds as a file of parameters, with what was learned in its comments."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from textwrap import wrap

import numpy as np

from dg_localization.fleet import FleetConfig, LinkKind
from dg_localization.ros.bags.fitted import (
    EXPECTED_ERROR,
    EXPECTED_ERROR_RELATIVE,
    Fit,
    GroupFit,
    Pair,
    range_parameters,
)
from dg_localization.ros.interface.links import OVERRIDES, STAMP_OFFSET, Link
from dg_localization.ros.interface.parameters.table import TABLE

COLUMNS = 98

# What a link measures of others.
MEASURED = {
    LinkKind.RANGE: (LinkKind.RANGE,),
    LinkKind.BEARING: (LinkKind.BEARING,),
    LinkKind.PEERS: (LinkKind.RANGE, LinkKind.BEARING),
}
# What it may state of them: all that can be learned.
BOUNDS = {
    kind: tuple(name for name in OVERRIDES[kind] if name != STAMP_OFFSET)
    for kind in (LinkKind.RANGE, LinkKind.BEARING)
}


def as_yaml(fit: Fit, links: Sequence[Link], bag: str, fleet: FleetConfig) -> str:
    """Return the file."""
    lines = [
        *_comment(f'Error bounds learned from {bag} by fit_bounds.'),
        *_comment(
            'Of n readings in sequence not all are independent: the share that they vouch for, '
            'with a confidence of 95 %, is at most what is said here.'
        ),
        *(line for note in (*fit.notes, *_kept_links(fit, links)) for line in _comment(note)),
        *_groups('Ranges', fit.ranges),
        *_groups('Bearings', fit.bearings),
        '/**:',
        '  ros__parameters:',
        *_section('range', _of_all(fit, LinkKind.RANGE)),
        *_section('bearing', _of_all(fit, LinkKind.BEARING)),
        *_section('odometry', fit.odometry),
        *_robots(fit.robot_odometry),
        *_links(fit, links, fleet),
    ]
    return '\n'.join(lines)


def _comment(text: str, indent: str = '') -> list[str]:
    return wrap(text, COLUMNS, initial_indent=f'# {indent}', subsequent_indent=f'# {indent}  ')


def _groups(title: str, groups: Mapping[Pair, GroupFit]) -> Iterator[str]:
    """Yield a comment on each group, the largest first."""
    if groups:
        yield f'# {title}:'
    for pair in sorted(groups):
        name = '->'.join(filter(None, pair)) or 'all'
        yield from _comment(f'{name}: {groups[pair].text}.', indent='  ')


def _of_all(fit: Fit, kind: LinkKind) -> dict[str, float]:
    """Return the bounds of all readings of one kind, if there are any."""
    group = fit.of_all(kind)
    return group.bounds if group else {}


def _section(name: str, bounds: Mapping[str, float]) -> Iterator[str]:
    """Yield those bounds that the node has parameters for, if there are any."""
    known = {spec.name for spec in TABLE}
    taken = {key: value for key, value in bounds.items() if f'{name}.{key}' in known}
    if taken:
        yield f'    {name}:'
        yield from (f'      {key}: {_number(value)}' for key, value in taken.items())


def _robots(bounds: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    """Yield the bounds of the odometry of single robots, if there are any."""
    if bounds:
        yield '    robot_odometry:'
    for robot, of_robot in bounds.items():
        yield f'      {robot}:'
        yield from (f'        {key}: {_number(value)}' for key, value in of_robot.items())


def _links(fit: Fit, links: Iterable[Link], fleet: FleetConfig) -> Iterator[str]:
    """Yield the links that have bounds of their own, and all that are named one by one."""
    lines = []
    for link in links:
        kinds = MEASURED.get(link.key.kind, ())
        own: dict[str, float] = {}
        for kind in kinds:
            own |= _bounds_of(fit, kind, link, fleet)
        if not (own or link.explicit):
            continue
        judged = {name for kind in kinds for name in BOUNDS[kind]}
        others = {name: value for name, value in link.overrides.items() if name not in judged}
        bounds = {**others, **own}
        words = [link.topic, link.type_name, link.key.observer, link.key.target]
        words += [
            f'{name}={_number(bounds[name])}'
            for name in OVERRIDES[link.key.kind]
            if name in bounds
        ]
        lines.append(f"      - '{' '.join(filter(None, words))}'")
    if lines:
        yield '    links:'
        yield from lines


def _bounds_of(fit: Fit, kind: LinkKind, link: Link, fleet: FleetConfig) -> dict[str, float]:
    """Return the bounds that a link needs to be given, of its ranges or of its bearings."""
    stated = _stated(kind, link)
    group = fit.group_of(kind, *link.key.ends)
    if group is None:
        return stated
    # What it left to the bounds of all was that of the file before.
    whole = {**_of_fleet(kind, fleet), **stated}
    if _is_as_stated(fit, kind, link):
        return whole
    if stated and kind in fit.kept:
        return _widest(whole, group.bounds)
    if group is fit.of_all(kind):
        return {name: value for name, value in stated.items() if name not in group.bounds}
    return {**stated, **group.bounds}


def _stated(kind: LinkKind, link: Link) -> dict[str, float]:
    """Return the bounds that a link states of its ranges or of its bearings."""
    return {name: value for name, value in link.overrides.items() if name in BOUNDS[kind]}


def _is_as_stated(fit: Fit, kind: LinkKind, link: Link) -> bool:
    """Return whether a link keeps bounds of its own: none of its readings speaks against them."""
    return bool(_stated(kind, link)) and not fit.is_judged(kind, *link.key.ends)


def _kept_links(fit: Fit, links: Iterable[Link]) -> Iterator[str]:
    """Yield a sentence on each link whose bounds stay, although those of others were learned."""
    for link in links:
        for kind in MEASURED.get(link.key.kind, ()):
            if fit.of_all(kind) and _is_as_stated(fit, kind, link):
                what = 'range' if kind is LinkKind.RANGE else 'bearing'
                yield (
                    f'{link.topic} has no {what} to learn from: the bounds of its {what}s are as '
                    'they were stated.'
                )


def _of_fleet(kind: LinkKind, fleet: FleetConfig) -> dict[str, float]:
    """Return the bounds that are stated of all ranges or of all bearings."""
    if kind is LinkKind.BEARING:
        return {
            'half_width': fleet.bearing_half_width_rad,
            EXPECTED_ERROR: fleet.bearing_expected_error_rad,
        }
    bounds = range_parameters(fleet.range_error)
    if fleet.range_error.expected_error_m is not None:
        bounds[EXPECTED_ERROR] = fleet.range_error.expected_error_m
    bounds[EXPECTED_ERROR_RELATIVE] = fleet.range_error.expected_error_relative
    return bounds


def _widest(stated: Mapping[str, float], learned: Mapping[str, float]) -> dict[str, float]:
    """Return bounds that hold for whatever is within the stated or the learned ones."""
    return {
        name: (min if name.startswith('min_') else max)(value, learned.get(name, value))
        for name, value in stated.items()
    }


def _number(value: float) -> str:
    """Return a number that YAML reads as one with a fraction, and as the same."""
    return np.format_float_positional(value, trim='0')
