# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A cut keeps every pose of a box that agrees with the reading, however large the box is."""

import numpy as np
from pair_cases import turn
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.poses import PairReadings, cover_poses
from dg_localization.poses.cuts import W_SIZE, cut_box
from dg_localization.poses.half_spaces import HIGH, LOW, RULED_OUT, VIEW, Scratch, view_box

SAMPLES = 200


def cut(box, row):
    """Return what one reading says of a box, and what it leaves of it."""
    scratch = Scratch(np.empty((2, VIEW)), np.empty((2, 4)), np.zeros(4), np.empty(W_SIZE))
    view_box(box, scratch.views)
    return cut_box(scratch, box, row), scratch.faces


def random_reading(rng, kind, space):
    """Return readings of one random kind, and their exact points and bounds."""
    flat = np.array([1.0, 1.0, float(space)])
    a, b = rng.normal(size=(2, 1, 3)) * 3.0 * flat
    error = rng.choice([0.0, 0.3], size=2)[:, None] * flat
    points = [Interval(p - e, p + e) for p, e in zip((a, b), error, strict=True)]
    if 'difference' in kind:
        reference = rng.normal(size=(1, 3)) * 3.0 * flat
        low = rng.uniform(-3.0, 3.0, 1)
        readings = PairReadings.of(
            *points,
            seen_by_b=kind == 'difference of B',
            differences=(Interval.point(reference), Interval(low, low + rng.choice([0.01, 1.0]))),
        )
    elif kind == 'distance':
        low = rng.uniform(0.0, 6.0, 1)
        readings = PairReadings.of(*points, Interval(low, low + rng.choice([0.01, 1.0])))
    else:
        ray = rng.normal(size=(1, 3)) * flat
        readings = PairReadings.of(
            *points,
            rays=ray,
            ray_errors_rad=rng.choice([0.01, 0.3, 1.2], size=1),
            seen_by_b=kind == 'ray of B',
        )
    return readings, (a, b), error


def agrees(readings, kind, w, yaw, points):
    """Return which of some vectors between the points, which are given, agree with a reading."""
    if 'difference' in kind:
        a, b = points
        reference = readings.references_m.lower
        if kind == 'difference of B':
            other = w + a - reference
        else:
            other = w + turn(yaw, reference - b)
        apart = np.linalg.norm(w, axis=-1) - np.linalg.norm(other, axis=-1)
        return (readings.difference_m.lower <= apart) & (apart <= readings.difference_m.upper)
    if kind == 'distance':
        length = np.linalg.norm(w, axis=-1)
        return (readings.distance_m.lower <= length) & (length <= readings.distance_m.upper)
    seen = w if kind == 'ray of A' else turn(-yaw, -w)
    cosine = seen @ readings.rays[0] / np.linalg.norm(seen, axis=-1)
    cosine /= np.linalg.norm(readings.rays[0])
    return np.arccos(np.clip(cosine, -1.0, 1.0)) <= readings.ray_errors_rad[0]


@pytest.mark.parametrize(
    'kind', ['distance', 'ray of A', 'ray of B', 'difference of A', 'difference of B']
)
def test_no_pose_that_agrees_is_cut_off(kind):
    cuts, tested = 0, 0
    for seed in range(600):
        rng = np.random.default_rng(seed)
        space = seed % 3 == 0
        readings, (a, b), error = random_reading(rng, kind, space)
        size = 10.0 ** rng.uniform(-2.0, 0.7) * np.array([1.0, 1.0, float(space), 0.6])
        # Near a pose with the two points not far from each other.
        middle = np.append(a[0] - b[0], 0.0) + rng.normal(size=4) * 3.0 * [1, 1, space, 1]
        box = np.array([middle - size, middle + size])
        state, faces = cut(box, readings.table[0])
        where = rng.uniform(-1.0, 1.0, (SAMPLES, 4))
        where = np.where(rng.random(where.shape) < 0.3, np.sign(where), where)
        poses = middle + where * size
        off = [np.sign(rng.normal(size=(SAMPLES, 3))) * e for e in error]
        w = poses[:, :3] + turn(poses[:, 3], b + off[1]) - a - off[0]
        good = agrees(readings, kind, w, poses[:, 3], (a + off[0], b + off[1]))
        kept = np.all((faces[LOW] <= poses) & (poses <= faces[HIGH]), axis=-1)
        assert state != RULED_OUT or not np.any(good), seed
        assert np.all(kept[good]), seed
        tested += np.any(good)
        cuts += state == RULED_OUT or bool(np.any(faces != box))
    assert tested > 100 and cuts > 100


def test_exact_readings_need_rounding():
    # Differences of these coordinates are exact, so are the distances, and the yaw is zero.
    for seed in range(200):
        rng = np.random.default_rng(seed)
        position = rng.integers(-(2**40), 2**40, 3) * 2.0**-37 * [1.0, 1.0, 0.0]
        b = rng.integers(-(2**40), 2**40, (6, 3)) * 2.0**-38 * [1.0, 1.0, 0.0]
        sides = np.array(
            [[3, 4, 5], [-4, 3, 5], [5, 12, 13], [8, -15, 17], [0, 1, 1], [-12, -5, 13]]
        )
        scale = rng.integers(1, 2**30, 6) * 2.0**-30
        w = np.stack([sides[:, 0] * scale, sides[:, 1] * scale, np.zeros(6)], axis=-1)
        readings = PairReadings.of(
            Interval.point(position + b - w),
            Interval.point(b),
            Interval.point(sides[:, 2] * scale),
        )
        cover = cover_poses(readings)
        low, high = cover.boxes[:, LOW], cover.boxes[:, HIGH]
        truth = np.append(position, 0.0)
        assert np.any(np.all((low <= truth) & (truth <= high), axis=-1)), seed
