# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
From measurements to every placement that agrees with them, without ROS.

`Localizer` accepts ranges, bearings and odometry as plain numbers. A `Snapshot` holds the
measurements at one time, an `Estimate` is the answer to it.
"""

from dg_localization.fleet.checks import ConfigError
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.contradictions.suspects import Offender, Suspect, SuspectKind
from dg_localization.fleet.estimate import Estimate, FixedFrame, FrameKind, Group, Placement
from dg_localization.fleet.localizer import Localizer
from dg_localization.fleet.odometry_error import OdometryErrorModel
from dg_localization.fleet.sensors import (
    Anchor,
    DifferenceErrorModel,
    ElevationErrorModel,
    Mount,
    RangeErrorModel,
    SensorBounds,
)
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import (
    Conflict,
    InputState,
    LinkKey,
    LinkKind,
    LinkState,
    Rejection,
    RejectionReason,
)
from dg_localization.fleet.warm_up import solver_warnings, warm_up, warm_up_status
from dg_localization.fleet.window.forgetting import Forgotten
from dg_localization.solver.options import Cancel

__all__ = [
    'Anchor',
    'Cancel',
    'ConfigError',
    'Conflict',
    'DifferenceErrorModel',
    'ElevationErrorModel',
    'Estimate',
    'FixedFrame',
    'FleetConfig',
    'Forgotten',
    'FrameKind',
    'Group',
    'InputState',
    'LinkKey',
    'LinkKind',
    'LinkState',
    'Localizer',
    'Mount',
    'OdometryErrorModel',
    'Offender',
    'Placement',
    'RangeErrorModel',
    'Rejection',
    'RejectionReason',
    'SensorBounds',
    'Snapshot',
    'Suspect',
    'SuspectKind',
    'solver_warnings',
    'warm_up',
    'warm_up_status',
]
