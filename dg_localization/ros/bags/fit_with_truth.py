# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds from the readings of a bag beside a ground truth."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

import numpy as np

from dg_localization.calibration.bounds import (
    Choice,
    Shape,
    excluded_ranges,
    fit_half_width_rad,
    fit_range,
    shape_of,
    shortest_band,
)
from dg_localization.calibration.odometry import (
    OdometryFit,
    OdometryWindows,
    fit_odometry,
    odometry_windows,
)
from dg_localization.calibration.truth import TrueTrack
from dg_localization.fleet import FleetConfig, LinkKind, OdometryErrorModel
from dg_localization.fleet.rotations import rotation_of_quaternion
from dg_localization.ros.bags.bag import BagError
from dg_localization.ros.bags.compared import (
    broken_bounds,
    compared,
    delay_texts,
    gross_text,
)
from dg_localization.ros.bags.fitted import (
    EVERYTHING,
    EXPECTED_ERROR,
    EXPECTED_ERROR_RELATIVE,
    LEAST_READINGS,
    BoolArray,
    Fit,
    FloatArray,
    GroupFit,
    gathered,
    range_parameters,
    with_readings,
)
from dg_localization.ros.bags.samples import OdometryPiece, Samples
from dg_localization.ros.bags.truth import Truth
from dg_localization.ros.bags.truth_table import apart_text
from dg_localization.ros.interface.parameters.odometry import odometry_error_parameters
from dg_localization.ros.interface.parameters.settings import Settings

LEARNED_OF_ODOMETRY = (
    'translation_scale',
    'translation_per_m',
    'translation_per_rad',
    'rotation_per_m',
    'rotation_per_rad',
    'constant_translation',
    'constant_rotation',
)
"""
The scale, and all terms of the errors: they are learned together, so those that the fit has no use
for are zero. A latency, a gap and a tilt are not seen.
"""


def fit_with_truth(
    samples: Samples, truth: Truth, settings: Settings, per: str, choice: Choice
) -> Fit:
    """Learn bounds from readings and a ground truth."""
    of_fleet, dimension = truth.of_fleet(settings.fleet), settings.fleet.dimension
    tracks = of_fleet.tracks
    ranges = compared(LinkKind.RANGE, samples, tracks, dimension)
    bearings = compared(LinkKind.BEARING, samples, tracks, dimension)
    by_link = {key: (one.stamps_s, one.values, one.errors) for key, one in ranges.items()}
    rays_by_link = {key: (one.stamps_s, one.errors) for key, one in bearings.items()}
    by_group = gathered(by_link, per)
    shape = Shape()
    if EVERYTHING in by_group:
        _, readings, errors = by_group[EVERYTHING]
        shape = shape_of(readings, errors, choice)
    fit = Fit(
        judged=with_readings({**by_link, **rays_by_link}),
        ranges={
            pair: _range_group(stamps, readings, errors, choice, shape)
            for pair, (stamps, readings, errors) in by_group.items()
        },
        bearings={
            pair: _bearing_group(stamps, errors, choice, dimension)
            for pair, (stamps, errors) in gathered(rays_by_link, per).items()
        },
    )
    learned = _add_odometry(fit, samples, tracks, settings.fleet, per, choice)
    if learned:
        _add_stated_odometry(fit, settings.fleet, learned)
    if not (fit.ranges or fit.bearings or fit.odometry):
        raise BagError(
            'no reading has a ground truth at its time: are the stamps of both on one clock '
            "(parameter 'stamp_source'), and are the names those of 'robots' and 'anchors'? "
            + apart_text(of_fleet.stamps_s(), samples.stamps_s(), 'the readings')
        )
    known = sum(len(one.errors) for one in (*ranges.values(), *bearings.values()))
    unknown = samples.n_readings - known
    if unknown:
        fit.notes.append(
            f'{unknown} readings have no ground truth at their time: of places, and of headings '
            'for rays and for sensors away from the center of a robot.'
        )
    fit.notes += delay_texts(ranges, tracks, dimension)
    fit.notes += _advice(fit, settings.fleet)
    fit.notes += broken_bounds(settings.fleet, ranges, bearings)
    return fit


