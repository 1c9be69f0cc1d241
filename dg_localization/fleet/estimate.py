# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The answer of the package: every placement of a fleet, or the reason why there is none."""

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
    """The definition of the axes of a fixed frame."""

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
    The frame of an estimate, and its relation to the fleet.

    Parameters
    ----------
    kind : FrameKind
    points : tuple of str
        The anchors, the reference robot alone, or the reference robot and the robots that define
        the axes: the second lies on the positive x axis (dimension 3: the third in the half plane
        of positive y).
    name : str
        The name of the odometry frame, as the odometry states it.
    restarted_s : float
        The time of the last restart of the odometry, which changed its frame; 0 if it never did.

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

    Rows are the robots in parameter order. The arrays of an estimate are read-only, since the next
    estimate uses them as proved bounds.

    Parameters
    ----------
    positions_m : numpy.ndarray, shape (n, q)
        The best point, a placement in the fixed frame; NaN for unknown positions.
    enclosure_m : numpy.ndarray, shape (n, 2, q)
        Lower and upper coordinates, rounded outward, of all placements that this one represents;
        infinite if the measurements do not bound them.
    orientations_xyzw : numpy.ndarray, shape (n, 4)
        Unit quaternions from body to fixed frame; NaN for unknown headings.
    heading_known : numpy.ndarray of bool, shape (n,)
        Whether the bearings of a robot, or the window, fix its heading.
    heading_half_width_rad : numpy.ndarray, shape (n,)
        Greatest angle between the orientation and the true one; pi if it is unknown.
    proved : bool
        Whether the placement was checked to meet every constraint of the solver, with outward
        rounding. In an odometry frame it was checked before the rotation into that frame, which
        rounds.
    flexible : bool
        Whether robots may be able to move without a change of any measurement. The rotation of a
        robot about its only measured sensor does not count.
    mirrored : bool
        Whether this is the mirror image of a placement before it; the measurements cannot
        distinguish the two. Of a pair, the two follow each other; where parts of both are listed,
        those of the second follow those of the first.
    dropped : tuple of LinkKey
        The contradicting links that are left out here; empty if all agree.
    landmarks_m : numpy.ndarray, shape (m, q)
        Positions of the anchors that are not robots.
    landmark_enclosure_m : numpy.ndarray, shape (m, 2, q)
        Their enclosures.
    covariances : numpy.ndarray, shape (n, 6, 6), or None
        Covariances of each position (m) and of a small rotation about the axes of the fixed frame
        (rad), by least squares. Errors of the moment count as independent, and all errors as
        uniform within their bounds, so there is no guarantee. NaN for unknown positions; None if
        not computed.
    fitted_yaws_rad : numpy.ndarray, shape (n,), or None
        The headings of the best point, in the plane; NaN for headings that were not fitted. Only
        `best_headings` is sure to keep them within the bounds.
    lower_m, upper_m : numpy.ndarray, shape (n, n)
        Bounds of the distances between the robots.
    number : int
        The number of the hypothesis, kept as long as it lives; 0 if it was not followed.
    misfits : tuple of str
        Remembered readings that are farther off the best point than their bounds allow.

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
        """Make the arrays read-only."""
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @cached_property
    def best_headings(self) -> tuple[np.ndarray, np.ndarray]:
        """
        The headings of the best point, and bounds of their errors.

        The orientation of a placement is the middle of its bounds. The best point gives the
        likeliest heading within these bounds.

        Returns
        -------
        orientations_xyzw : numpy.ndarray, shape (n, 4)
            Equal to `orientations_xyzw` if no heading was fitted.
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
    """Return an array of `count` rows with the given values at `rows` and NaN elsewhere."""
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
        The frame of the group: its coordinates must not be compared with those of other frames.
    placements : tuple of Placement
        Placements as in an estimate; robots outside the group are unknown.
    n_hypotheses : int
        The number of all hypotheses.

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
        Time of the snapshot.
    robots : tuple of str
        Row order of every placement.
    verdict : Verdict or None
        The verdict of the solver; None if there was nothing to solve.
    reason : str
        A short sentence that describes the estimate, or says why it is empty.
    placements : tuple of Placement
        At most `max_hypotheses` placements.
    n_hypotheses : int
        The number of all hypotheses; those not listed are not checked against the headings.
    statistics : Statistics or None
        Work of the solver.
    links : tuple of LinkState
        Every link that has ever delivered a reading, used or stale.
    conflicts : tuple of tuple of LinkKey
        Minimal sets of links that contradict each other, as far as they were found.
    suspects : tuple of Suspect
        Suspects of the contradictions: the observations of every minimal set whose removal makes
        the rest agree, or the one sensor or robot that such a set shares. If no set may be
        removed, whatever explains all conflicts alone, else all that is in a conflict.
    suspected_sensors : tuple of Suspect
        The sensors of these suspects and the anchors that they measure, or the suspected robots.
    suspects_in_window : tuple of Suspect
        The observations of the window that explain its contradictions, if `window_outliers`
        tolerates these.
    offenders : tuple of Offender
        The sensors that were suspects recently, most frequent first.
    landmarks : tuple of str
        Names of the anchors that are not robots.
    frame : FixedFrame or None
        The fixed frame; None if there are no placements.
    previous_frame : FixedFrame or None
        The different frame of the estimate before; None if the frame has not changed.
    frame_changes : int
        The number of frame changes so far.
    frame_doubt : str
        A sentence that says why the frame is not the frame of the reference robot; empty if it
        is, or if anchors define the frame.
    groups : tuple of Group
        Groups of robots that are connected to each other, but not to the fixed frame.
    rigid_groups : tuple of tuple of str
        The points that the measurements hold rigid together: each group can only move as a whole.
    would_fix : tuple of str
        What would join two rigid groups or rule out mirror images, as short sentences.
    ruled_out : tuple of str
        Placements of the moment that the window has ruled out, as short sentences.
    forgotten : tuple of Forgotten
        Observations that contradict each other or the moment, and no longer count.
    seconds : mapping of str to float
        Wall times of the stages in s: recalling the window, solving the moment, and narrowing and
        fitting the answer.

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
        """A sentence on the change of the frame; empty if it has not changed."""
        if self.previous_frame is None:
            return ''
        return f'the frame has changed: {self.previous_frame} before, {self.frame} now'

    @property
    def misfits(self) -> tuple[str, ...]:
        """
        Remembered readings farther off the best points than their bounds, as sentences.

        Empty if a hypothesis has none: it may be the true one, and its bounds may hold.
        """
        if not all(place.misfits for place in self.placements):
            return ()
        return tuple(dict.fromkeys(one for place in self.placements for one in place.misfits))
