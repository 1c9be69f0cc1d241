# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Detections of cameras: apriltag_msgs and vision_msgs arrays, and their sensor_msgs/CameraInfo.

The camera matrix of the rectified image converts a pixel to a ray, so detectors must work on the
rectified image. Rays are given with x forward, y left and z up; an optical frame has z forward and
x right (REP-103). The packages of detections are imported when a message class is needed.
"""

from dataclasses import dataclass
from functools import partial, reduce
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.headers import header_of, header_to_message, message_class
from msg_adapters.identified import IdentifiedReading
from msg_adapters.registry import Adapter, register

CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
APRILTAGS = 'apriltag_msgs/msg/AprilTagDetectionArray'
DETECTIONS_2D = 'vision_msgs/msg/Detection2DArray'
DETECTIONS_3D = 'vision_msgs/msg/Detection3DArray'

# From an optical frame to one with x forward, y left and z up.
FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
OPTICAL_SUFFIX = '_optical'
BOX_CENTER = ('bbox', 'center', 'position')


@dataclass(frozen=True)
class CameraReading:
    """
    The camera matrix of a rectified image.

    Attributes
    ----------
    stamp_s : float
        Time in s.
    frame_id : str
        Optical frame of the camera, as its detections name it.
    focal_px : tuple of two floats
        Focal lengths in x and y, in pixels.
    center_px : tuple of two floats
        The image point of the optical axis, in pixels.

    """

    stamp_s: float
    frame_id: str
    focal_px: tuple[float, float]
    center_px: tuple[float, float]

    def rays(self, pixels_xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rays of pixels of shape (k, 2), x forward, y left, z up, shape (k, 3)."""
        optical = np.ones((len(pixels_xy), 3))
        optical[:, :2] = (pixels_xy - np.array(self.center_px)) / np.array(self.focal_px)
        with np.errstate(invalid='ignore'):  # a pixel at infinity gives NaN
            return optical @ FROM_OPTICAL.T


@dataclass(frozen=True, eq=False)
class PixelReading:
    """
    The pixels of k targets in an image.

    Attributes
    ----------
    stamp_s : float
        Time of the image in s.
    target_ids : tuple of str
        The k targets, as the detector names them.
    pixels_xy : ndarray, shape (k, 2)
        Their centers in pixels.
    frame_id : str
        Optical frame of the camera.

    """

    stamp_s: float
    target_ids: tuple[str, ...]
    pixels_xy: NDArray[np.float64]
    frame_id: str

    def seen_by(self, camera: CameraReading) -> IdentifiedReading:
        """Return the rays to the pixels of a camera."""
        rays, unknown_m = camera.rays(self.pixels_xy), np.full(len(self.target_ids), np.nan)
        args = self.stamp_s, '', self.target_ids, unknown_m, rays, self.frame_id
        return IdentifiedReading(*args)


def camera_from_message(message: Any) -> CameraReading:
    """
    Read a `sensor_msgs/CameraInfo`: the matrix P, or K if P is empty.

    The message has the matrices of the full image. Binning and the region of interest convert them
    to the matrices of the sent image.

    Raises
    ------
    ValueError
        If the focal lengths are not positive numbers.

    """
    fx, _, cx, _, _, fy, cy, *_ = message.p
    if fx == 0.0:
        fx, _, cx, _, fy, cy, *_ = message.k
    # Zero in a message means no binning.
    bin_x, bin_y = max(1, message.binning_x), max(1, message.binning_y)
    fx, cx = fx / bin_x, (cx - message.roi.x_offset) / bin_x
    fy, cy = fy / bin_y, (cy - message.roi.y_offset) / bin_y
    if not (0.0 < fx < math.inf and 0.0 < fy < math.inf and math.isfinite(cx + cy)):
        raise ValueError(
            f'focal lengths {fx}, {fy} and center {cx}, {cy} are not calibrated: they must be '
            'finite, and the lengths above 0'
        )
    return CameraReading(
        **header_of(message),
        focal_px=(float(fx), float(fy)),
        center_px=(float(cx), float(cy)),
    )


