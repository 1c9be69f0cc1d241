# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The scale of odometry and the bounds of its errors, from a comparison with the true path.

The turn and the displacement in many windows, short and long, are compared with the truth. The
displacement sums the measured steps along the true headings, so that an error of the heading does
not count again as an error of translation.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.calibration.bounds import (
    DECIMALS,
    READINGS,
    Choice,
    Columns,
    n_kept,
    without_turns,
)
from dg_localization.calibration.truth import (
    TrueTrack,
    angles_between,
    without_heights,
    without_tilt,
)
from dg_localization.fleet import FleetConfig
from dg_localization.fleet.odometry_error import MOST_SCALE, OdometryErrorModel
from dg_localization.fleet.vocabulary import OdometrySample

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

WINDOWS_S, EVERY_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0), 0.5
SHORTEST = 0.7
"""
Windows are shortened by random shares down to this: windows of whole periods of a clock would hide
errors in step with it.
"""
STRETCHED = 1.5
"""A window longer than this multiple of its length ends after a gap of odometry."""

WAY_M, TURN_RAD = 1.0, 1.0
"""Least longest way and greatest turn of all windows to learn errors of positions and headings."""

SLOPES = np.linspace(0.0, 1.0, 401)
"""Errors per m or per rad that are tried."""


@dataclass(frozen=True)
class OdometryWindows(Columns):
    """
    Windows of odometry compared with the truth.

    Attributes
    ----------
    begin_s, seconds : ndarray, shape (k,)
        Their begin and their length.
    way_m, turn_rad : ndarray, shape (k,)
        Path length and total turn along the samples.
    stated_m, true_m : ndarray, shape (k, 3)
        Displacements from begin to end, by the samples along true headings and in truth; in the
        plane their heights are zero.
    error_rad : ndarray, shape (k,)
        Errors of the turn: about the vertical axis, or of the whole body.

    """

    begin_s: FloatArray
    seconds: FloatArray
    way_m: FloatArray
    turn_rad: FloatArray
    stated_m: FloatArray
    true_m: FloatArray
    error_rad: FloatArray

    def errors_m(self, scale: float) -> FloatArray:
        """Return the errors of the scaled displacements, shape (k,)."""
        return np.asarray(np.linalg.norm(scale * self.stated_m - self.true_m, axis=1))

    @property
    def tell_ways(self) -> bool:
        """Whether the robot went far enough to learn the scale and the errors of translation."""
        return bool(self.way_m.max() >= WAY_M)

    @property
    def tell_turns(self) -> bool:
        """Whether the robot turned far enough to learn the errors of turns."""
        return bool(self.turn_rad.max() >= TURN_RAD)


def n_excluded(model: OdometryErrorModel, windows: OdometryWindows) -> int:
    """Return the number of windows that exceed the bounds of a model."""
    ways_m = model.translation_scale * windows.way_m
    of_ways_m = model.translation_per_m * ways_m + model.translation_per_rad * windows.turn_rad
    of_turns_rad = model.rotation_per_m * ways_m + model.rotation_per_rad * windows.turn_rad
    beyond_m = windows.errors_m(model.translation_scale) > model.constant_m + of_ways_m
    beyond_rad = windows.error_rad > model.constant_rad + of_turns_rad
    return int(np.count_nonzero(beyond_m | beyond_rad))


