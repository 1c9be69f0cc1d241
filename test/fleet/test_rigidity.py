# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Fleets that are not rigid as a whole: their pieces, and what would join them."""

from collections import Counter
from itertools import combinations
import re

from habits import CLIMBING_M_S
from histories import History
import numpy as np
import pytest
from sensing import add_odometry, add_ranges, new_localizer
from test_frames import make_localizer, range_pairs
from test_pieces import TWO_FOURS_M, strip_m

from dg_localization import SolverOptions
from dg_localization.fleet import Localizer, RangeErrorModel

NOW_S = 10.0
TWO_FOURS = {f'r{k}': place_m for k, place_m in enumerate(TWO_FOURS_M, 1)}
FOURS = ('r1 r2 r3 r4', 'r4 r5 r6 r7')


def within(*bodies):
    """Return all pairs of some sets of points."""
    return [pair for body in bodies for pair in combinations(body.split(), 2)]


def localizer_of(places, pairs, **settings):
    """Return a localizer that knows the distances of some pairs to 0.1 %."""
    defaults = {'robots': places, 'range_error': (0.0, 0.0, -1e-3, 1e-3)}
    localizer = make_localizer(**{**defaults, **settings})
    range_pairs(localizer, places, pairs)
    return localizer


def strip(length):
    """Return the corners of a strip of fours, two by two, and the pairs within the fours."""
    places = {f's{k}': place_m for k, place_m in enumerate(strip_m(length))}
    names = [*places]
    fours = [' '.join(names[2 * k : 2 * k + 4]) for k in range(length)]
    return places, sorted(set(within(*fours)))


def test_a_range_would_fix_a_hinge():
    localizer = localizer_of(TWO_FOURS, within(*FOURS))
    estimate = localizer.step(NOW_S)
    assert estimate.rigid_groups == tuple(tuple(four.split()) for four in FOURS)
    # The pair with the longest arms: r1 is 8.5 m from the hinge, r5 5.7 m.
    assert estimate.would_fix == ('range r1 - r5 would fix the hinge at r4',)
    assert estimate.would_fix[0] in estimate.reason
    add_ranges(localizer, 'r1', TWO_FOURS['r1'], {'r5': TWO_FOURS['r5']}, NOW_S)
    assert not any(placement.flexible for placement in localizer.step(NOW_S).placements)


def test_a_range_across_would_decide_a_reflection():
    places, pairs = strip(2)
    localizer = localizer_of(places, pairs)
    estimate = localizer.step(NOW_S)
    assert estimate.n_hypotheses == 4
    (text,) = estimate.would_fix
    assert text.endswith('or bearings would decide the reflection in s2, s3')
    first, second = text.split()[1], text.split()[3]
    assert {first, second} <= set(places) - {'s2', 's3'}
    add_ranges(localizer, first, places[first], {second: places[second]}, NOW_S)
    fixed = localizer.step(NOW_S)
    assert (fixed.n_hypotheses, fixed.would_fix) == (2, ())


def test_a_robot_that_is_mirrored_in_a_line_of_anchors_is_told_to_drive_a_curve():
    anchors = {'a': (0.0, 0.0), 'b': (6.0, 1.0), 'c': (3.0, -5.0)}
    given = {'robots': ('r',), 'anchors': anchors, 'max_speed_m_s': 1.0}
    localizer = localizer_of({'r': (2.0, 3.0), **anchors}, [('r', 'a'), ('r', 'b')], **given)
    *_, told = localizer.step(NOW_S).would_fix
    assert told == 'r is mirrored in the line a - b: drive it in a curve'
    add_ranges(localizer, 'r', (2.0, 3.0), {'c': anchors['c']}, NOW_S)
    assert localizer.step(NOW_S).would_fix == ()


