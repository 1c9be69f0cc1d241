# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Message types of packages that are not installed here: classes with the fields of their messages.

Each line of a definition is a type and the name of a field, as in a .msg file.
"""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np

ROLE_AND_ID = 'uint8 role', 'uint8 id'
DISTANCES = 'float32 dis', 'float32 fp_rssi', 'float32 rx_rssi'
TIMES = 'uint32 local_time', 'uint32 system_time', 'float32 voltage'


def link_track(package):
    """Return the definitions of LinkTrack in one of the packages that have them."""
    wide = 'uint8 role', 'uint32 id'
    frame_2 = 'Header header', *ROLE_AND_ID, *TIMES
    return {
        f'{package}/LinktrackNode2': (*ROLE_AND_ID, *DISTANCES),
        f'{package}/LinktrackNode5': (*wide, *DISTANCES),
        f'{package}/LinktrackNodeframe2': (*frame_2, f'{package}/LinktrackNode2[] nodes'),
        f'{package}/LinktrackNodeframe3': (
            *ROLE_AND_ID,
            *TIMES,
            f'{package}/LinktrackNode2[] nodes',
        ),
        f'{package}/LinktrackNodeframe5': (*wide, *TIMES, f'{package}/LinktrackNode5[] nodes'),
    }


DEFINITIONS = {
    'uwb_ros/RangeStamped': (
        'Header header',
        'float32 range',
        'uint8 from_id',
        'uint8 to_id',
        'float32 covariance',
    ),
    'px4_msgs/SensorUwb': (
        'uint64 timestamp',
        'uint16 mac',
        'uint16 mac_dest',
        'float32 distance',
    ),
    **link_track('nlink_parser'),
    **link_track('nlink_parser_ros2_interfaces'),
    'apriltag_msgs/Point': ('float64 x', 'float64 y'),
    'apriltag_msgs/AprilTagDetection': (
        'string family',
        'int32 id',
        'int32 hamming',
        'float32 decision_margin',
        'apriltag_msgs/Point centre',
    ),
    'apriltag_msgs/AprilTagDetectionArray': (
        'Header header',
        'apriltag_msgs/AprilTagDetection[] detections',
    ),
    'vision_msgs/Point2D': ('float64 x', 'float64 y'),
    'vision_msgs/Pose2D': ('vision_msgs/Point2D position', 'float64 theta'),
    'vision_msgs/BoundingBox2D': (
        'vision_msgs/Pose2D center',
        'float64 size_x',
        'float64 size_y',
    ),
    'vision_msgs/BoundingBox3D': ('Pose center',),
    'vision_msgs/ObjectHypothesis': ('string class_id', 'float64 score'),
    'vision_msgs/ObjectHypothesisWithPose': ('vision_msgs/ObjectHypothesis hypothesis',),
    'vision_msgs/Detection2D': (
        'Header header',
        'vision_msgs/ObjectHypothesisWithPose[] results',
        'vision_msgs/BoundingBox2D bbox',
        'string id',
    ),
    'vision_msgs/Detection3D': (
        'Header header',
        'vision_msgs/ObjectHypothesisWithPose[] results',
        'vision_msgs/BoundingBox3D bbox',
        'string id',
    ),
    'vision_msgs/Detection2DArray': ('Header header', 'vision_msgs/Detection2D[] detections'),
    'vision_msgs/Detection3DArray': ('Header header', 'vision_msgs/Detection3D[] detections'),
}


def empty(type_name):
    """Return what a field of a type holds in a new message."""
    if type_name.endswith('[]'):
        return []
    if type_name == 'string':
        return ''
    if type_name == 'Header':
        return SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id='')
    if type_name == 'Pose':
        return SimpleNamespace(position=SimpleNamespace(x=0.0, y=0.0, z=0.0))
    if '/' in type_name:
        return CLASSES[type_name]()
    return 0.0 if type_name.startswith('float') else 0


def class_of(name, lines):
    """Return a class for messages of one definition; it has these fields and no others."""
    fields = [line.split() for line in lines]

    def __init__(self):
        for type_name, field in fields:
            setattr(self, field, empty(type_name))

    members = {'__slots__': tuple(field for _, field in fields), '__init__': __init__}
    return type(name.partition('/')[2], (), members)


CLASSES = {name: class_of(name, lines) for name, lines in DEFINITIONS.items()}


def install(monkeypatch):
    """Make the packages importable until the test ends."""
    for package in {name.partition('/')[0] for name in CLASSES}:
        messages = ModuleType(f'{package}.msg')
        for name, message_class in CLASSES.items():
            if name.startswith(f'{package}/'):
                setattr(messages, message_class.__name__, message_class)
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
        monkeypatch.setitem(sys.modules, f'{package}.msg', messages)


def assert_same(actual, expected):
    """Compare two plain values field by field, arrays by value and shape."""
    assert type(actual) is type(expected)
    for name, value in vars(expected).items():
        other = getattr(actual, name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(other, value)
            assert other.shape == value.shape
        elif name == 'markers':
            assert len(other) == len(value)
            for ours, theirs in zip(other, value, strict=True):
                assert_same(ours, theirs)
        else:
            assert other == value, name