def odometry_windows(
    stamps_s: ArrayLike,
    positions_m: ArrayLike,
    rotations: ArrayLike,
    truth: TrueTrack,
    dimension: int = 2,
    upright: bool = True,
) -> OdometryWindows:
    """
    Compare odometry with the truth over windows of about 0.5 to 40 s.

    Parameters
    ----------
    stamps_s : array_like, shape (n,)
        Increasing.
    positions_m : array_like, shape (n, 3)
    rotations : array_like, shape (n, 3, 3)
        From body to odometry frame.
    truth : TrueTrack
    dimension : {2, 3}, optional
        In the plane only headings turn, and heights, roll and pitch of the truth do not count. A
        reported rise still counts as a part of the path, as in the localizer.
    upright : bool, optional
        Whether errors of roll and pitch are stated separately, so that errors of turns are errors
        of headings. Then steps are seen from level frames, as by the localizer: the effect of
        wrong roll and pitch on a step counts as an error of translation.

    """
    stamps = np.asarray(stamps_s, dtype=float)
    turns = without_tilt(np.asarray(rotations, dtype=float), dimension)
    true_m = without_heights(truth.positions_at(stamps), dimension)
    true = without_tilt(truth.rotations_at(stamps), dimension)
    steps_m = np.diff(np.asarray(positions_m, dtype=float), axis=0)
    bodies, true_bodies = (without_tilt(r[:-1], 2) if upright else r[:-1] for r in (turns, true))
    in_body = np.einsum('mji,mj->mi', bodies, without_heights(steps_m, dimension))
    along_m = np.einsum('mij,mj->mi', true_bodies, in_body)
    yaws, true_yaws = (np.arctan2(r[:, 1, 0], r[:, 0, 0]) for r in (turns, true))
    off_rad = yaws - true_yaws
    way_m = _cumulative(np.linalg.norm(steps_m, axis=1))
    steps_rad = np.abs(without_turns(np.diff(yaws)))
    if dimension == 3:
        steps_rad = angles_between(turns[:-1], turns[1:])
    turned_rad = _cumulative(steps_rad)
    first, last = _spans(stamps)
    whole_m = np.array([along_m[a:b].sum(axis=0) for a, b in zip(first, last, strict=True)])
    error_rad = without_turns(off_rad[last] - off_rad[first])
    if not upright:
        error_rad = angles_between(*(np.swapaxes(r[first], 1, 2) @ r[last] for r in (turns, true)))
    found = OdometryWindows(
        stamps[first],
        stamps[last] - stamps[first],
        way_m[last] - way_m[first],
        turned_rad[last] - turned_rad[first],
        whole_m.reshape(-1, 3),
        true_m[last] - true_m[first],
        np.abs(error_rad),
    )
    columns = np.column_stack([*vars(found).values()])
    return found.chosen(np.asarray(np.isfinite(columns).all(axis=1)))


def fit_odometry(
    windows: OdometryWindows, choice: Choice, stated: OdometryErrorModel | None = None
) -> OdometryErrorModel:
    """
    Return the scale of translation, and a constant and a slope for translation and for turns.

    The scale is the one of least squares, or 1 if that makes the bounds of translation narrower.

    Parameters
    ----------
    windows : OdometryWindows
        At least one.
    choice : Choice
    stated : OdometryErrorModel, optional
        If the windows are too short to learn translation, its scale is kept and its errors of
        translation are lower limits; likewise for turns. Without it there are no such limits.

    """
    stated = stated or OdometryErrorModel()
    scales: tuple[float, ...] = (stated.translation_scale,)
    if windows.tell_ways:
        scales = (1.0, _least_squares_scale(windows))
    lines = [
        (scale, *_fit_line(scale * windows.way_m, windows.errors_m(scale), choice))
        for scale in scales
    ]
    way_m = float(np.mean(windows.way_m))
    scale, constant_m, per_m = min(lines, key=lambda line: line[1] + line[2] * line[0] * way_m)
    constant_rad, per_rad = _fit_line(windows.turn_rad, windows.error_rad, choice)
    fit = OdometryErrorModel(
        translation_scale=scale,
        translation_per_m=per_m,
        rotation_per_rad=per_rad,
        constant_m=constant_m,
        constant_rad=constant_rad,
    )
    for tells, names in (
        (windows.tell_ways, ('constant_m', 'translation_per_m', 'translation_per_rad')),
        (windows.tell_turns, ('constant_rad', 'rotation_per_m', 'rotation_per_rad')),
    ):
        if not tells:
            least = {name: max(getattr(fit, name), getattr(stated, name)) for name in names}
            fit = replace(fit, **least)
    return fit


ALL = ''
"""The key of the bounds of all robots."""