def camera_to_message(reading: CameraReading) -> Any:
    """Write a `sensor_msgs/CameraInfo` without distortion."""
    from sensor_msgs.msg import CameraInfo

    (fx, fy), (cx, cy) = reading.focal_px, reading.center_px
    return CameraInfo(
        header=header_to_message(reading.stamp_s, reading.frame_id),
        k=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        p=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def _centers(message: Any, axes: str, *path: str) -> NDArray[np.float64]:
    """Return the points of the detections, shape (k, q), by the path of fields to the point."""
    points = [reduce(getattr, path, found) for found in message.detections]
    rows = [[getattr(point, axis) for axis in axes] for point in points]
    return np.reshape(np.array(rows, dtype=float), (-1, len(axes)))


def apriltags_from_message(message: Any) -> PixelReading:
    """Read an `apriltag_msgs/AprilTagDetectionArray`; an id is ``FAMILY:ID``."""
    return PixelReading(
        **header_of(message),
        target_ids=tuple(f'{tag.family}:{int(tag.id)}' for tag in message.detections),
        pixels_xy=_centers(message, 'xy', 'centre'),
    )


def detections_2d_from_message(message: Any) -> PixelReading:
    """Read a `vision_msgs/Detection2DArray`: the centers of the boxes, and the likeliest class."""
    return PixelReading(
        **header_of(message),
        target_ids=tuple(map(_class_of, message.detections)),
        pixels_xy=_centers(message, 'xy', *BOX_CENTER),
    )


def detections_3d_from_message(message: Any) -> IdentifiedReading:
    """
    Read a `vision_msgs/Detection3DArray`: the rays to the boxes, and the likeliest class.

    The distances are left out: the stated bounds of ranges do not apply to distances of a camera.
    """
    rays = _centers(message, 'xyz', *BOX_CENTER)
    if OPTICAL_SUFFIX in message.header.frame_id:
        rays = rays @ FROM_OPTICAL.T
    return IdentifiedReading(
        **header_of(message),
        observer_id='',
        target_ids=tuple(map(_class_of, message.detections)),
        ranges_m=np.full(len(rays), np.nan),
        rays_xyz=rays,
    )


def detections_to_message(type_name: str, reading: PixelReading | IdentifiedReading) -> Any:
    """Write an array of tags by their centers, or of boxes without size."""
    centers = reading.pixels_xy if isinstance(reading, PixelReading) else reading.rays_xyz
    if type_name == DETECTIONS_3D and OPTICAL_SUFFIX in reading.frame_id:
        centers = centers @ FROM_OPTICAL
    message = message_class(type_name)()
    message.header = header_to_message(reading.stamp_s, reading.frame_id)
    for target_id, coordinates in zip(reading.target_ids, centers.tolist(), strict=True):
        found = message_class(type_name.removesuffix('Array'))()
        if type_name == APRILTAGS:
            center = found.centre
            found.family, _, number = target_id.partition(':')
            found.id = int(number)
        else:
            center = reduce(getattr, BOX_CENTER, found)
            result = message_class('vision_msgs/msg/ObjectHypothesisWithPose')()
            result.hypothesis.class_id, result.hypothesis.score = target_id, 1.0
            found.results.append(result)
        for axis, coordinate in zip('xyz', coordinates, strict=False):
            setattr(center, axis, coordinate)
        message.detections.append(found)
    return message


def _class_of(detection: Any) -> str:
    """Return the likeliest class of a detection, or its own id if it has no class."""
    if not detection.results:
        return str(detection.id)
    scores = [float(result.hypothesis.score) for result in detection.results]
    if any(map(math.isnan, scores)):
        raise ValueError(f'the scores {scores} of a detection are not allowed: NaN is no score')
    return str(detection.results[scores.index(max(scores))].hypothesis.class_id)


register(Adapter(CAMERA_INFO, CameraReading, camera_from_message, camera_to_message))
for _name, _value_class, _read in (
    (APRILTAGS, PixelReading, apriltags_from_message),
    (DETECTIONS_2D, PixelReading, detections_2d_from_message),
    (DETECTIONS_3D, IdentifiedReading, detections_3d_from_message),
):
    register(Adapter(_name, _value_class, _read, partial(detections_to_message, _name)))
