# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""visualization_msgs/MarkerArray <-> `MarkerScene`."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.headers import CdrWriter, split_time, stamp_from_message, xyz_from_message
from msg_adapters.registry import register_cdr

TYPE_NAME = 'visualization_msgs/msg/MarkerArray'
# Actions of visualization_msgs/Marker.
ADD, DELETE_ALL = 0, 3


class Shape(IntEnum):
    """The marker types in use, with the numbers of `visualization_msgs/Marker`."""

    NONE = 0
    LINE_LIST = 5
    SPHERE_LIST = 7
    TEXT = 9


@dataclass(frozen=True, eq=False)
class Marker:
    """
    One marker of a scene, fixed in the frame of the scene.

    Attributes
    ----------
    namespace : str
        Group that a viewer switches on and off.
    identifier : int
        Unique within the namespace.
    shape : Shape
        The shape drawn at `points_m`.
    points_m : ndarray, shape (k, 3)
        Centers of spheres, ends of lines (two rows each), or the one place of a text, in m.
    colors_rgba : ndarray, shape (k, 4)
        A color for each point, 0 to 1.
    size_m : float
        Diameter of a sphere, width of a line, height of a text, in m.
    text : str
        The text, for `Shape.TEXT`.

    """

    namespace: str
    identifier: int
    shape: Shape
    points_m: NDArray[np.float64]
    colors_rgba: NDArray[np.float64]
    size_m: float
    text: str = ''


@dataclass(frozen=True, eq=False)
class MarkerScene:
    """
    All markers at one time; they replace the earlier ones.

    Attributes
    ----------
    stamp_s : float
        Time in s.
    frame_id : str
        Frame of all points.
    markers : tuple of Marker
        May be empty, which clears the view.
    lifetime_s : float
        Time for which viewers show it; 0 until it is replaced.

    """

    stamp_s: float
    frame_id: str
    markers: tuple[Marker, ...] = ()
    lifetime_s: float = 0.0


def marker_scene_to_cdr(scene: MarkerScene) -> bytes:
    """
    Write a serialized `visualization_msgs/MarkerArray`: first "delete all", then the markers.

    Raises
    ------
    ValueError
        If a marker has not as many colors as points.

    """
    writer = CdrWriter('I', 1 + len(scene.markers))
    nothing = Marker('', 0, Shape.NONE, np.zeros((0, 3)), np.zeros((0, 4)), 0.0)
    _write_marker(writer, nothing, scene, DELETE_ALL, 0.0)
    for marker in scene.markers:
        _write_marker(writer, marker, scene, ADD, scene.lifetime_s)
    return writer.to_bytes()


def _write_marker(
    writer: CdrWriter, marker: Marker, scene: MarkerScene, action: int, lifetime_s: float
) -> None:
    if len(marker.colors_rgba) != len(marker.points_m):
        raise ValueError(
            f'marker {marker.namespace}/{marker.identifier} needs a color for each point'
        )
    is_text = marker.shape is Shape.TEXT
    header, identity = (scene.stamp_s, scene.frame_id), (marker.namespace, marker.identifier)
    writer.write('hsiii', header, *identity, marker.shape, action)
    # The pose and the size, and the color of a text.
    writer.write('d', marker.points_m[0] if is_text else np.zeros(3))
    writer.write('dd', [0.0, 0.0, 0.0, 1.0], np.full(3, marker.size_m))
    writer.write('f', marker.colors_rgba[0] if is_text else np.zeros(4))
    n_points = 0 if is_text else len(marker.points_m)
    # The third value is frame_locked.
    writer.write('iIBI', *split_time('lifetime', lifetime_s), False, n_points)
    writer.write('dIf', marker.points_m[:n_points], n_points, marker.colors_rgba[:n_points])
    # No texture: its resource, header, format and data; and no uv_coordinates.
    writer.write('shsII', '', (0.0, ''), '', 0, 0)
    # No mesh: its resource, its file by name and data, and whether it has materials.
    writer.write('sssIB', marker.text, '', '', 0, False)


def marker_scene_from_message(message: Any) -> MarkerScene:
    """
    Read a `visualization_msgs/MarkerArray` that `marker_scene_to_cdr` wrote.

    Raises
    ------
    ValueError
        If the array does not begin with "delete all", or holds a shape not in `Shape`.

    """
    if not message.markers or message.markers[0].action != DELETE_ALL:
        raise ValueError('the marker array does not begin with DELETEALL')
    header, drawn = message.markers[0].header, message.markers[1:]
    return MarkerScene(
        stamp_s=stamp_from_message(header.stamp),
        frame_id=header.frame_id,
        markers=tuple(_from_message(marker) for marker in drawn),
        lifetime_s=stamp_from_message(drawn[0].lifetime) if drawn else 0.0,
    )


def _from_message(message: Any) -> Marker:
    is_text = message.type == Shape.TEXT
    points = [message.pose.position] if is_text else message.points
    colors = [message.color] if is_text else message.colors
    return Marker(
        namespace=message.ns,
        identifier=message.id,
        shape=Shape(message.type),
        points_m=np.reshape([xyz_from_message(point) for point in points], (-1, 3)),
        colors_rgba=np.reshape([[c.r, c.g, c.b, c.a] for c in colors], (-1, 4)),
        size_m=message.scale.z,
        text=message.text,
    )


register_cdr(TYPE_NAME, MarkerScene, marker_scene_from_message, marker_scene_to_cdr)
