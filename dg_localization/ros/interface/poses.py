# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""An estimate as poses, in the values that the message adapters take."""

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet import Estimate
from msg_adapters import PoseList, UncertainPose

# ROS has no unknown orientation. A zero quaternion is none at all, viewers accept it as such, and
# nobody can take it for a heading.
UNKNOWN_ORIENTATION = np.zeros(4)
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
# ROS has no unknown covariance either. A filter gives no weight to a variance of this size, in
# rad^2, whereas pi^2 would still draw its heading towards zero.
UNKNOWN_VARIANCE_RAD2 = 1e6
# The robot that the frame is attached to has no error there. Filters take a variance of zero for
# certainty, and some cannot invert it: a millimeter and a milliradian are certain enough.
LEAST_VARIANCE = 1e-6


def feasible_poses(estimate: Estimate, frame_id: str) -> PoseList:
    """
    Return every placement one after the other: pose ``k * n + i`` is robot i in placement k.

    A position that is not known is NaN; the quaternion of an unknown heading is all zeros.
    """
    n_poses = len(estimate.placements) * len(estimate.robots)
    positions = [in_space(placement.positions_m) for placement in estimate.placements]
    orientations = [
        np.where(
            placement.heading_known[:, None], placement.orientations_xyzw, UNKNOWN_ORIENTATION
        )
        for placement in estimate.placements
    ]
    return PoseList(
        stamp_s=estimate.stamp_s,
        frame_id=frame_id,
        positions_m=np.reshape(positions, (n_poses, 3)),
        orientations_xyzw=np.reshape(orientations, (n_poses, 4)),
    )


def unique_pose(estimate: Estimate, robot: int, frame_id: str) -> UncertainPose | None:
    """
    Return the pose of a robot while exactly one hypothesis is left, else None.

    The covariance is no noise model. Its diagonal holds the squares of the greatest distances
    from the pose to the sides of its enclosure: the largest variance any distribution on the
    enclosure can have about the pose. None is below `LEAST_VARIANCE`, which is also the variance
    of what the robot cannot do in a plane. An unknown heading is given as the identity with
    `UNKNOWN_VARIANCE_RAD2`.

    Parameters
    ----------
    estimate : Estimate
    robot : int
        Row of the robot.
    frame_id : str
        Name of the fixed frame.

    Returns
    -------
    UncertainPose or None
        None also when the measurements do not bound where the robot is.

    """
    if estimate.n_hypotheses != 1 or len(estimate.placements) != 1:
        return None
    placement = estimate.placements[0]
    position = placement.positions_m[robot]
    half_widths = np.abs(placement.enclosure_m[robot] - position).max(axis=0)
    if not np.isfinite(half_widths).all():
        return None
    known = bool(placement.heading_known[robot])
    heading_variance = placement.heading_half_width_rad[robot] ** 2
    return UncertainPose(
        stamp_s=estimate.stamp_s,
        frame_id=frame_id,
        position_xyz=in_space(position),
        orientation_xyzw=placement.orientations_xyzw[robot] if known else IDENTITY,
        covariance=_covariance(
            half_widths, float(heading_variance) if known else UNKNOWN_VARIANCE_RAD2
        ),
    )


def in_space(points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points of shape (..., 2) or (..., 3) with three coordinates, z = 0 in the plane."""
    missing = 3 - points_m.shape[-1]
    return np.pad(points_m, [(0, 0)] * (points_m.ndim - 1) + [(0, missing)])


def _covariance(
    half_widths_m: NDArray[np.float64], heading_variance_rad2: float
) -> NDArray[np.float64]:
    in_plane = len(half_widths_m) == 2
    turns_rad2 = [0.0, 0.0, heading_variance_rad2] if in_plane else [heading_variance_rad2] * 3
    variances = [*np.square(in_space(half_widths_m)), *turns_rad2]
    return np.diag(np.maximum(variances, LEAST_VARIANCE))