def _advice(fit: Fit, fleet: FleetConfig) -> Iterator[str]:
    """Yield what to do about readings that the bounds leave out."""
    groups = [fit.of_all(kind) for kind in (LinkKind.RANGE, LinkKind.BEARING)]
    excluded = sum(group.excluded for group in groups if group)
    if excluded and not (fleet.window_outliers or fleet.max_outliers):
        yield (
            f'The bounds leave {excluded} readings out, and one of them may exclude the truth: '
            'window_outliers: 1 lets one reading of each pair in memory.seconds be wrong, '
            'max_outliers: 1 one of a moment.'
        )


def _range_group(
    stamps_s: FloatArray,
    readings_m: FloatArray,
    errors_m: FloatArray,
    choice: Choice,
    shape: Shape,
) -> GroupFit:
    model = fit_range(readings_m, errors_m, choice, shape)
    seen = (
        f'error {errors_m.min():.2f} to {errors_m.max():.2f} m, median {np.median(errors_m):.2f}'
    )
    excluded = excluded_ranges(model, readings_m, errors_m)
    rest_m = errors_m - shape.slope * readings_m
    low_m, high_m = shortest_band(rest_m, choice.keep)
    seen += gross_text(stamps_s, errors_m, (low_m <= rest_m) & (rest_m <= high_m), 'm')
    bounds = {
        **range_parameters(model),
        EXPECTED_ERROR: model.expected_error_m or 0.0,
        EXPECTED_ERROR_RELATIVE: model.expected_error_relative,
    }

    def excluded_of(learned: BoolArray, judged: BoolArray) -> int:
        some = readings_m[learned], errors_m[learned], choice
        half = fit_range(*some, shape_of(*some))
        return excluded_ranges(half, readings_m[judged], errors_m[judged])

    rest = _share_of_rest(stamps_s, excluded_of)
    return GroupFit(len(errors_m), excluded, seen, bounds, rest)


def _bearing_group(
    stamps_s: FloatArray, errors_rad: FloatArray, choice: Choice, dimension: int
) -> GroupFit:
    half_width_rad = fit_half_width_rad(errors_rad, choice)
    bias_rad = float(np.median(errors_rad))
    seen = f'error {errors_rad.min():.3f} to {errors_rad.max():.3f} rad, median {bias_rad:.3f}'
    sizes_rad = np.abs(errors_rad)
    excluded = int(np.count_nonzero(sizes_rad > half_width_rad))
    bounds = {'half_width': half_width_rad}
    if dimension == 2:
        # In space the errors are angles without a sign, and say nothing of the vertical axis.
        bounds[EXPECTED_ERROR] = bias_rad

    def excluded_of(learned: BoolArray, judged: BoolArray) -> int:
        half_rad = fit_half_width_rad(errors_rad[learned], choice)
        return int(np.count_nonzero(sizes_rad[judged] > half_rad))

    rest = _share_of_rest(stamps_s, excluded_of)
    return GroupFit(len(errors_rad), excluded, seen, bounds, rest)


def _share_of_rest(
    stamps_s: FloatArray, excluded_of: Callable[[BoolArray, BoolArray], int]
) -> float | None:
    """Return what share of the second half bounds of the first exclude; None for few readings."""
    learned = stamps_s <= 0.5 * (stamps_s.min() + stamps_s.max())
    count = int(np.count_nonzero(~learned))
    if min(count, len(stamps_s) - count) < LEAST_READINGS:
        return None
    return excluded_of(learned, ~learned) / count


def _add_odometry(
    fit: Fit,
    samples: Samples,
    tracks: Mapping[str, TrueTrack],
    fleet: FleetConfig,
    per: str,
    choice: Choice,
) -> frozenset[str]:
    """Add the bounds of odometry, those of all robots and of each, and a sentence on each."""
    found: dict[str, OdometryWindows] = {}
    for robot in filter(tracks.__contains__, sorted(samples.odometry)):
        windows = _windows_of(robot, samples.odometry[robot], tracks[robot], fleet)
        fit.notes += _restarts(robot, samples.odometry[robot])
        if len(windows.seconds) >= LEAST_READINGS:
            found[robot] = windows
    if not found:
        return frozenset()
    for robot, windows in found.items():
        stated = fleet.odometry_error_of(robot)
        bounds = fit_odometry(windows, choice, stated)
        fit.notes.append(f'Odometry of {robot}: {_odometry_text(bounds, windows)}')
        fit.notes += _not_told(robot, windows)
        fit.notes += _judged_on_the_rest(robot, windows, choice, stated)
        if per != 'all':
            fit.robot_odometry[robot] = _learned_odometry(bounds)
    together = OdometryWindows.joined(found.values())
    bounds = fit_odometry(together, choice, fleet.odometry_error)
    fit.notes.append(f'Odometry of all: {_odometry_text(bounds, together)}')
    fit.notes += _not_told('all', together)
    fit.odometry = _learned_odometry(bounds)
    return frozenset(found)


