# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The likeliest poses of robots among anchors, carried on where nothing is measured.

A fit of what is left in the window would forget what the last one knew. So while nothing is
measured of a robot, its likeliest pose is that of the last fit, carried by its odometry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.stated_way import StatedWay, seen_from
from dg_localization.fleet.best_point.terms import UNIFORM
from dg_localization.fleet.estimate import Placement
from dg_localization.fleet.snapshot import Snapshot

FloatArray = NDArray[np.float64]

AXES = [0, 1, 5]
"""The rows of x, y and yaw in a covariance of position and rotation."""


@dataclass(frozen=True, eq=False)
class LikelyPose:
    """
    Where a robot in the plane was likely at a time, among the anchors.

    Parameters
    ----------
    stamp_s : float
    measured_s : float
        The time of its newest observation.
    pose : numpy.ndarray, shape (3,)
        x, y and yaw.
    covariance : numpy.ndarray, shape (3, 3)

    """

    stamp_s: float
    measured_s: float
    pose: FloatArray
    covariance: FloatArray

    def carried(self, snapshot: Snapshot, robot: str) -> LikelyPose | None:
        """Return the pose at the time of a snapshot; None where odometry does not tell."""
        track = snapshot.motion.odometry.get(robot)
        if not track or track[0].stamp_s > self.stamp_s:
            return None
        way = StatedWay(snapshot, robot, self.stamp_s)
        times_s = np.array([self.stamp_s, snapshot.stamp_s])
        dx, dy, turn_rad = seen_from(*way.poses(times_s))
        # Both ends may be late, by different times.
        error_m, error_rad = way.errors(times_s[:1], times_s[1:])[:, 0] + 2.0 * way.most_late()
        x, y, yaw_rad = self.pose
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        dx, dy = c * dx - s * dy, s * dx + c * dy
        change = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
        # The errors of a step are the same all along at worst.
        off_m2 = (error_m**2 + (error_rad * math.hypot(dx, dy)) ** 2) / UNIFORM
        errors = np.diag([off_m2, off_m2, error_rad**2 / UNIFORM])
        return LikelyPose(
            snapshot.stamp_s,
            self.measured_s,
            np.array([x + dx, y + dy, yaw_rad + turn_rad]),
            change @ self.covariance @ change.T + errors,
        )


def carried_on(
    snapshot: Snapshot, placement: Placement, before: Mapping[str, LikelyPose]
) -> tuple[Placement, dict[str, LikelyPose]]:
    """
    Return a placement among anchors, and the likely poses of its robots.

    A robot that has not been measured since its last fit gets the pose of that fit, carried to
    now by its odometry.
    """
    positions_m, covariances = placement.positions_m.copy(), placement.covariances
    yaws_rad, poses = placement.fitted_yaws_rad, dict[str, LikelyPose]()
    if covariances is None or yaws_rad is None:
        return placement, poses
    covariances, yaws_rad = covariances.copy(), yaws_rad.copy()
    measured_s = _newest_observations_s(snapshot)
    measured_now = {snapshot.config.robot_of(end) for key in snapshot.keys for end in key.ends}
    for row, robot in enumerate(snapshot.config.robots):
        newest_s, known = measured_s.get(robot, -math.inf), before.get(robot)
        carried = None
        if known is not None and robot not in measured_now and newest_s <= known.measured_s:
            carried = known.carried(snapshot, robot)
        among = np.ix_([row], AXES, AXES)
        if carried is not None:
            poses[robot] = carried
            low_m, high_m = placement.enclosure_m[row]
            positions_m[row] = np.clip(carried.pose[:2], low_m, high_m)
            covariances[among], yaws_rad[row] = carried.covariance, carried.pose[2]
        elif np.isfinite(covariances[among]).all() and np.isfinite(yaws_rad[row]):
            pose = np.array([*positions_m[row], yaws_rad[row]])
            stamp_s = snapshot.stamp_s
            poses[robot] = LikelyPose(stamp_s, newest_s, pose, covariances[among][0])
    moved = bool(np.any(positions_m != placement.positions_m))
    placement = replace(
        placement,
        positions_m=positions_m,
        covariances=covariances,
        fitted_yaws_rad=yaws_rad,
        proved=placement.proved and not moved,
    )
    return placement, poses


def _newest_observations_s(snapshot: Snapshot) -> dict[str, float]:
    """Return when each robot was last observed, or observed another."""
    config, newest_s = snapshot.config, dict[str, float]()
    for ends, seen in snapshot.window.observations.items():
        for robot in map(config.robot_of, ends):
            newest_s[robot] = max(newest_s.get(robot, -math.inf), seen[-1].stamp_s)
    return newest_s
