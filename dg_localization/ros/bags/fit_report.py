# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Learned bounds as a file of parameters, with what was learned in its comments."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from dg_localization.fleet import FleetConfig, LinkKind
from dg_localization.ros.bags.fit import Fit, range_parameters
from dg_localization.ros.bags.report import Tree
from dg_localization.ros.bags.writer import parameters_text, yaml_value
from dg_localization.ros.interface.links import KINDS, STAMP_OFFSET, Link
from dg_localization.ros.interface.parameters.table import TABLE

# What a link measures of others.
MEASURED = {
    LinkKind.RANGE: (LinkKind.RANGE,),
    LinkKind.BEARING: (LinkKind.BEARING,),
    LinkKind.PEERS: (LinkKind.RANGE, LinkKind.BEARING),
}
# What it may state of them: all that can be learned.
BOUNDS = {
    kind: tuple(name for name in KINDS[kind].overrides if name != STAMP_OFFSET)
    for kind in (LinkKind.RANGE, LinkKind.BEARING)
}


def as_yaml(fit: Fit, links: Sequence[Link], bag: str, fleet: FleetConfig) -> str:
    """Return the file."""
    comments = [f'Error bounds learned from {bag} by fit_bounds.', *fit.notes]
    comments += _kept_links(fit, links)
    parameters: Tree = {}
    for kind, groups in fit.groups.items():
        for pair in sorted(groups):
            name = '->'.join(filter(None, pair)) or 'all'
            comments.append(f'{kind.value.capitalize()}s, {name}: {groups[pair].text}.')
        group = fit.of_all(kind)
        parameters[kind.value] = {
            name: value
            for name, value in (group.bounds if group else {}).items()
            if f'{kind.value}.{name}' in TABLE
        }
    parameters |= {'odometry': fit.odometry, 'robot_odometry': fit.robot_odometry}
    parameters['links'] = [text for link in links if (text := _link_text(fit, link, fleet))]
    return parameters_text(comments, parameters)


def _link_text(fit: Fit, link: Link, fleet: FleetConfig) -> str:
    """Return a link that has bounds of its own or was named as such; else nothing."""
    kinds = MEASURED.get(link.key.kind, ())
    own: dict[str, float] = {}
    for kind in kinds:
        own |= _bounds_of(fit, kind, link, fleet)
    if link.key in fit.offsets_s:
        own[STAMP_OFFSET] = round(link.stamp_offset_s + fit.offsets_s[link.key], 4)
    if not (own or link.explicit):
        return ''
    judged = {name for kind in kinds for name in BOUNDS[kind]}
    others = {name: value for name, value in link.overrides.items() if name not in judged}
    bounds = {**others, **own}
    words = [link.topic, link.type_name, link.key.observer, link.key.target]
    words += [
        f'{name}={yaml_value(bounds[name])}'
        for name in KINDS[link.key.kind].overrides
        if name in bounds
    ]
    return ' '.join(filter(None, words))


def _bounds_of(fit: Fit, kind: LinkKind, link: Link, fleet: FleetConfig) -> dict[str, float]:
    """Return the bounds that a link needs to be given, of its ranges or of its bearings."""
    stated = {name: value for name, value in link.overrides.items() if name in BOUNDS[kind]}
    group = fit.group_of(kind, link.key.ends)
    if group is None:
        return stated
    # What it left to the bounds of all was that of the file before.
    whole = {**_of_fleet(kind, fleet), **stated}
    if _is_as_stated(fit, kind, link):
        return whole
    if stated and fit.is_widened:
        return _widest(whole, group.bounds)
    if group is fit.of_all(kind) and not stated:
        return {}
    return {**stated, **group.bounds}


def _is_as_stated(fit: Fit, kind: LinkKind, link: Link) -> bool:
    """Return whether a link keeps bounds of its own: none of its readings speaks against them."""
    states = not link.overrides.keys().isdisjoint(BOUNDS[kind])
    return states and not fit.is_judged(kind, link.key.ends)


def _kept_links(fit: Fit, links: Iterable[Link]) -> Iterator[str]:
    """Yield a sentence on each link whose bounds stay, although those of others were learned."""
    for link in links:
        for kind in MEASURED.get(link.key.kind, ()):
            if fit.of_all(kind) and _is_as_stated(fit, kind, link):
                yield (
                    f'{link.topic} has no {kind.value} to learn from: the bounds of its '
                    f'{kind.value}s are as they were stated.'
                )


def _of_fleet(kind: LinkKind, fleet: FleetConfig) -> dict[str, float]:
    """Return the bounds that are stated of all ranges or of all bearings."""
    if kind is LinkKind.BEARING:
        return {
            'half_width': fleet.bearing_half_width_rad,
            'expected_error': fleet.bearing_expected_error_rad,
        }
    bounds = range_parameters(fleet.range_error)
    if fleet.range_error.expected_error_m is not None:
        bounds['expected_error'] = fleet.range_error.expected_error_m
    bounds['expected_error_relative'] = fleet.range_error.expected_error_relative
    return bounds


def _widest(stated: Mapping[str, float], learned: Mapping[str, float]) -> dict[str, float]:
    """Return bounds that hold for whatever is within the stated or the learned ones."""
    return {
        name: (min if name.startswith('min_') else max)(value, learned.get(name, value))
        for name, value in stated.items()
    }
