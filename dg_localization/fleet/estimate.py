# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the package answers: every placement of a fleet, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np

from dg_localization.fleet.contradictions.suspects import Offender, Suspect
from dg_localization.fleet.rotations import nearest_in_arc, quaternion_of_yaw, yaw_of
from dg_localization.fleet.vocabulary import Conflict, LinkKey, LinkState
from dg_localization.fleet.window.forgetting import Forgotten
from dg_localization.solver.result import Statistics, Verdict


class FrameKind(StrEnum):
    """What defines the axes of a fixed frame."""

    ANCHORS = 'anchors'
    """The coordinates of the anchors."""

    ODOMETRY = 'odometry'
    """The odometry frame of the reference robot."""

    HEADING = 'heading'
    """The body frame of the reference robot, which its bearings fix."""

    ROBOTS = 'robots'
    """The directions from the reference robot to other robots."""


@dataclass(frozen=True)
class FixedFrame:
    """
    How the frame of an estimate is tied to the fleet.

    Parameters
    ----------
    kind : FrameKind
    points : tuple of str
        The anchors, the reference robot alone, or the reference robot and the robots that define
        the axes: the second lies on the positive x axis (dimension 3: the third in the half plane
        of positive y).
    name : str
        That of the odometry frame, as the odometry states it.
    restarted_s : float
        When the odometry started anew: its frame has been another one since; 0 for never.

    """

    kind: FrameKind
    points: tuple[str, ...]
    name: str = ''
    restarted_s: float = 0.0

    def __str__(self) -> str:
        if self.kind == FrameKind.ANCHORS:
            return f'coordinates of the anchors {", ".join(self.points)}'
        if self.kind == FrameKind.ODOMETRY:
            restart = f', started anew at {self.restarted_s:.3f} s' if self.restarted_s else ''
            return f'odometry frame {self.name} of {self.points[0]}{restart}'
        if self.kind == FrameKind.HEADING:
            return f'body frame of {self.points[0]}'
        text = f'origin at {self.points[0]}'
        if len(self.points) > 1:
            text += f', x towards {self.points[1]}'
        if len(self.points) > 2:
            text += f', y on the side of {self.points[2]}'
        return text


@dataclass(frozen=True)
class Placement:
    """
    One placement of the fleet that agrees with the measurements, and bounds around it.

    Rows are the robots in parameter order. The arrays of an estimate are read only: what is proved
    of the next estimate starts from them.

    Parameters
    ----------
    positions_m : numpy.ndarray, shape (n, q)
        The best point, a placement in the fixed frame; NaN where no position is known.
    enclosure_m : numpy.ndarray, shape (n, 2, q)
        Lower and upper coordinates, rounded outward, of all placements this one represents;
        infinite where the measurements do not bound them.
    orientations_xyzw : numpy.ndarray, shape (n, 4)
        Unit quaternions from body to fixed frame; NaN where the heading is unknown.
    heading_known : numpy.ndarray of bool, shape (n,)
        Whether the bearings of a robot, or the window, fix its heading.
    heading_half_width_rad : numpy.ndarray, shape (n,)
        Greatest angle between the orientation and the true one; pi where it is unknown.
    proved : bool
        Whether the placement was checked to meet every constraint of the solver, with outward
        rounding. Where bounds are as narrow as rounding errors the check is that before the
        rotation into the fixed frame.
    flexible : bool
        Whether robots may be able to move without any measurement changing. Turning about the
        only sensor that anybody measured does not count.
    mirrored : bool
        Whether this is the mirror image of the placement before it, which the measurements
        cannot tell from it.
    dropped : tuple of LinkKey
        The contradicting links that are left out here; empty when all agree.
    landmarks_m : numpy.ndarray, shape (m, q)
        Positions of the anchors that are not robots.
    landmark_enclosure_m : numpy.ndarray, shape (m, 2, q)
        Their enclosures.
    covariances : numpy.ndarray, shape (n, 6, 6), or None
        Of each position (m) and of a small rotation about the axes of the fixed frame (rad), by
        least squares: for readings whose errors are independent and anywhere in their bounds. It
        holds no guarantee. NaN where no position is known; None when it was not computed.
    fitted_yaws_rad : numpy.ndarray, shape (n,), or None
        The headings of the best point, in the plane; NaN where none was fitted. Only
        `best_headings` is sure to keep them within the bounds.
    lower_m, upper_m : numpy.ndarray, shape (n, n)
        Bounds of the distances between the robots.
    number : int
        The same as long as the hypothesis lives; 0 for one that was not followed.
    misfits : tuple of str
        What is remembered and farther off the best point than its bounds let it be.

    """

    positions_m: np.ndarray
    enclosure_m: np.ndarray
    orientations_xyzw: np.ndarray
    heading_known: np.ndarray
    heading_half_width_rad: np.ndarray
    proved: bool
    flexible: bool
    mirrored: bool
    landmarks_m: np.ndarray
    landmark_enclosure_m: np.ndarray
    lower_m: np.ndarray
    upper_m: np.ndarray
    dropped: tuple[LinkKey, ...] = ()
    covariances: np.ndarray | None = None
    fitted_yaws_rad: np.ndarray | None = None
    number: int = 0
    misfits: tuple[str, ...] = ()

    def protect(self) -> None:
        """Make the arrays read only."""
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @cached_property
    def best_headings(self) -> tuple[np.ndarray, np.ndarray]:
        """
        The headings of the best point, and how far each may be off.

        The orientation of a placement is the one with the narrowest bound around it. The best
        point knows better where in these bounds the heading is likely to be.

        Returns
        -------
        orientations_xyzw : numpy.ndarray, shape (n, 4)
            As `orientations_xyzw` where no heading was fitted.
        half_widths_rad : numpy.ndarray, shape (n,)
            Greatest angles to the true orientations.

        """
        orientations = np.array(self.orientations_xyzw)
        half_widths = np.array(self.heading_half_width_rad)
        if self.fitted_yaws_rad is None:
            return orientations, half_widths
        for robot in np.flatnonzero(self.heading_known & np.isfinite(self.fitted_yaws_rad)):
            fitted_rad, half_rad = float(self.fitted_yaws_rad[robot]), float(half_widths[robot])
            yaw_rad, half_widths[robot] = nearest_in_arc(
                fitted_rad, yaw_of(orientations[robot]), half_rad
            )
            orientations[robot] = quaternion_of_yaw(yaw_rad)
        return orientations, half_widths


