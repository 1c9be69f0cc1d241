# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""How high the points of a fleet in the plane are, what is stated of it, and what is read."""

from dataclasses import dataclass, field
import math

import numpy as np

from dg_localization.fleet import ElevationErrorModel

FASTEST_M_S = 0.3


@dataclass
class Heights:
    """Robots that rise and sink, and anchors that stay; without `stated_m` all are at 0."""

    stated_m: dict = field(default_factory=dict)
    error: ElevationErrorModel = ElevationErrorModel()
    every_s: dict = field(default_factory=dict)
    """How often the elevation of a robot is read, of those that read it."""
    waves: dict = field(default_factory=dict)
    """The middle (m), the amplitude (m), the frequency (rad/s) and the phase (rad) of each."""

    @classmethod
    def draw(cls, seed, robots, anchors):
        """Draw those of a seed for robots and anchors by name; most fleets are flat."""
        rng = np.random.default_rng(seed)
        if rng.random() < 0.7:
            return cls()
        heights = cls(error=ElevationErrorModel(-float(rng.choice([0.0, 0.1])), 0.05))
        for name in (*robots, *anchors):
            swing_m = rng.uniform(0.0, 1.5) if name in robots else 0.0
            wave = (rng.uniform(-3.0, 3.0), swing_m, FASTEST_M_S / 1.5, rng.uniform(0.0, 6.0))
            low_m, high_m = rng.choice([0.0, 0.1, 2.0], 2)
            heights.waves[name] = wave
            heights.stated_m[name] = (wave[0] - swing_m - low_m, wave[0] + swing_m + high_m)
            if name in robots and rng.random() < 0.7:
                heights.every_s[name] = rng.choice([0.1, 0.4])
        return heights

    def at_m(self, name, time_s):
        """Return how high a robot or an anchor is, some seconds after the start."""
        middle_m, swing_m, frequency_rad_s, phase_rad = self.waves.get(name, (0.0,) * 4)
        return middle_m + swing_m * math.sin(frequency_rad_s * time_s + phase_rad)

    def read_m(self, name, time_s, share):
        """Return what is read of it: `share` tells where in its bounds the error is."""
        low_m, high_m = self.error.min_error_m, self.error.max_error_m
        return self.at_m(name, time_s) + low_m + share * (high_m - low_m)
