# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What is sent to the node: a fleet at rest, who measures whom, and how often."""

from __future__ import annotations

from dataclasses import asdict, dataclass
import json
import math

import numpy as np


@dataclass(frozen=True)
class Scenario:
    """
    A load.

    Attributes
    ----------
    name : str
    n_robots : int
    rate_hz : float
        Messages per second on each topic.
    degree : int
        Nearest robots that each one measures.
    peers : bool
        Whether each robot sends all its readings in one message, not on a topic each.
    cameras : bool
        Whether each range comes with a ray.
    parameters : tuple of str
        ROS arguments of the node, besides the names of the robots.

    """

    name: str
    n_robots: int
    rate_hz: float
    degree: int = 6
    peers: bool = True
    cameras: bool = True
    parameters: tuple[str, ...] = ()

    @property
    def robots(self) -> list[str]:
        """The names of the robots."""
        return [f'robot_{number}' for number in range(1, self.n_robots + 1)]

    @property
    def positions_m(self) -> np.ndarray:
        """Where the robots are, shape (n, 2): about one in every 16 m^2."""
        side_m = 4.0 * math.sqrt(self.n_robots)
        return np.random.default_rng(self.n_robots).uniform(0.0, side_m, (self.n_robots, 2))

    @property
    def links(self) -> list[tuple[int, int]]:
        """Who measures whom."""
        positions = self.positions_m
        gaps = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
        order = np.argsort(gaps, axis=1)[:, 1 : self.degree + 1]
        return [(i, int(j)) for i in range(self.n_robots) for j in order[i]]

    @property
    def n_topics(self) -> int:
        """How many topics carry them."""
        return self.n_robots if self.peers else len(self.links) * (2 if self.cameras else 1)

    def to_json(self) -> str:
        """Return this as text."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Scenario:
        """Return the scenario of a text."""
        values = json.loads(text)
        return cls(**{**values, 'parameters': tuple(values['parameters'])})
