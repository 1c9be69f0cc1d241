# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The messages of a simulated fleet: what its sensors measure, and the truth."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import PoseArray
import numpy as np
from numpy.typing import NDArray

from dg_localization.ros.interface.frames import BODY_FRAME
from dg_localization.ros.interface.transforms import RigidPose
from dg_localization.simulation import moving_fleet as simulation
from dg_localization.simulation.odometry import FleetOdometry
from msg_adapters.peers import PeersReading, peers_to_message
from msg_adapters.poses import PoseList, pose_array_to_message
from msg_adapters.readings import (
    BearingReading,
    OdometryReading,
    RangeReading,
    bearing_to_message,
    odometry_to_message,
    range_to_message,
)
from msg_adapters.transforms import Transform

# Not that of the localizer, whose frame moves with a robot where there are no anchors.
TRUTH_FRAME = 'world'
ODOMETRY_FRAME = 'odom'
MIN_RANGE_M = 0.1
NO_RAY = (np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class SimulatedFleet:
    """
    A moving fleet and its sensors, as messages.

    Attributes
    ----------
    motion : FleetMotion
        Where the robots are at a time.
    sensors : FleetSensors
        What they measure there.
    cameras, ranges : bool
        Whether they see and range each other.
    peers : bool
        Whether each robot sends all its ranges and bearings in one message.
    odometry : FleetOdometry or None
        Of the same motion; None when the robots have none.

    """

    motion: simulation.FleetMotion
    sensors: simulation.FleetSensors
    cameras: bool = True
    ranges: bool = True
    peers: bool = False
    odometry: FleetOdometry | None = None

    def measurements(self, time_s: float, stamp_s: float) -> Iterator[tuple[str, Any]]:
        """Range and see once."""
        state = self.motion.state(time_s)
        ranges = list(self.sensors.ranges(state)) if self.ranges else []
        bearings = list(self.sensors.bearings(state)) if self.cameras else []
        if self.peers:
            points = (*simulation.ROBOTS, *self.sensors.landmarks_m)
            yield from _peers_messages(points, ranges, bearings, stamp_s)
        else:
            yield from _pair_messages(ranges, bearings, stamp_s)

    def odometry_messages(self, time_s: float, stamp_s: float) -> Iterator[tuple[str, Any]]:
        """Sample the odometry of every robot."""
        for sample in self.odometry.samples(time_s) if self.odometry else ():
            yield (
                f'{sample.robot}/odom',
                odometry_to_message(
                    OdometryReading(
                        stamp_s,
                        np.array([*sample.position_m, 0.0]),
                        quaternions([sample.yaw_rad])[0],
                        frame_id=f'{sample.robot}/{ODOMETRY_FRAME}',
                        child_frame_id=f'{sample.robot}/{BODY_FRAME}',
                    )
                ),
            )

    def ground_truth(self, time_s: float, stamp_s: float) -> PoseArray:
        """Return the true poses in the order of the robots."""
        state = self.motion.state(time_s)
        positions_m = np.column_stack([state.positions_m, np.zeros(len(simulation.ROBOTS))])
        message: PoseArray = pose_array_to_message(
            PoseList(stamp_s, TRUTH_FRAME, positions_m, quaternions(state.yaws_rad))
        )
        return message

    def true_transforms(self, time_s: float, stamp_s: float) -> Iterator[Transform]:
        """
        Yield where the frames of the robots truly are.

        With odometry, a robot is where that says in its odometry frame, which drifts in the
        world; otherwise its body is placed in the world.
        """
        state = self.motion.state(time_s)
        truth = _rigid_poses(state.positions_m, state.yaws_rad)
        if self.odometry is None:
            for robot, body in zip(simulation.ROBOTS, truth, strict=True):
                yield _transform(stamp_s, TRUTH_FRAME, f'{robot}/{BODY_FRAME}', body)
            return
        samples = list(self.odometry.newest())
        stated = _rigid_poses(
            [sample.position_m for sample in samples], [sample.yaw_rad for sample in samples]
        )
        for sample, body, pose in zip(samples, truth, stated, strict=True):
            frame_id = f'{sample.robot}/{ODOMETRY_FRAME}'
            yield _transform(stamp_s, TRUTH_FRAME, frame_id, body.times(pose.inverse()))
            yield _transform(stamp_s, frame_id, f'{sample.robot}/{BODY_FRAME}', pose)


def _rigid_poses(
    positions_m: NDArray[np.float64] | Sequence[tuple[float, float]],
    yaws_rad: Sequence[float] | NDArray[np.float64],
) -> list[RigidPose]:
    """Return poses in the plane, (n, 2) and (n,), as poses in space."""
    return [
        RigidPose(np.array([x, y, 0.0]), xyzw)
        for (x, y), xyzw in zip(positions_m, quaternions(yaws_rad), strict=True)
    ]


def _transform(stamp_s: float, frame_id: str, child_frame_id: str, pose: RigidPose) -> Transform:
    return Transform(stamp_s, frame_id, child_frame_id, pose.position_m, pose.xyzw)


def _pair_messages(
    ranges: Iterable[simulation.SimulatedRange],
    bearings: Iterable[simulation.SimulatedBearing],
    stamp_s: float,
) -> Iterator[tuple[str, Any]]:
    """Yield a topic and a message for each pair."""
    for distance in ranges:
        yield (
            f'{distance.observer}/range/{distance.target}',
            range_to_message(
                RangeReading(
                    stamp_s,
                    distance.range_m,
                    min_range_m=MIN_RANGE_M,
                    max_range_m=simulation.REACH_M,
                    frame_id=distance.observer,
                )
            ),
        )
    for bearing in bearings:
        yield (
            f'{bearing.observer}/bearing/{bearing.target}',
            bearing_to_message(BearingReading(stamp_s, np.array(bearing.ray), bearing.observer)),
        )


def _peers_messages(
    points: Sequence[str],
    ranges: Iterable[simulation.SimulatedRange],
    bearings: Iterable[simulation.SimulatedBearing],
    stamp_s: float,
) -> Iterator[tuple[str, Any]]:
    """Yield a topic and a message for each robot, even for one that measured nobody."""
    ranges_m = {(r.observer, r.target): r.range_m for r in ranges}
    rays = {(b.observer, b.target): b.ray for b in bearings}
    for observer in simulation.ROBOTS:
        pairs = [(observer, target) for target in points]
        measured = [pair for pair in pairs if pair in ranges_m or pair in rays]
        reading = PeersReading(
            stamp_s,
            peers=np.array([points.index(target) for _, target in measured], dtype=int),
            ranges_m=np.array([ranges_m.get(pair, np.nan) for pair in measured]),
            rays_xyz=np.array([rays.get(pair, NO_RAY) for pair in measured]).reshape(-1, 3),
            frame_id=observer,
        )
        yield f'{observer}/peers', peers_to_message(reading)


def quaternions(yaws_rad: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return turns about z as quaternions, scalar last."""
    half_rad = np.asarray(yaws_rad) / 2.0
    zeros = np.zeros_like(half_rad)
    return np.column_stack([zeros, zeros, np.sin(half_rad), np.cos(half_rad)])
