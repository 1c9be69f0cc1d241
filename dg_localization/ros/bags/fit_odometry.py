# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The scale of odometry and the bounds of its errors, from a bag and a ground truth."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from dg_localization.calibration.bounds import Choice
from dg_localization.calibration.odometry import (
    OdometryWindows,
    fit_odometry,
    n_excluded,
    odometry_windows,
)
from dg_localization.calibration.truth import TrueTrack
from dg_localization.fleet import FleetConfig, OdometryErrorModel
from dg_localization.fleet.rotations import rotation_of_quaternion
from dg_localization.ros.bags.samples import Gatherer, OdometryPiece
from dg_localization.ros.interface.parameters.settings import parameters_of

# Fewer windows tell nothing.
WINDOWS = 20

# Latencies, gaps and tilts are not seen; terms that the fit has no use for are zero.
NOT_LEARNED = ('latency', 'max_gap', 'restart_gap', 'tilt')


def fit_all_odometry(
    gatherer: Gatherer, tracks: Mapping[str, TrueTrack], per: str, choice: Choice
) -> tuple[dict[str, float], dict[str, dict[str, float]], list[str]]:
    """Return the bounds of odometry of all robots and of each by parameter, and sentences."""
    fleet, notes = gatherer.config, list[str]()
    of_robots: dict[str, dict[str, float]] = {}
    found: dict[str, OdometryWindows] = {}
    for robot in filter(tracks.__contains__, sorted(gatherer.odometry)):
        pieces = gatherer.odometry[robot]
        windows = _windows_of(pieces, tracks[robot], fleet, fleet.is_upright(robot))
        if len(pieces) > 1:
            notes.append(f'Odometry of {robot} started anew {len(pieces) - 1} times.')
        if len(windows.seconds) >= WINDOWS:
            found[robot] = windows
    if not found:
        return {}, {}, notes
    for robot, windows in found.items():
        model = fit_odometry(windows, choice, fleet.odometry_error_of(robot))
        notes += _texts(robot, model, windows)
        # Errors that the file before states of one robot would be mixed with those of all.
        if per != 'all':
            of_robots[robot] = _parameters(model)
    together = OdometryWindows.joined(found.values())
    model = fit_odometry(together, choice, fleet.odometry_error)
    notes += _texts('all', model, together)
    for robot in filter(found.__contains__, fleet.robot_odometry_error):
        of_robots.setdefault(robot, _parameters(model))
    others = [robot for robot in fleet.robots if robot not in found]
    for robot in others:
        # What was learned of others would replace what was stated of these.
        of_robots[robot] = parameters_of(fleet.odometry_error_of(robot), 'odometry.')
    if others:
        notes.append(
            f'Nothing was learned of the odometry of {", ".join(others)}: it is as it was stated.'
        )
    return _parameters(model), of_robots, notes


def _windows_of(
    pieces: Sequence[OdometryPiece], truth: TrueTrack, fleet: FleetConfig, upright: bool
) -> OdometryWindows:
    """Return windows of the odometry of a robot; none goes beyond a start anew."""
    how = truth, fleet.dimension, upright
    columns = (map(np.array, zip(*piece, strict=True)) for piece in pieces)
    return OdometryWindows.joined(
        odometry_windows(stamps_s, places_m, rotation_of_quaternion(turns), *how)
        for stamps_s, places_m, turns in columns
    )


def _parameters(model: OdometryErrorModel) -> dict[str, float]:
    """Return learned bounds by the names of the parameters; what is stated of others stays."""
    numbers = parameters_of(model, 'odometry.')
    return {name: value for name, value in numbers.items() if name not in NOT_LEARNED}


def _texts(name: str, model: OdometryErrorModel, windows: OdometryWindows) -> Iterator[str]:
    """Yield what was learned, and what was kept as stated of a robot that did not move."""
    count = len(windows.seconds)
    yield (
        f'Odometry of {name}: true ways are {model.translation_scale:.4f} times the reported '
        f'ones, up to {model.constant_m:.4f} m + {model.translation_per_m:.4f} per m, turns are '
        f'within {model.constant_rad:.4f} rad + {model.rotation_per_rad:.4f} per rad; {count} '
        f'windows of 0.35 to 40 s, {100.0 * n_excluded(model, windows) / count:.2f} % excluded.'
    )
    if not windows.tell_ways:
        yield (
            f'Odometry of {name}: no window is longer than {windows.way_m.max():.2f} m. The scale '
            'is as it was stated, and errors of ways are no smaller.'
        )
    if not windows.tell_turns:
        most_rad = windows.turn_rad.max()
        yield (
            f'Odometry of {name}: no window turns by more than {most_rad:.2f} rad. Errors of '
            'turns are no smaller than they were stated.'
        )