def learn_odometry(
    odometry: Mapping[str, Sequence[Sequence[OdometrySample]]],
    fleet: FleetConfig,
    tracks: Mapping[str, TrueTrack],
    choice: Choice,
    of_each: bool,
) -> tuple[dict[str, OdometryErrorModel], list[str]]:
    """
    Return the learned bounds of odometry by robot, and sentences on them; both may be empty.

    They are the bounds of all robots, and those of each robot or of each that needs its own.
    """
    notes: list[str] = []
    found: dict[str, OdometryWindows] = {}
    for robot in filter(tracks.__contains__, sorted(odometry)):
        pieces = odometry[robot]
        how = tracks[robot], fleet.dimension, fleet.is_upright(robot)
        windows = OdometryWindows.joined(
            odometry_windows(
                [sample.stamp_s for sample in piece],
                [sample.position_in_frame_m for sample in piece],
                [sample.rotation for sample in piece],
                *how,
            )
            for piece in pieces
        )
        if len(pieces) > 1:
            notes.append(f'Odometry of {robot} started anew {len(pieces) - 1} times.')
        if len(windows.seconds) >= READINGS:
            found[robot] = windows
    if not found:
        return {}, notes
    models: dict[str, OdometryErrorModel] = {}
    for robot, windows in found.items():
        model = fit_odometry(windows, choice, fleet.odometry_error_of(robot))
        notes += _texts(robot, model, windows)
        # Errors stated for one robot would otherwise be mixed with the errors of all.
        if of_each:
            models[robot] = model
    together = OdometryWindows.joined(found.values())
    model = models[ALL] = fit_odometry(together, choice, fleet.odometry_error)
    notes += _texts('all', model, together)
    for robot in filter(found.__contains__, fleet.robot_odometry_error):
        models.setdefault(robot, model)
    if others := [robot for robot in fleet.robots if robot not in found]:
        # Bounds learned from other robots would replace the stated ones of these.
        models |= {robot: fleet.odometry_error_of(robot) for robot in others}
        notes.append(
            f'Nothing was learned about the odometry of {", ".join(others)}: it is as stated.'
        )
    return models, notes


def _texts(name: str, model: OdometryErrorModel, windows: OdometryWindows) -> Iterator[str]:
    """Yield notes on the learned bounds, and on the stated bounds kept for a robot at rest."""
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


def _least_squares_scale(windows: OdometryWindows) -> float:
    """Return the best scale of translation, in the printed decimals."""
    squares_m2 = float(np.sum(windows.stated_m**2))
    if squares_m2 == 0.0:
        return 1.0
    scale = round(float(np.sum(windows.stated_m * windows.true_m)) / squares_m2, DECIMALS)
    return scale if 1.0 / MOST_SCALE <= scale <= MOST_SCALE else 1.0


def _fit_line(way: FloatArray, error: FloatArray, choice: Choice) -> tuple[float, float]:
    """Return the constant and slope that hold the errors with the least mean bound."""
    kept = n_kept(len(way), choice.keep)
    constants = np.array([np.partition(error - s * way, kept - 1)[kept - 1] for s in SLOPES])
    constants = np.maximum(constants, 0.0)
    best = int(np.argmin(constants + SLOPES * np.mean(way)))
    scale = 10.0**DECIMALS
    widened = (1.0 + choice.margin) * scale * np.array([constants[best], SLOPES[best]])
    constant, slope = np.ceil(widened) / scale
    return float(constant), float(slope)


def _spans(stamps_s: FloatArray) -> tuple[IndexArray, IndexArray]:
    """
    Return the first and the last samples of windows, equally many of each length.

    It steps through the samples, not through time: one wrong stamp would make that years long.
    """
    pieces = np.floor((stamps_s - stamps_s[0]) / EVERY_S)
    first, rng = np.unique(pieces, return_index=True)[1], np.random.default_rng(0)
    found = []
    for seconds in WINDOWS_S:
        lengths_s = seconds * rng.uniform(SHORTEST, 1.0, len(first))
        last = np.searchsorted(stamps_s, stamps_s[first] + lengths_s)
        spans_s = np.append(stamps_s, np.inf)[last] - stamps_s[first]
        found.append(np.array([first, last])[:, spans_s < STRETCHED * lengths_s])
    firsts, lasts = np.concatenate(found, axis=1)
    return firsts, lasts


def _cumulative(steps: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(steps)])
