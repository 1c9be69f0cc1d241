# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which adapter belongs to which message type; own types are added with `register`."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from msg_adapters import (
    bearings,
    detections,
    diagnostics,
    elevations,
    identified,
    markers,
    odometry,
    peers,
    poses,
    ranges,
)


class UnknownTypeError(KeyError):
    """No adapter is registered for the message type, or its package is not installed."""

    def __str__(self) -> str:
        return str(self.args[0])


@dataclass(frozen=True)
class Adapter:
    """
    Both directions between one message type and plain values.

    Attributes
    ----------
    type_name : str
        Such as 'sensor_msgs/msg/Range'.
    value_class : type
        Class of the plain values; it tells what a message is good for.
    from_message : callable
        Message to value. It may raise ValueError on a message that is no reading.
    to_message : callable
        Value to message.

    """

    type_name: str
    value_class: type
    from_message: Callable[[Any], Any]
    to_message: Callable[[Any], Any]

    def message_class(self) -> type:
        """
        Import and return the message class; nothing is imported before this is called.

        Raises
        ------
        UnknownTypeError
            If the package is not installed or has no such message.

        """
        package, kind, name = self.type_name.split('/')
        try:
            message_class: type = getattr(import_module(f'{package}.{kind}'), name)
        except (ImportError, AttributeError) as error:
            raise UnknownTypeError(
                f'message type {self.type_name} cannot be imported ({error}); '
                f'install the ROS package {package}'
            ) from error
        return message_class


_adapters: dict[str, Adapter] = {}


def register(adapter: Adapter) -> None:
    """
    Add an adapter, replacing the one for the same type.

    Raises
    ------
    ValueError
        If the type name is not of the form 'package/msg/Type'.

    """
    parts = adapter.type_name.split('/')
    if len(parts) != 3 or not all(parts):
        raise ValueError(f"type name '{adapter.type_name}' is not of the form 'package/msg/Type'")
    _adapters[adapter.type_name] = adapter


def adapter_for(type_name: str) -> Adapter:
    """
    Return the adapter of a message type, such as 'sensor_msgs/msg/Range'.

    Raises
    ------
    UnknownTypeError
        If there is none; the message lists the types that have one.

    """
    try:
        return _adapters[type_name]
    except KeyError:
        raise UnknownTypeError(
            f"no adapter for message type '{type_name}'; there are {', '.join(known_types())}"
        ) from None


def known_types() -> list[str]:
    """Return the names of all message types that have an adapter, sorted."""
    return sorted(_adapters)


for _adapter in (
    Adapter(
        ranges.TYPE_NAME,
        ranges.RangeReading,
        ranges.range_from_message,
        ranges.range_to_message,
    ),
    Adapter(
        bearings.TYPE_NAME,
        bearings.BearingReading,
        bearings.bearing_from_message,
        bearings.bearing_to_message,
    ),
    Adapter(
        odometry.TYPE_NAME,
        odometry.OdometryReading,
        odometry.odometry_from_message,
        odometry.odometry_to_message,
    ),
    Adapter(
        elevations.TYPE_NAME,
        elevations.ElevationReading,
        elevations.elevation_from_message,
        elevations.elevation_to_message,
    ),
    Adapter(
        peers.TYPE_NAME,
        peers.PeersReading,
        peers.peers_from_message,
        peers.peers_to_message,
    ),
    Adapter(
        identified.RANGE_STAMPED,
        identified.IdentifiedReading,
        identified.range_stamped_from_message,
        identified.range_stamped_to_message,
    ),
    Adapter(
        identified.SENSOR_UWB,
        identified.IdentifiedReading,
        identified.sensor_uwb_from_message,
        identified.sensor_uwb_to_message,
    ),
    *(
        Adapter(
            type_name,
            identified.IdentifiedReading,
            identified.node_frame_from_message,
            identified.node_frame_writer(type_name),
        )
        for type_name in identified.NODE_FRAMES
    ),
    Adapter(
        detections.CAMERA_INFO,
        detections.CameraReading,
        detections.camera_from_message,
        detections.camera_to_message,
    ),
    Adapter(
        detections.APRILTAGS,
        detections.PixelReading,
        detections.apriltags_from_message,
        detections.apriltags_to_message,
    ),
    Adapter(
        detections.DETECTIONS_2D,
        detections.PixelReading,
        detections.detections_2d_from_message,
        detections.detections_2d_to_message,
    ),
    Adapter(
        detections.DETECTIONS_3D,
        identified.IdentifiedReading,
        detections.detections_3d_from_message,
        detections.detections_3d_to_message,
    ),
    Adapter(
        poses.POSE_ARRAY,
        poses.PoseList,
        poses.pose_array_from_message,
        poses.pose_array_to_message,
    ),
    Adapter(
        poses.POSE_WITH_COVARIANCE_STAMPED,
        poses.UncertainPose,
        poses.uncertain_pose_from_message,
        poses.uncertain_pose_to_message,
    ),
    Adapter(
        diagnostics.TYPE_NAME,
        diagnostics.Diagnostics,
        diagnostics.diagnostics_from_message,
        diagnostics.diagnostics_to_message,
    ),
    Adapter(
        markers.TYPE_NAME,
        markers.MarkerScene,
        markers.marker_scene_from_message,
        markers.marker_scene_to_message,
    ),
):
    register(_adapter)
