"""
The fleet room: from measurements to every placement that agrees with them, free of ROS.

`Localizer` takes ranges, bearings and odometry as plain numbers, freezes them into a `Snapshot`
at a time, and answers it with an `Estimate`.
"""

from dg_localization.fleet.config import (
    Anchor,
    ConfigError,
    FleetConfig,
    LinkOverride,
    RangeErrorModel,
)
from dg_localization.fleet.estimate import (
    Conflict,
    Estimate,
    FixedFrame,
    InputState,
    LinkKey,
    LinkKind,
    LinkState,
    Placement,
    Rejection,
    RejectionReason,
)
from dg_localization.fleet.localizer import Localizer
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.warm_up import solver_warnings, warm_up, warm_up_status

__all__ = [
    'Anchor',
    'ConfigError',
    'Conflict',
    'Estimate',
    'FixedFrame',
    'FleetConfig',
    'InputState',
    'LinkKey',
    'LinkKind',
    'LinkOverride',
    'LinkState',
    'Localizer',
    'Placement',
    'RangeErrorModel',
    'Rejection',
    'RejectionReason',
    'Snapshot',
    'solver_warnings',
    'warm_up',
    'warm_up_status',
]
