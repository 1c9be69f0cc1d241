# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What goes into the package `fleet`: links, readings, and what became of each input.

A reading is made once, when a measurement is accepted. From there to the problem it is carried
with its key; aging and turning change its numbers, not its type.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
import math
from typing import NamedTuple, TypeAlias

import numpy as np


class LinkKind(StrEnum):
    """
    What a link measures.

    Peers are ranges and bearings that one robot sends together. Each of them is also counted, and
    used, as a range, a bearing or a range difference. A camera is what turns its pixels into
    bearings. An elevation is that of the observer itself. A range difference is by how much the
    target is farther away than the reference.
    """

    RANGE = 'range'
    BEARING = 'bearing'
    RANGE_DIFFERENCE = 'range_difference'
    ODOMETRY = 'odometry'
    ELEVATION = 'elevation'
    PEERS = 'peers'
    CAMERA = 'camera'


class LinkKey(NamedTuple):
    """
    One source of measurements: who measures what of whom.

    `target` is empty for odometry and elevations, which a robot measures of itself, and for peers,
    `reference` for all but range differences.
    Every reading is looked up by its key several times, and tuples are compared and hashed fast.
    """

    kind: LinkKind
    observer: str
    target: str
    reference: str = ''

    @property
    def points(self) -> tuple[str, ...]:
        """The observer, the target, and the reference where there is one."""
        return (*self.ends, self.reference) if self.reference else self.ends

    @property
    def ends(self) -> tuple[str, str]:
        """The observer and the target."""
        return self.observer, self.target

    def __str__(self) -> str:
        arrow = f'{self.observer}->{self.target}' if self.target else self.observer
        return (
            f'{self.kind} {arrow}-{self.reference}' if self.reference else f'{self.kind} {arrow}'
        )


Conflict: TypeAlias = tuple[LinkKey, ...]
"""Links that contradict each other."""


@dataclass(frozen=True)
class DistanceReading:
    """
    Bounds of the distance of two points at one time; in the plane, of their projections on it.

    Those of a range difference are of the difference of two distances, in space.

    Parameters
    ----------
    key : LinkKey
        Its observer and its target are the two points.
    stamp_s : float
        The time at which the bounds hold.
    lower_m, upper_m : float
        Rounded outward. ``lower_m > upper_m`` when no distance agrees with what was measured.
    likeliest_m : float
        The likeliest distance; NaN when the reading says only what it is not.
    in_space_m : tuple of float, optional
        What those in the plane were made of: bounds of the distance in space, of two points at
        different elevations.

    """

    key: LinkKey
    stamp_s: float
    lower_m: float
    upper_m: float
    likeliest_m: float = math.nan
    in_space_m: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class RayReading:
    """
    The direction from one point to another, in the body frame of the observer.

    Parameters
    ----------
    key : LinkKey
        Who sees whom.
    stamp_s : float
        The time of the body frame.
    direction : numpy.ndarray, shape (3,)
        Unit vector.
    half_width_rad : float
        Greatest angle to the true direction.
    expected_error_rad : float
        Its likeliest error about the vertical axis, counterclockwise.
    displacement_m : float
        How far both ends together can have moved since the direction was measured. It is not yet
        part of the half width.

    """

    key: LinkKey
    stamp_s: float
    direction: np.ndarray
    half_width_rad: float
    expected_error_rad: float = 0.0
    displacement_m: float = 0.0


@dataclass(frozen=True, eq=False)
class OdometrySample:
    """
    One pose of a robot in its own odometry frame.

    Parameters
    ----------
    stamp_s : float
    position_m : numpy.ndarray, shape (3,)
        On the track: as reported, times the scale of its odometry.
    rotation : numpy.ndarray, shape (3, 3)
        From body to odometry frame.
    frame : str
        The name of the odometry frame; empty where it has none.
    restarted_s : float
        When this odometry started anew, as far as it showed; 0 when it never did.
    way_m, turned_rad : float
        Sums of the steps and of the turns since the odometry began, rounded up: what lies between
        two readings is at most the difference.
    reported_m : numpy.ndarray, shape (3,), optional
        The position that was reported, in the odometry frame; by default that on the track.

    """

    stamp_s: float
    position_m: np.ndarray
    rotation: np.ndarray
    frame: str = ''
    restarted_s: float = 0.0
    way_m: float = 0.0
    turned_rad: float = 0.0
    reported_m: np.ndarray | None = None

    @property
    def position_in_frame_m(self) -> np.ndarray:
        """The position in the odometry frame, as it was reported."""
        return self.position_m if self.reported_m is None else self.reported_m


