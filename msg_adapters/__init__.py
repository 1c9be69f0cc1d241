# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Pure functions between ROS messages and plain values, both directions.

One module per message family. Reading accepts any object with the fields of the
message, so messages decoded by rclpy and by `rosbags` both work; writing imports
the message class when it is called. Importing this package does not import ROS.
"""

from msg_adapters.detections import CameraReading, PixelReading
from msg_adapters.diagnostics import Diagnostics, Level, Status
from msg_adapters.identified import IdentifiedReading
from msg_adapters.markers import Marker, MarkerScene, Shape
from msg_adapters.peers import PeersReading
from msg_adapters.poses import PoseList, UncertainPose
from msg_adapters.readings import BearingReading, ElevationReading, OdometryReading, RangeReading
from msg_adapters.registry import Adapter, UnknownTypeError, adapter_for, known_types, register

__all__ = [
    'Adapter',
    'BearingReading',
    'CameraReading',
    'Diagnostics',
    'ElevationReading',
    'IdentifiedReading',
    'Level',
    'Marker',
    'MarkerScene',
    'OdometryReading',
    'PeersReading',
    'PixelReading',
    'PoseList',
    'RangeReading',
    'Shape',
    'Status',
    'UncertainPose',
    'UnknownTypeError',
    'adapter_for',
    'known_types',
    'register',
]
