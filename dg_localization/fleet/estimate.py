"""What the fleet room answers: placements, the state of every input, and the reason."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TypeAlias

import numpy as np

from dg_localization.solver.result import Statistics, Verdict


class LinkKind(StrEnum):
    """
    What a link measures.

    Peers are ranges and bearings of one robot that come together. Each is also counted, and used,
    as the range or bearing that it is.
    """

    RANGE = 'range'
    BEARING = 'bearing'
    ODOMETRY = 'odometry'
    PEERS = 'peers'


@dataclass(frozen=True, order=True)
class LinkKey:
    """
    One source of measurements: who measures what of whom.

    `target` is empty for odometry, which a robot measures of itself, and for peers.
    """

    kind: LinkKind
    observer: str
    target: str

    def __str__(self) -> str:
        arrow = f'{self.observer}->{self.target}' if self.target else self.observer
        return f'{self.kind} {arrow}'


class RejectionReason(Enum):
    """Why a measurement was not taken."""

    NAN = 'nan'
    NEGATIVE = 'negative'
    ABOVE_MAX = 'above_max'
    BELOW_MIN = 'below_min'
    NOTHING_IN_RANGE = 'nothing_in_range'
    TOO_CLOSE = 'too_close'
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


@dataclass(frozen=True)
class Rejection:
    """A measurement that was not taken: the reason, and a sentence with the value."""

    reason: RejectionReason
    text: str

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class InputState:
    """
    What has arrived on one input since the start or the last reset.

    Parameters
    ----------
    kind : LinkKind
    observer, target : str
        As in the measurements; `target` is empty for odometry.
    accepted : int
        Measurements taken.
    rejected : dict of RejectionReason to int
        Measurements not taken, by reason.
    last_reason_text : str
        The sentence of the last rejection; empty when there was none.
    age_s : float
        Age of the newest measurement taken; inf when there is none.
    in_use : bool
        Whether a measurement of this input is young enough to count.

    """

    kind: LinkKind
    observer: str
    target: str
    accepted: int
    rejected: dict[RejectionReason, int]
    last_reason_text: str
    age_s: float
    in_use: bool


@dataclass(frozen=True)
class LinkState:
    """
    What one link of ranges or bearings says at the time of a snapshot.

    Parameters
    ----------
    kind : LinkKind
    observer, target : str
    lower_m, upper_m : float
        Bounds of the distance at that time, in m, after ageing. A bearing says nothing about
        the distance: [0, inf].
    age_s : float
        Age of the newest measurement.
    stale : bool
        Whether all its measurements are too old, so that it was not used.
    contradicts : bool
        Whether it is part of a contradiction that was found.

    """

    kind: LinkKind
    observer: str
    target: str
    lower_m: float
    upper_m: float
    age_s: float
    stale: bool
    contradicts: bool = False


@dataclass(frozen=True)
class FixedFrame:
    """
    How the frame of an estimate is tied to the fleet.

    Parameters
    ----------
    kind : {'anchors', 'heading', 'robots'}
        Whether the coordinates of the anchors, the body frame of the reference robot as its
        bearings fix it, or the direction from it to another robot define the axes.
    points : tuple of str
        The anchors, the reference robot alone, or the reference robot and the robots that define
        the axes: the second lies on the positive x axis (dimension 3: the third in the half plane
        of positive y).

    """

    kind: str
    points: tuple[str, ...]

    def __str__(self) -> str:
        if self.kind == 'anchors':
            return f'coordinates of the anchors {", ".join(self.points)}'
        if self.kind == 'heading':
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
    One placement of the fleet that agrees with the measurements, and how far it may move.

    Rows are the robots in parameter order.

    Parameters
    ----------
    positions_m : numpy.ndarray, shape (n, q)
        A placement in the fixed frame; NaN where no position is known.
    enclosure_m : numpy.ndarray, shape (n, 2, q)
        Lower and upper coordinates, rounded outward, of everything this placement stands for;
        infinite where the measurements do not bound them.
    orientations_xyzw : numpy.ndarray, shape (n, 4)
        Unit quaternions from body to fixed frame; NaN where the heading is unknown.
    heading_known : numpy.ndarray of bool, shape (n,)
        Whether the bearings of a robot fix its heading.
    heading_half_width_rad : numpy.ndarray, shape (n,)
        Greatest angle between the orientation and the true one; pi where it is unknown.
    proved : bool
        Whether the placement was checked to meet every constraint of the solver.
    flexible : bool
        Whether robots could move on without any measurement changing.
    mirrored : bool
        Whether this is the mirror image of the placement before it, which the measurements
        cannot tell from it.
    dropped : tuple of LinkKey
        The contradicting links this placement does without; empty when all agree.
    landmarks_m : numpy.ndarray, shape (m, q)
        Positions of the anchors that are not robots.
    landmark_enclosure_m : numpy.ndarray, shape (m, 2, q)
        Their enclosures.

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
    dropped: tuple[LinkKey, ...] = ()


Conflict: TypeAlias = tuple[LinkKey, ...]


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
        How many there are in full; those not listed are not checked against the headings.
    statistics : Statistics or None
        Work of the solver.
    links : tuple of LinkState
        Every link that has ever delivered, used or stale.
    conflicts : tuple of tuple of LinkKey
        Minimal sets of links that contradict each other, as far as they were found.
    landmarks : tuple of str
        Names of the anchors that are not robots.
    frame : FixedFrame or None
        How the fixed frame is tied to the fleet; None when there are no placements.

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
    landmarks: tuple[str, ...] = ()
    frame: FixedFrame | None = None