def test_in_space_a_shared_robot_leaves_three_ranges():
    rng = np.random.default_rng(3)
    names = [f'r{k}' for k in range(1, 10)]
    places = {name: tuple(rng.uniform(0.0, 9.0, 3)) for name in names}
    fives = ('r1 r2 r3 r4 r5', 'r5 r6 r7 r8 r9')
    estimate = localizer_of(places, within(*fives), dimension=3).step(NOW_S)
    assert estimate.rigid_groups == tuple(tuple(five.split()) for five in fives)
    assert estimate.would_fix == (
        '3 ranges between r1, r2, r3, r4 and r6, r7, r8, r9 would fix the joint at r5',
    )


def test_what_nothing_joins_needs_more_ranges():
    pairs = within('r1 r2 r3', 'r5 r6 r7')
    estimate = localizer_of(TWO_FOURS, pairs).step(NOW_S)
    text = 'at least 3 ranges to other robots or anchors would join r5, r6, r7 to the rest'
    assert estimate.would_fix == (text,)
    assert estimate.rigid_groups == (('r1', 'r2', 'r3'), ('r5', 'r6', 'r7'))


@pytest.mark.parametrize('sensors', [{'tag': (0.4, 0.0)}, {'tag': (0.4, 0.0), 'idle': (0.0, 0.3)}])
def test_what_swings_about_a_sensor_is_flexible(sensors):
    """Where r0 is on its arm is not known: that does not hold the other robots."""
    places = {'r0': (0.0, 0.0), 'r1': (5.0, 1.0), 'r2': (1.0, 5.0), 'r0/tag': (0.4, 0.0)}
    pairs = [('r0/tag', 'r1'), ('r0/tag', 'r2')]
    settings = {'robots': ('r0', 'r1', 'r2'), 'mounts': {'r0': sensors}}
    swinging = localizer_of(places, pairs, **settings).step(NOW_S)
    assert swinging.placements and all(placement.flexible for placement in swinging.placements)
    assert not any({'r1', 'r2'} & {*group} for group in swinging.rigid_groups)
    # That r0 may turn about its tag does not count.
    held = localizer_of(places, [*pairs, ('r1', 'r2')], **settings).step(NOW_S)
    assert held.placements and not any(placement.flexible for placement in held.placements)


def drawn_fleet(seed, dimension):
    """Return a fleet at rest with sensors away from centers, some points of which measure."""
    rng = np.random.default_rng(seed)
    robots, anchors = int(rng.integers(2, 6)), int(rng.choice([0, 2, 3]))
    kind = {'cameras': False, 'pace': 0.0, 'odometry': 0.0, 'max_speed_m_s': CLIMBING_M_S}
    kind |= {'range_error': RangeErrorModel(0.0, 0.0, -1e-3, 1e-3), 'max_hypotheses': 2}
    kind |= {'solver': SolverOptions(resolution=0.05, max_boxes=30)}
    mounted = int(rng.integers(robots))
    history = History.draw(seed, robots, anchors, 0.5, mounted, dimension, **kind)
    seen = rng.permutation(sorted({observed[:2] for observed in history.observed})).tolist()
    history.unranged = {*map(tuple, seen[int(rng.integers(1, 4 * robots)) :])}
    return history


class Motions:
    """What a graph of known distances leaves free to move, at random coordinates."""

    def __init__(self, names, pairs, dimension):
        rng = np.random.default_rng(0)
        self._row_of = {name: row for row, name in enumerate(names)}
        self._places = rng.random((len(names), dimension))
        gradients = np.reshape([self._gradient(*pair) for pair in pairs], (len(pairs), -1))
        _, sizes, motions = np.linalg.svd(gradients, full_matrices=True)
        self._free = motions[int((sizes > 1e-9).sum()) :]

    def _gradient(self, first, second):
        i, j = self._row_of[first], self._row_of[second]
        found = np.zeros(self._places.shape)
        found[i] = self._places[i] - self._places[j]
        found[j] = -found[i]
        return found.ravel()

    def hold(self, names):
        """Return whether some points can only move as a whole."""
        changes = [self._free @ self._gradient(*pair) for pair in combinations(names, 2)]
        return all(np.abs(change).max(initial=0.0) < 1e-7 for change in changes)