def spread_out(count: int, rows: Sequence[int], values: np.ndarray) -> np.ndarray:
    """Return an array of `count` rows, some of which are given; the others are NaN."""
    everything = np.full((count, *values.shape[1:]), np.nan)
    everything[rows] = values
    return everything


@dataclass(frozen=True)
class Group:
    """
    Robots that measurements connect to each other, but not to the fixed frame.

    Parameters
    ----------
    robots : tuple of str
        Their names in parameter order.
    frame : FixedFrame
        A frame of their own: no coordinates in it may be compared with those of another.
    placements : tuple of Placement
        As those of an estimate, unknown where a robot is not in the group.
    n_hypotheses : int
        How many there are in all.

    """

    robots: tuple[str, ...]
    frame: FixedFrame
    placements: tuple[Placement, ...]
    n_hypotheses: int


@dataclass(frozen=True)
class Estimate:
    """
    Every placement of the fleet at one time, or the reason why there is none.

    Parameters
    ----------
    stamp_s : float
        Time of the snapshot this answers.
    robots : tuple of str
        Row order of every placement.
    verdict : Verdict or None
        What the solver proved; None when there was nothing to solve.
    reason : str
        A short sentence on what the estimate is, or why it is empty.
    placements : tuple of Placement
        At most `max_hypotheses` of them.
    n_hypotheses : int
        How many there are in all; those not listed are not checked against the headings.
    statistics : Statistics or None
        Work of the solver.
    links : tuple of LinkState
        Every link that has ever delivered, used or stale.
    conflicts : tuple of tuple of LinkKey
        Minimal sets of links that contradict each other, as far as they were found.
    suspects : tuple of Suspect
        Whom the contradictions make suspect: the observations of every smallest set without which
        the rest agree, or one sensor or robot that they have in common.
    suspected_sensors : tuple of Suspect
        The sensors that these belong to and the anchors that they measure, or the robots that they
        are.
    suspects_in_window : tuple of Suspect
        The observations of the window that explain why it does not agree with itself, where
        `window_outliers` tolerates that.
    offenders : tuple of Offender
        The sensors that were among the suspects lately, those that were most often first.
    landmarks : tuple of str
        Names of the anchors that are not robots.
    frame : FixedFrame or None
        How the fixed frame is tied to the fleet; None when there are no placements.
    previous_frame : FixedFrame or None
        The frame of the placements before, where it was another; None when nothing has changed.
    frame_changes : int
        How often the frame has changed so far.
    frame_doubt : str
        A sentence on why the frame is not that of the reference robot; empty if it is, or if
        anchors make it.
    groups : tuple of Group
        The robots that are not connected to the fixed frame but to each other.
    rigid_groups : tuple of tuple of str
        The points that the measurements hold rigid together: each group can only move as a whole.
    would_fix : tuple of str
        Measurements that would join two of these groups, as short sentences.
    ruled_out : tuple of str
        What of the moment the window has ruled out, as short sentences.
    forgotten : tuple of Forgotten
        What of the window contradicts itself or the moment, and does not count any more.
    seconds : mapping of str to float
        What its parts took on the clock, in s: recalling what is remembered, solving the moment,
        and narrowing and fitting what is left.

    """

    stamp_s: float
    robots: tuple[str, ...]
    verdict: Verdict | None
    reason: str
    placements: tuple[Placement, ...] = ()
    n_hypotheses: int = 0
    statistics: Statistics | None = None
    links: tuple[LinkState, ...] = ()
    conflicts: tuple[Conflict, ...] = ()
    suspects: tuple[Suspect, ...] = ()
    suspected_sensors: tuple[Suspect, ...] = ()
    suspects_in_window: tuple[Suspect, ...] = ()
    offenders: tuple[Offender, ...] = ()
    landmarks: tuple[str, ...] = ()
    frame: FixedFrame | None = None
    previous_frame: FixedFrame | None = None
    frame_changes: int = 0
    frame_doubt: str = ''
    groups: tuple[Group, ...] = ()
    rigid_groups: tuple[tuple[str, ...], ...] = ()
    would_fix: tuple[str, ...] = ()
    ruled_out: tuple[str, ...] = ()
    forgotten: tuple[Forgotten, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict, compare=False)

    @property
    def frame_change(self) -> str:
        """A sentence on how the frame has changed; empty when it has not."""
        if self.previous_frame is None:
            return ''
        return f'the frame has changed: {self.previous_frame} before, {self.frame} now'

    @property
    def misfits(self) -> tuple[str, ...]:
        """What is farther off the best points than its bounds allow, as short sentences."""
        return tuple(dict.fromkeys(one for place in self.placements for one in place.misfits))
