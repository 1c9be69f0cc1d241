# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The recording of ultra-wideband ranges with motion capture: where the robots truly were."""

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

CONFIG = 'config/tiers_uwb.yaml'
# As in the file: the frame has its origin at the first and its x axis towards the second.
ROBOTS = (1, 3, 4, 5)
LAST_S = 15.0


class UwbRecording:
    """The bag at `path`, and what motion capture says."""

    def __init__(self, path):
        self.path = path
        rows = {f'/vrpn_client_node/turtlebot{robot}_cap/pose': [] for robot in ROBOTS}
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_FOXY)) as reader:
            connections = [c for c in reader.connections if c.topic in rows]
            for connection, time_ns, raw in reader.messages(connections):
                position = reader.deserialize(raw, connection.msgtype).pose.position
                rows[connection.topic].append((time_ns * 1e-9, position.x, position.y))
        self._tracks = [np.array(track) for track in rows.values()]
        self.end_s = min(track[-1, 0] for track in self._tracks)

    def truth(self, stamp_s):
        """Return the positions with the first robot at 0 and the second on the x axis."""
        positions = np.array(
            [[np.interp(stamp_s, t[:, 0], t[:, axis]) for axis in (1, 2)] for t in self._tracks]
        )
        positions -= positions[0]
        x, y = positions[1] / np.linalg.norm(positions[1])
        return positions @ np.array([[x, -y], [y, x]])

    def check(self, scenes):
        """Check that in the last 15 s every scene has mirror images and holds the truth."""
        last = [s for s in scenes if self.end_s - LAST_S <= s.stamp_s <= self.end_s]
        for scene in last:
            truth, boxes = self.truth(scene.stamp_s), enclosures(scene)
            # Mirror images; while a robot may be on either side of a pair, each is in two parts.
            assert len(boxes) in (2, 4), f'{len(boxes)} hypotheses at {scene.stamp_s}'
            inside = (boxes[:, :, 0] <= truth + 1e-9) & (truth <= boxes[:, :, 1] + 1e-9)
            assert inside.all(axis=(1, 2)).any(), f'no hypothesis is true at {scene.stamp_s}'
        return len(last)


def enclosures(scene):
    """Return the boxes that were drawn, shape (hypothesis, robot, 2, 2)."""
    drawn = [marker.points_m for marker in scene.markers if marker.namespace == 'enclosures']
    edges = np.reshape(drawn, (-1, len(ROBOTS), 8, 3))[..., :2]
    return np.stack([edges.min(axis=2), edges.max(axis=2)], axis=2)