@pytest.mark.parametrize('dimension', [2, 3])
def test_what_is_called_rigid_or_fixed_is_by_the_rank_of_what_is_measured(dimension):
    called = Counter()
    for seed in range(1, 30 if dimension == 2 else 50):
        history = drawn_fleet(seed, dimension)
        ((_, estimate),) = history.play(Localizer(history.config), [0.5])
        pairs = [link.key.ends for link in estimate.links if not link.stale]
        points = history.config.points
        of_bodies = combinations(range(len(points)), 2)
        same = [(points[i], points[j]) for i, j in of_bodies if history.body(i) == history.body(j)]
        motions = Motions(points, [*pairs, *same], dimension)
        for group in estimate.rigid_groups:
            called['rigid'] += 1
            assert motions.hold(group), (seed, group)
        for text in estimate.would_fix:
            found = re.fullmatch(r'range (\S+) - (\S+) would fix the hinge at (.*)', text)
            if found:
                called['fixed'] += 1
                first, second, *hinge = [*found.groups()[:2], *found[3].split(', ')]
                assert not motions.hold([first, second]), (seed, text)
                after = Motions(points, [*pairs, *same, (first, second)], dimension)
                assert after.hold([first, second, *hinge]), (seed, text)
        measured = {name for pair in pairs for name in pair}
        if estimate.frame and estimate.frame.kind == 'anchors':
            measured |= history.config.anchors.keys()
        for placement in estimate.placements:
            if np.isfinite(placement.positions_m).all() and not placement.flexible:
                called['not flexible'] += 1
                assert motions.hold(measured), (seed, pairs)
    assert min(called[claim] for claim in ('rigid', 'fixed', 'not flexible')) >= 2


RING_ANCHORS = {
    'a': (0.0, 0.0, 0.0),
    'b': (10.0, 0.0, 1.0),
    'c': (0.0, 8.0, 2.0),
    'd': (6.0, 6.0, 4.0),
}


def estimate_after(dimension, heard, *, memory, moves=False, anchors=RING_ANCHORS):
    """Return the estimate of a robot after 8 s, in each of which it heard some anchors."""
    anchors = {name: place[:dimension] for name, place in anchors.items()}
    error = {'translation_per_m': 0.05, 'rotation_per_rad': 0.05, 'tilt_rad': 0.01}
    localizer = new_localizer('r', anchors, dimension=dimension, odometry_error=error)
    for second, names in enumerate(heard):
        now_s = NOW_S + second
        place_m = (3.0 + 0.4 * second * moves, 2.0, 1.0)
        if memory:
            add_odometry(localizer, 'r', place_m, now_s)
        heard_m = {name: anchors[name] for name in names}
        add_ranges(localizer, 'r', place_m[:dimension], heard_m, now_s)
        estimate = localizer.step(now_s)
    return estimate


@pytest.mark.parametrize('moves', [False, True])
@pytest.mark.parametrize('memory', [False, True])
@pytest.mark.parametrize('dimension', [2, 3])
def test_a_ring_about_one_anchor_is_flexible(dimension, memory, moves):
    estimate = estimate_after(dimension, ['a'] * 8, memory=memory, moves=moves)
    assert estimate.placements
    assert all(placement.flexible for placement in estimate.placements)
    assert ('r', *RING_ANCHORS) not in estimate.rigid_groups


def test_a_ring_about_anchors_above_each_other_is_flexible():
    anchors = RING_ANCHORS | {'a2': (0.0, 0.0, 5.0), 'a3': (0.0, 0.0, 8.0), 'a4': (0.0, 0.0, 9.0)}
    heard = [('a', 'a2', 'a3', 'a4')] * 3 + [()] * 3
    (placement,) = estimate_after(3, heard, memory=True, anchors=anchors).placements
    assert placement.flexible


@pytest.mark.parametrize('moves', [False, True])
@pytest.mark.parametrize('dimension', [2, 3])
def test_what_is_remembered_of_all_anchors_fixes_a_robot(dimension, moves):
    heard = ['abcd'] * 4 + ['a'] * 4
    (placement,) = estimate_after(dimension, heard, memory=True, moves=moves).placements
    assert not placement.flexible
