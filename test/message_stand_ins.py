# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Message types of packages that are not installed here: classes with the fields of their messages.

A definition has the types and the names of the fields, as a .msg file.
"""

import sys
from types import ModuleType, SimpleNamespace

FRAME = 'uint32 local_time, uint32 system_time, float32 voltage, {0}[] nodes'
NODE = 'float32 dis, float32 fp_rssi, float32 rx_rssi'
DETECTION = 'Header header, vision_msgs/ObjectHypothesisWithPose[] results, string id, {0} bbox'
DEFINITIONS = {
    'uwb_ros/RangeStamped': 'Header header, float32 range, uint8 from_id, uint8 to_id',
    'px4_msgs/SensorUwb': 'uint64 timestamp, uint16 mac, uint16 mac_dest, float32 distance',
    'apriltag_msgs/Point': 'float64 x, float64 y',
    'apriltag_msgs/AprilTagDetection': 'string family, int32 id, apriltag_msgs/Point centre',
    'apriltag_msgs/AprilTagDetectionArray': (
        'Header header, apriltag_msgs/AprilTagDetection[] detections'
    ),
    'vision_msgs/Point2D': 'float64 x, float64 y',
    'vision_msgs/Pose2D': 'vision_msgs/Point2D position, float64 theta',
    'vision_msgs/BoundingBox2D': 'vision_msgs/Pose2D center, float64 size_x, float64 size_y',
    'vision_msgs/BoundingBox3D': 'Pose center',
    'vision_msgs/ObjectHypothesis': 'string class_id, float64 score',
    'vision_msgs/ObjectHypothesisWithPose': 'vision_msgs/ObjectHypothesis hypothesis',
}
for q in '23':
    name = f'vision_msgs/Detection{q}D'
    DEFINITIONS[name] = DETECTION.format(f'vision_msgs/BoundingBox{q}D')
    DEFINITIONS[f'{name}Array'] = f'Header header, {name}[] detections'
# LinkTrack, in both packages that have it.
for package in ('nlink_parser', 'nlink_parser_ros2_interfaces'):
    name = f'{package}/Linktrack'
    two, five = 'uint8 role, uint8 id, ', 'uint8 role, uint32 id, '
    DEFINITIONS |= {
        f'{name}Node2': two + NODE,
        f'{name}Node5': five + NODE,
        f'{name}Nodeframe2': 'Header header, ' + two + FRAME.format(f'{name}Node2'),
        f'{name}Nodeframe3': two + FRAME.format(f'{name}Node2'),
        f'{name}Nodeframe5': five + FRAME.format(f'{name}Node5'),
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


def class_of(name, definition):
    """Return a class for messages of one definition; it has these fields and no others."""
    fields = [field.split() for field in definition.split(', ')]

    def __init__(self):
        for type_name, field in fields:
            setattr(self, field, empty(type_name))

    members = {'__slots__': tuple(field for _, field in fields), '__init__': __init__}
    return type(name.partition('/')[2], (), members)


CLASSES = {name: class_of(name, fields) for name, fields in DEFINITIONS.items()}


def install(monkeypatch):
    """Make the packages importable until the test ends."""
    for package in {name.partition('/')[0] for name in CLASSES}:
        messages = ModuleType(f'{package}.msg')
        for name, message_class in CLASSES.items():
            if name.startswith(f'{package}/'):
                setattr(messages, message_class.__name__, message_class)
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
        monkeypatch.setitem(sys.modules, f'{package}.msg', messages)