class RejectionReason(Enum):
    """Why a measurement was not accepted."""

    NAN = 'nan'
    NEGATIVE = 'negative'
    ABOVE_MAX = 'above_max'
    BELOW_MIN = 'below_min'
    NO_READING = 'no_reading'
    NOTHING_IN_RANGE = 'nothing_in_range'
    TOO_CLOSE = 'too_close'
    INVALID_RANGE = 'invalid_range'
    INVALID_VARIANCE = 'invalid_variance'
    UNKNOWN_ROBOT = 'unknown_robot'
    SAME_ROBOT = 'same_robot'
    TOO_OLD = 'too_old'
    FUTURE = 'future'
    ZERO_STAMP = 'zero_stamp'
    INVALID_STAMP = 'invalid_stamp'
    ZERO_RAY = 'zero_ray'
    INVALID_RAY = 'invalid_ray'
    INVALID_ODOMETRY = 'invalid_odometry'
    INVALID_ELEVATION = 'invalid_elevation'
    INVALID_PEER = 'invalid_peer'
    SEVERAL_BODIES = 'several_bodies'
    STUCK = 'stuck'


@dataclass(frozen=True)
class Rejection:
    """A measurement that was not accepted: the reason, and a sentence with the value."""

    reason: RejectionReason
    text: str

    def __str__(self) -> str:
        return self.text


class RefusedError(Exception):
    """A measurement that cannot be used, while it is taken in; `rejection` says why."""

    def __init__(self, reason: RejectionReason, text: str) -> None:
        super().__init__(text)
        self.rejection = Rejection(reason, text)


class RangeMessage(NamedTuple):
    """A range as it came: in m, with the limits of the sensor (REP-117) and its variance."""

    range_m: object
    min_range_m: float | None = None
    max_range_m: float | None = None
    variance_m2: float | None = None


@dataclass(frozen=True)
class InputState:
    """
    What has arrived on one input since the start or the last reset.

    Parameters
    ----------
    key : LinkKey
    accepted : int
        Number of accepted measurements.
    rejected : dict of RejectionReason to int
        Number of rejected measurements, by reason.
    last_reason_text : str
        The sentence of the last rejection; empty when there was none.
    age_s : float
        Age of the newest accepted measurement; inf when there is none.
    in_use : bool
        Whether a measurement of this input is young enough to count.
    stuck : str
        A sentence on readings that repeat themselves although robots move; empty if they do not.
    restart : str
        A sentence on odometry that has started anew within `max_age_s`; empty if it has not.
    warning : str
        A sentence on settings that its measurements show to be wrong; empty if they do not.

    """

    key: LinkKey
    accepted: int
    rejected: dict[RejectionReason, int]
    last_reason_text: str
    age_s: float
    in_use: bool
    stuck: str = ''
    restart: str = ''
    warning: str = ''


@dataclass(frozen=True)
class LinkState:
    """
    What one link of ranges or bearings says at the time of a snapshot.

    Parameters
    ----------
    key : LinkKey
    lower_m, upper_m : float
        Bounds of the distance at that time, in m, after aging; in the plane, between the
        projections of both ends on it. A bearing says nothing about the distance: [0, inf].
    age_s : float
        Age of the newest measurement.
    stale : bool
        Whether it was not used since all its measurements are too old, or later than the answer.
    contradicts : bool
        Whether it is part of a contradiction that was found. A link that contradicts what was
        measured before is left out.

    """

    key: LinkKey
    lower_m: float
    upper_m: float
    age_s: float
    stale: bool
    contradicts: bool = False

    def __str__(self) -> str:
        bounds = (
            f' ({self.lower_m:.2f} to {self.upper_m:.2f} m)' if self.upper_m < math.inf else ''
        )
        return f'{self.key}{bounds}'
