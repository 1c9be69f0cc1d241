# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What odometry tells of single robots: their paths, and how they are tilted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.odometry import MotionLimits, OdometryPath
from dg_localization.fleet.vocabulary import OdometryReading


class Tilt(NamedTuple):
    """The rotation from the body frame of a robot to its level frame, and its greatest error."""

    rotation: NDArray[np.float64]
    error_rad: float


def path_of(config: FleetConfig, robot: str, readings: Sequence[OdometryReading]) -> OdometryPath:
    """Return the path of a robot through its odometry, oldest first."""
    return OdometryPath(
        [reading.stamp_s for reading in readings],
        [reading.position_m for reading in readings],
        [reading.rotation for reading in readings],
        config.odometry_error_of(robot),
        MotionLimits(config.speed_m_s(robot), config.max_turn_rate_rad_s),
        config.dimension,
    )
