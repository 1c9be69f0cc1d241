# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Inputs of the package `fleet`: links, readings, and states of inputs.

A reading is made once, when a measurement is accepted, and keeps its key until the problem is
made. Aging and rotation change its numbers, not its type.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
import math
from typing import NamedTuple, TypeAlias

import numpy as np


class LinkKind(StrEnum):
    """
    The kind of measurements of a link.

    Peers are measurements that one robot sends together. Each of them is also counted and used as
    a range, a bearing or a range difference. A camera input holds the calibration that converts
    pixels to bearings. An elevation belongs to the observer itself. A range difference is the
    distance to the target minus the distance to the reference.
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
    One source of measurements: the kind, the observer, the target and the reference.

    `target` is empty for odometry, elevations and peers. `reference` is empty except for range
    differences. Keys are tuples because every reading is looked up several times, and tuples are
    compared and hashed fast.
    """

    kind: LinkKind
    observer: str
    target: str
    reference: str = ''

    @property
    def points(self) -> tuple[str, ...]:
        """The observer, the target, and the reference if there is one."""
        return (*self.ends, self.reference) if self.reference else self.ends

    @property
    def ends(self) -> tuple[str, str]:
        """The observer and the target."""
        return self.observer, self.target

    def __str__(self) -> str:
        target = f'->{self.target}' if self.target else ''
        reference = f'-{self.reference}' if self.reference else ''
        return f'{self.kind} {self.observer}{target}{reference}'


Conflict: TypeAlias = tuple[LinkKey, ...]
"""Links that contradict each other."""


@dataclass(frozen=True)
class DistanceReading:
    """
    Bounds of the distance of two points at one time; in the plane, of their projections.

    For a range difference they bound the difference of two distances in space.

    Parameters
    ----------
    key : LinkKey
        Its observer and its target are the two points.
    stamp_s : float
        The time at which the bounds hold.
    lower_m, upper_m : float
        Rounded outward. ``lower_m > upper_m`` if no distance agrees with the measurement.
    likeliest_m : float
        The likeliest distance; NaN if the reading only excludes distances.
    in_space_m : tuple of float, optional
        The bounds of the distance in space from which the bounds in the plane were made, for two
        points at different elevations.

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
        The observer and the target.
    stamp_s : float
        The time of the body frame.
    direction : numpy.ndarray, shape (3,)
        Unit vector.
    half_width_rad : float
        Greatest angle to the true direction.
    expected_error_rad : float
        Its likeliest error about the vertical axis, counterclockwise.
    displacement_m : float
        Greatest displacement of both ends together since the direction was measured. It is not
        yet part of the half width.

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
        The name of the odometry frame; empty if it has none.
    restarted_s : float
        The time of the last detected restart of the odometry; 0 if there was none.
    way_m, turned_rad : float
        Sums of the steps and of the turns since the odometry began, rounded up: their differences
        bound the path between two readings.
    reported_m : numpy.ndarray, shape (3,), optional
        The reported position in the odometry frame; by default the position on the track.

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
        """The reported position in the odometry frame."""
        return self.position_m if self.reported_m is None else self.reported_m


class RejectionReason(Enum):
    """The reason why a measurement was not accepted."""

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
    """Raised during intake for a measurement that cannot be used; `rejection` says why."""

    def __init__(self, reason: RejectionReason, text: str) -> None:
        super().__init__(text)
        self.rejection = Rejection(reason, text)


class RangeMessage(NamedTuple):
    """A range as received: in m, with the limits of the sensor (REP-117) and its variance."""

    range_m: object
    min_range_m: float | None = None
    max_range_m: float | None = None
    variance_m2: float | None = None


@dataclass(frozen=True)
class InputState:
    """
    The state of one input since the start or the last reset.

    Parameters
    ----------
    key : LinkKey
    accepted : int
        Number of accepted measurements.
    rejected : dict of RejectionReason to int
        Number of rejected measurements, by reason.
    last_reason_text : str
        The sentence of the last rejection; empty if there was none.
    age_s : float
        Age of the newest accepted measurement; inf if there is none.
    in_use : bool
        Whether a measurement of this input is young enough to count.
    stuck : str
        A sentence on readings that stay equal although robots move; empty if they do not.
    restart : str
        A sentence on odometry that restarted within `max_age_s`; empty if it did not.
    warning : str
        A sentence on settings that the measurements refute; empty if there are none.

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
    The state of one link of ranges, bearings or range differences at the time of a snapshot.

    Parameters
    ----------
    key : LinkKey
    lower_m, upper_m : float
        Bounds of the distance at that time, in m, after aging; in the plane, between the
        projections of both ends. Bearings and range differences do not bound it: [0, inf].
    age_s : float
        Age of the newest measurement.
    stale : bool
        Whether it is unused because all its measurements are too old, or later than the answer.
    contradicts : bool
        Whether it is part of a detected contradiction. A link that contradicts earlier
        measurements is left out.

    """

    key: LinkKey
    lower_m: float
    upper_m: float
    age_s: float
    stale: bool
    contradicts: bool = False

    def __str__(self) -> str:
        if self.upper_m == math.inf:
            return str(self.key)
        return f'{self.key} ({self.lower_m:.2f} to {self.upper_m:.2f} m)'
