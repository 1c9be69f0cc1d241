# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Answers of the localizer compared with the truth: in numbers and in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import re

import numpy as np
from numpy.typing import NDArray

from dg_localization.ros.executables import ExecutableError
from dg_localization.simulation.moving_fleet import ROBOTS, rotation

# A robot that defines an axis has an enclosure of no width there, and the truth, when turned into
# that frame, is rounded.
ROUNDING_M = 1e-9
# Placements this close to mirror images of each other are.
MIRROR_M = 1e-6


class DemoError(ExecutableError):
    """The demonstration cannot go on; the text says why."""


@dataclass(frozen=True)
class Truth:
    """The true positions (n, 2) in m and headings (n,) in rad at a time in s."""

    stamp_s: float
    positions_m: NDArray[np.float64]
    yaws_rad: NDArray[np.float64]

    def in_frame(self, frame: str) -> 'Truth':
        """
        Return the truth in the fixed frame of the localizer.

        Parameters
        ----------
        frame : str
            How the diagnostics describe it: 'body frame of A' or 'origin at A, x towards B'. An
            odometry frame needs more (`in_odometry_frame`).

        Raises
        ------
        DemoError
            If it is described otherwise.

        """
        body = re.fullmatch(r'body frame of (\w+)', frame)
        towards = re.match(r'origin at (\w+), x towards (\w+)', frame)
        if body:
            origin = ROBOTS.index(body[1])
            yaw_rad = self.yaws_rad[origin]
        elif towards:
            origin = ROBOTS.index(towards[1])
            x, y = self.positions_m[ROBOTS.index(towards[2])] - self.positions_m[origin]
            yaw_rad = np.arctan2(y, x)
        else:
            raise DemoError(f"the localizer describes its frame as '{frame}'")
        positions_m = (self.positions_m - self.positions_m[origin]) @ rotation(yaw_rad)
        return Truth(self.stamp_s, positions_m, self.yaws_rad - yaw_rad)

    def in_odometry_frame(self, stated: 'StatedPose', then: 'Truth') -> 'Truth':
        """
        Return the truth in the odometry frame of a robot.

        Parameters
        ----------
        stated : StatedPose
            What the odometry stated last; by definition it is true in this frame.
        then : Truth
            At the time of that.

        """
        origin = ROBOTS.index(stated.robot)
        turn_rad = stated.yaw_rad - then.yaws_rad[origin]
        positions_m = (self.positions_m - then.positions_m[origin]) @ rotation(turn_rad).T
        return Truth(self.stamp_s, positions_m + stated.position_m, self.yaws_rad + turn_rad)


@dataclass(frozen=True)
class StatedPose:
    """Where a robot is by its odometry at a time in s: position (2,) in m, heading in rad."""

    robot: str
    stamp_s: float
    position_m: NDArray[np.float64]
    yaw_rad: float


def frame_of(frame_id: str) -> str:
    """Return the description of a frame by its name; empty for one of a shape only."""
    robot, _, kind = frame_id.partition('/')
    if kind == 'odom':
        return f'odometry frame {frame_id} of {robot}'
    return f'body frame of {robot}' if kind else ''


def robot_of_odometry_frame(frame: str) -> str | None:
    """Return whose odometry frame the diagnostics describe; None for another frame."""
    found = re.match(r'odometry frame \S+ of (\w+)', frame)
    return found[1] if found else None


@dataclass(frozen=True)
class Answer:
    """
    Every feasible placement at one time, from the topics of the localizer.

    Attributes
    ----------
    stamp_s : float
        Its time.
    positions_m : ndarray, shape (k, n, 2)
        One placement of each hypothesis.
    yaws_rad : ndarray, shape (k, n)
        Headings; NaN where unknown.
    enclosures_m : ndarray, shape (k, n, 2, 2)
        Lower and upper coordinates of each robot in each hypothesis.

    """

    stamp_s: float
    positions_m: NDArray[np.float64]
    yaws_rad: NDArray[np.float64]
    enclosures_m: NDArray[np.float64]

    def holds(self, truth: Truth) -> NDArray[np.bool_]:
        """
        Return which enclosures hold which true positions.

        Parameters
        ----------
        truth : Truth
            In the frame of this answer.

        Returns
        -------
        ndarray of bool, shape (k, n)
            By hypothesis and robot.

        """
        lower, upper = self.enclosures_m[:, :, 0], self.enclosures_m[:, :, 1]
        beyond_m = np.maximum(lower - truth.positions_m, truth.positions_m - upper)
        inside = beyond_m <= ROUNDING_M
        return np.asarray(inside.all(axis=-1))


@dataclass(frozen=True)
class Compared:
    """An answer and the truth of its time, both in the fixed frame that is described in words."""

    answer: Answer
    truth: Truth
    frame: str

    @property
    def held_by(self) -> NDArray[np.int64]:
        """The hypotheses that hold the truth of all robots at once."""
        return np.flatnonzero(self.answer.holds(self.truth).all(axis=1))


@dataclass
class Scenario:
    """
    One phase of the demonstration, and what came out of it.

    Attributes
    ----------
    title : str
    seconds : float
        How long it lasts, from the first answer.
    simulator, localizer : mapping of str to object
        Parameters of the two executables.
    compared : list of Compared
        Every answer with placements.
    contradictions : set of float
        The stamps in s of answers without any, as far as the diagnostics name them.

    """

    title: str
    seconds: float
    simulator: Mapping[str, object]
    localizer: Mapping[str, object] = field(default_factory=dict)
    compared: list[Compared] = field(default_factory=list)
    contradictions: set[float] = field(default_factory=set)

    @property
    def last(self) -> Compared:
        """The newest answer."""
        return self.compared[-1]

    @property
    def n_held(self) -> int:
        """How many answers hold the truth."""
        return sum(len(compared.held_by) > 0 for compared in self.compared)

    @property
    def always_held(self) -> bool:
        """Whether every answer holds the truth."""
        return self.n_held == len(self.compared) and not self.contradictions


