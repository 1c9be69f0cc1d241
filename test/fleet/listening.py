# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What sensors of a drawn history hear of two points of another body: range differences."""

from dataclasses import replace
from itertools import combinations, permutations

from drives import SAMPLE_S
import numpy as np

from dg_localization.fleet import DifferenceErrorModel

DELAYS_S = (0.0, 0.05, 0.3)


def listen(history, rng):
    """Return a history with range differences of some sensors, at their bounds if extreme."""
    config, seconds = history.config, SAMPLE_S * (len(history.drives[0].true) - 2)
    bound_m = float(rng.choice([0.02, 0.1, 0.5]))
    error = DifferenceErrorModel(-bound_m, 0.5 * bound_m)
    history.config = replace(config, range_difference_error=error)
    bodies = {}
    for point, name in enumerate(config.points):
        robot = config.robot_of(name)
        body = '' if name in config.anchors else robot
        if body or robot == name:
            bodies.setdefault(body, []).append(point)
    for own, other in permutations(bodies, 2):
        pairs = [*combinations(bodies[other], 2)]
        for observer in bodies[own] if own and pairs else ():
            for first, second in rng.permutation(pairs)[:3].tolist():
                every_s = float(rng.choice([0.25, 0.6]))
                history.calls += [
                    _difference(history, rng, observer, first, second, time_s)
                    for time_s in np.arange(rng.uniform(0.0, every_s), seconds, every_s)
                ]
    history.calls.sort(key=lambda call: call[0])
    return history


def _difference(history, rng, observer, first, second, time_s):
    names = [history.config.points[point] for point in (observer, first, second)]
    share = (0.001, 0.999)[rng.integers(2)] if history.extreme else rng.uniform()

    def call(localizer, now_s):
        near_m, far_m = (history.distance(observer, end, time_s) for end in (first, second))
        error = history.config.range_difference_error
        reading_m = far_m - near_m + error.min_error_m
        reading_m += share * (error.max_error_m - error.min_error_m)
        stamp_s = history.stamp_s(observer, time_s)
        return localizer.add_range_difference(*names, reading_m, stamp_s, now_s)

    return history.start_s + time_s + DELAYS_S[rng.integers(3)], call
