# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Learned bounds as a file of parameters, with what was learned in its comments."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from textwrap import wrap

import numpy as np

from dg_localization.fleet import LinkKind
from dg_localization.ros.bags.fitted import EVERYTHING, Fit, GroupFit, Pair
from dg_localization.ros.interface.links import OVERRIDES, STAMP_OFFSET, Link
from dg_localization.ros.interface.parameters.link_bounds import MEASURE_OTHERS
from dg_localization.ros.interface.parameters.table import TABLE

COLUMNS = 98


def as_yaml(fit: Fit, links: Sequence[Link], bag: str) -> str:
    """
    Return the file.

    Parameters
    ----------
    fit : Fit
    links : sequence of Link
        The inputs: those named one by one, and those found by the templates.
    bag : str
        Name of the bag.

    """
    lines = [
        *_comment(f'Error bounds learned from {bag} by fit_bounds.'),
        *_comment(
            'Of n readings in sequence not all are independent: the share that they vouch for, '
            'with a confidence of 95 %, is at most what is said here.'
        ),
        *(line for note in fit.notes for line in _comment(note)),
        *_groups('Ranges', fit.ranges),
        *_groups('Bearings', fit.bearings),
        '/**:',
        '  ros__parameters:',
        *_section('range', _of_all(fit.ranges)),
        *_section('bearing', _of_all(fit.bearings)),
        *_section('odometry', fit.odometry),
        *_robots(fit.robot_odometry),
        *_links(fit, links),
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


def _of_all(groups: Mapping[Pair, GroupFit]) -> dict[str, float]:
    """Return the bounds of all readings of one kind, if there are any."""
    return groups[EVERYTHING].bounds if EVERYTHING in groups else {}


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


def _links(fit: Fit, links: Iterable[Link]) -> Iterator[str]:
    """Yield the links that have bounds of their own, and all that are named one by one."""
    lines = []
    for link in links:
        groups = list(fit.of_link(link.key.kind, link.key.observer, link.key.target))
        # Of peers a name that both kinds have is that of the ranges, which come first.
        learned = {name: value for group in groups[::-1] for name, value in group.bounds.items()}
        if not (learned or link.explicit):
            continue
        # What was learned of all readings holds for a link that has no bounds of its own now.
        kept = {
            name: value
            for name, value in link.overrides.items()
            if not _is_learned(fit, link.key.kind, name)
        }
        bounds = {**kept, **learned}
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


def _is_learned(fit: Fit, kind: LinkKind, name: str) -> bool:
    """Return whether what a name of a link stands for was learned."""
    if name == STAMP_OFFSET or kind not in MEASURE_OTHERS:
        return False
    if kind is LinkKind.BEARING or name == 'half_width':
        return bool(fit.bearings)
    return name in OVERRIDES[LinkKind.RANGE] and bool(fit.ranges)


def _number(value: float) -> str:
    """Return a number that YAML reads as one with a fraction, and as the same."""
    return np.format_float_positional(value, trim='0')