def _windows_of(
    robot: str, pieces: Sequence[OdometryPiece], truth: TrueTrack, fleet: FleetConfig
) -> OdometryWindows:
    """Return windows of the odometry of a robot; none goes beyond a start anew."""
    parts = []
    for piece in pieces:
        stamps, positions, turns = (np.array(column) for column in zip(*piece, strict=True))
        rotations, upright = rotation_of_quaternion(turns), fleet.is_upright(robot)
        parts.append(
            odometry_windows(stamps, positions, rotations, truth, fleet.dimension, upright)
        )
    return OdometryWindows.joined(parts)


def _learned_odometry(fit: OdometryFit) -> dict[str, float]:
    """Return learned bounds by the names of the parameters; what is stated of others stays."""
    numbers = odometry_error_parameters(fit.model)
    return {name: numbers[name] for name in LEARNED_OF_ODOMETRY}


def _add_stated_odometry(fit: Fit, fleet: FleetConfig, learned: Collection[str]) -> None:
    """
    Add all numbers for each robot that has some of its own already, or nothing to learn from.

    Errors of the file before that are not replaced would be mixed with those learned, and what was
    learned of others would replace those that were stated.
    """
    for robot in filter(learned.__contains__, fleet.robot_odometry_error):
        fit.robot_odometry.setdefault(robot, fit.odometry)
    others = [robot for robot in fleet.robots if robot not in learned]
    for robot in others:
        stated = fleet.robot_odometry_error.get(robot, fleet.odometry_error)
        fit.robot_odometry[robot] = odometry_error_parameters(stated)
    if others:
        fit.notes.append(
            f'Nothing was learned of the odometry of {", ".join(others)}: it is as it was stated.'
        )


def _odometry_text(fit: OdometryFit, windows: OdometryWindows) -> str:
    count = len(windows.seconds)
    excluded = fit.excluded(windows)
    return (
        f'{_bounds_text(fit)}; {count} windows of 0.35 to 40 s, {100.0 * excluded / count:.2f} % '
        'excluded.'
    )


def _bounds_text(fit: OdometryFit) -> str:
    return (
        f'true ways are {fit.translation_scale:.4f} times the reported ones, up to '
        f'{fit.constant_m:.4f} m + {fit.translation_per_m:.4f} per m, turns are within '
        f'{fit.constant_rad:.4f} rad + {fit.rotation_per_rad:.4f} per rad'
    )


def _restarts(robot: str, pieces: Sequence[OdometryPiece]) -> Iterator[str]:
    """Yield how often the odometry of a robot started anew, if it did."""
    if count := len(pieces) - 1:
        times = 'once' if count == 1 else f'{count} times'
        yield (
            f'Odometry of {robot} started anew {times}, by max_speed, max_turn_rate and its '
            'frame: nothing is learned across.'
        )


def _not_told(name: str, windows: OdometryWindows) -> Iterator[str]:
    """Yield what was kept as it was stated, because the robot stood still or never turned."""
    if not windows.tell_ways:
        yield (
            f'Odometry of {name}: no window is longer than {windows.way_m.max():.2f} m, which '
            'tells no error per m. The scale is as it was stated, and errors of ways are no '
            'smaller.'
        )
    if not windows.tell_turns:
        yield (
            f'Odometry of {name}: no window turns by more than {windows.turn_rad.max():.2f} rad, '
            'which tells no error per rad. Errors of turns are no smaller than they were stated.'
        )


def _judged_on_the_rest(
    robot: str, windows: OdometryWindows, choice: Choice, stated: OdometryErrorModel
) -> Iterator[str]:
    """Yield how well what the first half of a recording shows holds for the second."""
    learned, judged = windows.halves()
    if min(len(learned.seconds), len(judged.seconds)) < LEAST_READINGS:
        yield f'The recording is too short to judge the odometry of {robot} on a part of its own.'
        return
    bounds = fit_odometry(learned, choice, stated)
    shares = [100.0 * bounds.excluded(half) / len(half.seconds) for half in (learned, judged)]
    yield (
        f'Learned of the first half alone, {_bounds_text(bounds)}: {shares[0]:.2f} % of its '
        f'windows are excluded, and {shares[1]:.2f} % of those of the second half.'
    )
