# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `survey_anchors`: ranges between nodes at rest in, their coordinates out.

    survey_anchors RANGES.csv --error LOW HIGH [--anchor NAME X Y [Z]] ... [--outliers K]

The localizer places the nodes as it places robots. The output is a section `anchors` of the
parameters of the node, in which every node is within its bound, or a list of what is missing.
"""

import argparse
from collections.abc import Iterator, Sequence
from math import inf
from pathlib import Path
import re
from typing import Any

import numpy as np

from dg_localization.fleet import Anchor, Estimate, FleetConfig, Localizer, RangeErrorModel
from dg_localization.fleet.config import ConfigError
from dg_localization.ros.bags.truth import read_columns
from dg_localization.ros.executables import (
    EXIT_FAILED,
    UsageError,
    existing_file,
    print_line,
    print_result,
)
from dg_localization.ros.interface.links import ANY_NAME, WANTED_NAME
from dg_localization.ros.interface.parameters.settings import parameters_text
from dg_localization.ros.spinning import own_arguments

NOW_S = 1.0


def read_ranges(path: Path) -> list[tuple[str, str, float]]:
    """Read a table with the columns from, to and range, in m."""
    columns, rows = read_columns(path)
    if not {'from', 'to', 'range'}.issubset(columns):
        raise UsageError(f'{path} is no table with the columns from, to, range')
    found = []
    for number, row in rows:
        try:
            found.append((row['from'], row['to'], float(row['range'])))
        except ValueError as error:
            raise UsageError(f'{path}, line {number}: {error}') from None
    return found


def survey(
    readings: Sequence[tuple[str, str, float]],
    anchors: dict[str, Anchor],
    options: argparse.Namespace,
) -> Estimate:
    """Place nodes at rest by all their ranges; nodes with known coordinates are anchors."""
    low_m, high_m = options.error
    names = {name: None for observer, target, _ in readings for name in (observer, target)}
    for name in (*names, *anchors):
        if not re.fullmatch(ANY_NAME, name):
            raise UsageError(f"'{name}' cannot be the name of an anchor: it {WANTED_NAME}")
    try:
        config = FleetConfig(
            robots=tuple(name for name in names if name not in anchors),
            dimension=options.dimension,
            anchors=anchors,
            range_error=RangeErrorModel(low_m, high_m, 0.0, 0.0),
            max_repeats=len(readings),
            max_speed_m_s=0.0,
            max_outliers=options.outliers,
            max_conflict_seconds=inf,
            memory_s=0.0,
        )
    except ConfigError as error:
        raise UsageError(str(error)) from error
    localizer = Localizer(config)
    for observer, target, range_m in readings:
        rejection = localizer.add_range(observer, target, range_m, NOW_S, NOW_S)
        if rejection is not None:
            print_line(f'{observer} to {target}: {rejection.text}')
    return localizer.step(NOW_S)


def missing(estimate: Estimate) -> Iterator[str]:
    """Yield reasons why the nodes have no unique places, up to a mirror image."""
    if not estimate.placements:
        yield estimate.reason
        for conflict in estimate.conflicts:
            yield f'these contradict each other: {", ".join(map(str, conflict))}'
    yield from (f'{text} (what is missing)' for text in estimate.would_fix)
    for placement in estimate.placements[:1]:
        open_ones = ~np.isfinite(placement.enclosure_m).all(axis=(1, 2))
        if open_ones.any():
            names = ', '.join(np.array(estimate.robots)[open_ones])
            yield f'not bounded: {names}'
    different = sum(not placement.mirrored for placement in estimate.placements)
    if different > 1:
        yield f'{different} different placements agree with the ranges: more ranges are needed'


def anchors_as_yaml(estimate: Estimate, anchors: dict[str, Anchor], source: str) -> str:
    """Return the section of parameters, with a bound that holds the true place of each node."""
    placement = estimate.placements[0]
    comments = [f'Surveyed from {source} by survey_anchors, {estimate.frame}.']
    if any(other.mirrored for other in estimate.placements):
        comments.append('The mirror image agrees as well: state one more node with --anchor.')
    dropped = {str(key) for one in estimate.placements for key in one.dropped}
    comments += [f'Left out: {name}.' for name in sorted(dropped)]
    found: dict[str, Any] = {'names': [*anchors, *estimate.robots]}
    for name, anchor in anchors.items():
        found[name] = {'position': [*anchor.coordinates_m], 'bound': anchor.bound_m}
    places_m = np.round(placement.positions_m, 4)
    # The farthest corner of the enclosures, plus rounding to four decimals.
    agreeing = [one.enclosure_m for one in estimate.placements if not one.mirrored]
    off_m = np.abs(np.concatenate(agreeing, axis=1) - places_m[:, None]).max(axis=1)
    bounds_m = np.ceil(1e4 * np.linalg.norm(off_m, axis=1) + 1.0) / 1e4
    for name, place_m, bound_m in zip(estimate.robots, places_m, bounds_m, strict=True):
        found[name] = {'position': place_m.tolist(), 'bound': float(bound_m)}
    return parameters_text(comments, {'anchors': found})


def main(args: Sequence[str]) -> int:
    """Survey nodes at rest; return the exit code."""
    parser = argparse.ArgumentParser(
        prog='survey_anchors',
        description='Find the coordinates of nodes at rest from the ranges between them, and '
        'print them as parameters of the node, or what is missing.',
        epilog='Exit codes: 0; 1 where the ranges do not place every node; 2 for wrong arguments.',
    )
    add = parser.add_argument
    add('ranges', type=existing_file, metavar='CSV', help='columns from, to, range (m)')
    bounds, ends = 'bounds of reading minus true distance, in m', ('LOW', 'HIGH')
    add('--error', nargs=2, type=float, required=True, metavar=ends, help=bounds)
    known = 'a node whose coordinates are known; without any, the first two make the axes'
    add('--anchor', nargs='+', action='append', default=[], metavar='NAME X Y', help=known)
    add('--dimension', type=int, choices=(2, 3), default=2, help='(%(default)s)')
    add('--outliers', type=int, default=0, metavar='K', help='how many readings may be wrong')
    options = parser.parse_args(own_arguments(args))
    try:
        anchors = {name: Anchor(tuple(map(float, at))) for name, *at in options.anchor}
    except ValueError as error:
        raise UsageError(f'--anchor: {error}') from error
    estimate = survey(read_ranges(options.ranges), anchors, options)
    wanting = list(missing(estimate))
    for text in wanting:
        print_line(text)
    if estimate.placements and len(estimate.placements) == estimate.n_hypotheses:
        print_result(anchors_as_yaml(estimate, anchors, options.ranges.name))
    return EXIT_FAILED if wanting else 0