def yaws_of(orientations_xyzw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the turns about z of quaternions (..., 4); NaN for the zero quaternion."""
    x, y, z, w = np.moveaxis(orientations_xyzw, -1, 0)
    yaws_rad = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return np.where(np.any(orientations_xyzw != 0.0, axis=-1), yaws_rad, np.nan)


def truth_at(truths: Sequence[Truth], stamp_s: float) -> Truth | None:
    """
    Interpolate the truth.

    Parameters
    ----------
    truths : sequence of Truth
        In the order of their stamps.
    stamp_s : float
        The time wanted.

    Returns
    -------
    Truth or None
        None before the first and after the last.

    """
    for before, after in zip(truths, list(truths)[1:], strict=False):
        if before.stamp_s <= stamp_s <= after.stamp_s:
            share = (stamp_s - before.stamp_s) / (after.stamp_s - before.stamp_s)
            turn_rad = (after.yaws_rad - before.yaws_rad + np.pi) % (2.0 * np.pi) - np.pi
            return Truth(
                stamp_s,
                before.positions_m + share * (after.positions_m - before.positions_m),
                before.yaws_rad + share * turn_rad,
            )
    return None


def count_text(answer: Answer) -> str:
    """Return the number of hypotheses, and whether half of them mirror the rest, in words."""
    count = len(answer.positions_m)
    mirrored = answer.positions_m * [1.0, -1.0]
    gaps_m = np.abs(answer.positions_m[:, None] - mirrored[None]).max(axis=(2, 3))
    if count == 1 or (gaps_m.min(axis=1) >= MIRROR_M).any():
        return f'{count} hypotheses' if count > 1 else '1 hypothesis'
    if count == 2:
        return '1 hypothesis and its mirror image'
    return f'{count // 2} hypotheses and their mirror images'


def table(compared: Compared) -> str:
    """
    Write the hypotheses under the truth.

    Parameters
    ----------
    compared : Compared
        The answer and the truth.

    Returns
    -------
    str
        Lines for the truth and for each hypothesis: x and y of each robot in m, a star where
        the enclosure holds the true position, and headings in degrees where they are known.

    """
    answer, truth = compared.answer, compared.truth
    holds = answer.holds(truth)
    held_by = set(compared.held_by)
    headings = bool(np.isfinite(answer.yaws_rad).any())
    nowhere = np.zeros(len(ROBOTS), bool)
    lines = [
        f'  frame: {compared.frame} (x, y in m)',
        '        ' + ''.join(robot.rjust(14) + ' ' for robot in ROBOTS),
        '   truth' + _position_cells(truth.positions_m, nowhere),
    ]
    if headings:
        lines.append(' heading' + _heading_cells(truth.yaws_rad))
    for k, positions_m in enumerate(answer.positions_m):
        pointer = '->' if k in held_by else '  '
        lines.append(f'{pointer}{k + 1:6d}' + _position_cells(positions_m, holds[k]))
        if headings:
            lines.append(' heading' + _heading_cells(answer.yaws_rad[k]))
    lines.append('  * holds the true position of the robot; -> holds the truth of all at once')
    return '\n'.join(lines)


def _position_cells(positions_m: NDArray[np.float64], starred: NDArray[np.bool_]) -> str:
    return ''.join(
        f'{x:7.2f}{y:7.2f}{"*" if star else " "}'
        for (x, y), star in zip(positions_m, starred, strict=True)
    )


def _heading_cells(yaws_rad: NDArray[np.float64]) -> str:
    degrees = (np.degrees(yaws_rad) + 180.0) % 360.0 - 180.0
    return ''.join(
        f'{value:13.1f}\N{DEGREE SIGN} ' if np.isfinite(value) else f'{"?":>14} '
        for value in degrees
    )


def summary(scenario: Scenario) -> str:
    """Write the table of a scenario, and how often and how closely the truth was held."""
    compared = scenario.last
    answer = compared.answer
    widths_m = np.ptp(answer.enclosures_m, axis=2).max(axis=-1)
    gaps_m = [
        np.linalg.norm(answer.positions_m[k] - compared.truth.positions_m, axis=1).max()
        for k in compared.held_by
    ]
    nearest = f', at last {min(gaps_m):.2f} m from its placement' if gaps_m else ''
    empty = ''
    if scenario.contradictions:
        empty = (
            f'  At least {len(scenario.contradictions)} more answers have no placement: the '
            'measurements contradict each other.\n'
        )
    return (
        f'{table(compared)}\n'
        f'  {count_text(answer)}; truth held in {scenario.n_held} of '
        f'{len(scenario.compared)} answers{nearest}.\n'
        f'{empty}'
        f'  Enclosures are {np.median(widths_m):.2f} m wide in the median.\n'
        f'  {progress(scenario.compared)}\n'
    )


def progress(compared: Sequence[Compared]) -> str:
    """Return how the number of hypotheses and of known headings went, in words."""
    first, last = compared[0].answer, compared[-1].answer
    counts = f'hypotheses: {len(first.positions_m)} at first, {len(last.positions_m)} at last'
    alone = [one.answer.stamp_s for one in compared if len(one.answer.positions_m) == 1]
    since = f' (one after {min(alone) - first.stamp_s:.1f} s)' if alone else ''
    n_known = int(np.isfinite(last.yaws_rad).all(axis=0).sum())
    return f'{counts}{since}; headings of {n_known} of {len(ROBOTS)} robots are known.'
