# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a bag holds of every input, for learning error bounds."""

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from dg_localization.fleet import (
    FleetConfig,
    LinkKey,
    LinkKind,
    Localizer,
    Rejection,
    SensorBounds,
)
from dg_localization.fleet.error_models import in_body_frame, interpret_ray
from dg_localization.fleet.localizer import PeerMeasurement
from dg_localization.ros.bags.offline import Inputs, in_seconds
from dg_localization.ros.bags.reading import BagMessage
from dg_localization.ros.bags.truth import Truth
from dg_localization.ros.interface.intake import Intake
from dg_localization.ros.interface.parameters.settings import Settings

OdometryPiece: TypeAlias = list[tuple[float, Any, Any]]
"""Stamps in s, positions and quaternions, each newer than the one before."""


@dataclass
class Samples:
    """
    The readings of a bag by input, each with its stamp in s, oldest first as they arrived.

    They are those that the localizer accepts.

    Attributes
    ----------
    ranges : dict of LinkKey to list of (float, float)
        Ranges in m.
    rays : dict of LinkKey to list of (float, ndarray)
        Unit vectors.
    odometry : dict of str to list of OdometryPiece
        By robot; where its odometry starts anew, as the localizer finds it, a piece begins.

    """

    ranges: dict[LinkKey, list[tuple[float, float]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    rays: dict[LinkKey, list[tuple[float, Any]]] = field(default_factory=lambda: defaultdict(list))
    odometry: dict[str, list[OdometryPiece]] = field(default_factory=lambda: defaultdict(list))

    @property
    def n_readings(self) -> int:
        """How many ranges and rays there are."""
        return sum(len(rows) for rows in (*self.ranges.values(), *self.rays.values()))

    def stamps_s(self) -> list[float]:
        """Return the stamps of all that was measured."""
        found = [stamp_s for rows in self.ranges.values() for stamp_s, _ in rows]
        found += [stamp_s for rows in self.rays.values() for stamp_s, _ in rows]
        pieces = (piece for pieces in self.odometry.values() for piece in pieces)
        return found + [stamp_s for piece in pieces for stamp_s, _, _ in piece]


class _Gatherer(Localizer):
    """
    Keeps the readings that a localizer accepts, and is never asked to localize.

    What the node would reject is nothing to learn from: its bounds are for what it takes.

    Parameters
    ----------
    config : FleetConfig

    """

    def __init__(self, config: FleetConfig) -> None:
        super().__init__(config)
        self.samples = Samples()

    def add_range(
        self, observer: str, target: str, range_m: float, stamp_s: float, *args: Any, **others: Any
    ) -> Rejection | None:
        """Keep a range that is accepted."""
        rejection = super().add_range(observer, target, range_m, stamp_s, *args, **others)
        if rejection is None:
            self._keep(observer, target, range_m, stamp_s)
        return rejection

    def add_bearing(
        self, observer: str, target: str, ray_xyz: ArrayLike, stamp_s: float, *args: Any
    ) -> Rejection | None:
        """Keep a ray that is accepted."""
        rejection = super().add_bearing(observer, target, ray_xyz, stamp_s, *args)
        if rejection is None:
            self._keep(observer, target, ray_xyz, stamp_s)
        return rejection

    def add_odometry(
        self,
        robot: str,
        position_xyz: ArrayLike,
        orientation_xyzw: ArrayLike,
        stamp_s: float,
        now_s: float,
        frame: str = '',
    ) -> Rejection | None:
        """Keep a pose that is accepted, as it was reported."""
        rejection = super().add_odometry(
            robot, position_xyz, orientation_xyzw, stamp_s, now_s, frame
        )
        if rejection is None:
            turn = np.asarray(orientation_xyzw, dtype=float)
            pose = np.array(position_xyz, dtype=float), turn / np.linalg.norm(turn)
            pieces = self.samples.odometry[robot]
            if not pieces or self.odometry_restarted_s(robot) > pieces[-1][-1][0]:
                pieces.append([])
            pieces[-1].append((stamp_s, *pose))
        return rejection

    def add_peers(
        self,
        observer: str,
        readings: Iterable[PeerMeasurement],
        stamp_s: float,
        now_s: float,
        bounds: SensorBounds | None = None,
    ) -> list[Rejection]:
        """Keep what is accepted of everything that one robot measured."""
        # Who measured, and when, is checked once. The rows go one by one: of all together the
        # answer does not say which were accepted.
        rejections = super().add_peers(observer, (), stamp_s, now_s)
        for target, value in readings if not rejections else ():
            of_row = super().add_peers(observer, [(target, value)], stamp_s, now_s, bounds)
            rejections += of_row
            if not of_row:
                self._keep(observer, target, value, stamp_s)
        return rejections

    def _keep(self, observer: str, target: str, value: Any, stamp_s: float) -> None:
        """Keep a range in m, or the unit vector of a ray in the body frame."""
        if isinstance(value, int | float):
            # Infinity is accepted where it proves that the target is far; it has no error.
            if math.isfinite(value):
                key = LinkKey(LinkKind.RANGE, observer, target)
                self.samples.ranges[key].append((stamp_s, value))
            return
        taken = in_body_frame(self.config.sensors.get(observer), value)
        if not isinstance(taken, Rejection):
            taken = interpret_ray(taken, self.config.dimension)
        if not isinstance(taken, Rejection):
            key = LinkKey(LinkKind.BEARING, observer, target)
            self.samples.rays[key].append((stamp_s, taken))


class Collector:
    """
    Gathers the readings of a bag.

    Parameters
    ----------
    settings : Settings
    inputs : Inputs
    truth : TruthReader

    Attributes
    ----------
    samples : Samples
    rejected : Counter of str
        By reason, the messages that could be read and of which something was not accepted.

    """

    def __init__(self, settings: Settings, inputs: Inputs, truth: Truth) -> None:
        self._links = {link.topic: link for link in inputs.links}
        self._truth = truth
        self._gatherer = _Gatherer(settings.fleet)
        self._intake = Intake(self._gatherer, settings.use_header_stamp, settings.ids)
        self.samples = self._gatherer.samples
        self.rejected: Counter[str] = Counter()

    @property
    def malformed(self) -> int:
        """How many messages could not be read."""
        of_inputs = sum(wrong.count for wrong in self._intake.malformed.values())
        return of_inputs + self._truth.malformed

    def take(self, message: BagMessage, message_class: type) -> None:
        """Take one recorded message."""
        now_s = in_seconds(message.time_ns)
        if message.topic in self._truth.topics:
            self._truth.take(message, message_class)
        # The odometry of one input may serve as the truth of another.
        if link := self._links.get(message.topic):
            rejection = self._intake.take(link, message.data, now_s)
            if rejection is not None:
                self.rejected[rejection.reason.value] += 1
