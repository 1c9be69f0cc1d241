# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Contradictions are named and survived; a beacon that is always wrong is dropped."""

from itertools import combinations
import math

import numpy as np
import pytest
from sensing import add_odometry, add_ranges, new_localizer
from shapes import check_form, holds, missing

from dg_localization import Verdict
from dg_localization.fleet import LinkKey, LinkKind, RangeErrorModel

ROBOTS = ('a', 'b', 'c', 'd', 'e', 'f')
POSITIONS = np.array([[0.0, 0.0], [6.0, 0.0], [5.0, 4.0], [1.0, 5.0], [3.0, 8.0], [-2.0, 2.0]])
PLACES_M = dict(zip(ROBOTS, POSITIONS, strict=True))
NOW_S = 50.0
WRONG = LinkKey(LinkKind.RANGE, 'a', 'b')


def make_localizer(**settings):
    defaults = {
        'robots': ROBOTS,
        'max_age_s': 1.0,
        'max_speed_m_s': 0.0,
        'range_error': (0.0, 0.0, -0.002, 0.002),
        'solver': {'resolution': 0.1, 'max_boxes': 200},
        'max_conflict_solves': 1000,
        'max_conflict_seconds': 60.0,
    }
    return new_localizer(**{**defaults, **settings})


def feed(localizer, stamp_s=NOW_S, wrong=(), errors=2.0):
    for (first, place_m), (second, other_m) in combinations(PLACES_M.items(), 2):
        off_m = errors if (first, second) in wrong else 0.0
        add_ranges(localizer, first, place_m, {second: other_m}, stamp_s, off_m)


def truth():
    """Return the fleet with a in the origin and b on the x axis, and its mirror image."""
    return POSITIONS, POSITIONS * [1.0, -1.0]


def test_a_contradiction_gives_nothing_but_its_cause():
    localizer = make_localizer()
    feed(localizer, wrong={('a', 'b')})
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is Verdict.INFEASIBLE
    assert estimate.placements == ()
    assert estimate.n_hypotheses == 0
    assert 'contradict' in estimate.reason
    assert estimate.conflicts
    assert all(WRONG in conflict for conflict in estimate.conflicts)
    assert str(WRONG) in estimate.reason
    guilty = {link.key for link in estimate.links if link.contradicts}
    assert WRONG in guilty
    assert len(guilty) < len(estimate.links)


def test_one_outlier_may_be_dropped():
    localizer = make_localizer(max_outliers=1)
    feed(localizer, wrong={('a', 'b')})
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is Verdict.COVERED
    assert {placement.dropped for placement in estimate.placements} == {(WRONG,)}
    assert str(WRONG) in estimate.reason
    assert estimate.conflicts
    assert all(holds(estimate, positions) for positions in truth())


@pytest.mark.parametrize(
    ('solves', 'wrong', 'text'),
    [
        (1000, [('a', 'b'), ('c', 'd')], 'dropping 1 observation does not'),
        (0, [('a', 'b')], 'budget'),
    ],
)
def test_more_outliers_than_allowed_and_no_budget_give_nothing(solves, wrong, text):
    localizer = make_localizer(max_outliers=1, max_conflict_solves=solves)
    feed(localizer, wrong=wrong, errors=3.0)
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is Verdict.INFEASIBLE
    assert estimate.placements == ()
    assert bool(estimate.conflicts) == (solves > 0)
    assert text in estimate.reason


def test_a_misread_marker_is_found():
    localizer = make_localizer(max_outliers=1)
    feed(localizer)
    for target in ('b', 'c', 'd', 'e'):
        ray = PLACES_M[target] * (-1.0 if target == 'b' else 1.0)
        localizer.add_bearing('a', target, [*ray, 0.0], NOW_S, NOW_S)
    estimate = localizer.step(NOW_S)
    assert estimate.conflicts
    marker = LinkKey(LinkKind.BEARING, 'a', 'b')
    assert all(marker in conflict for conflict in estimate.conflicts)
    # The range of the same detection goes with it.
    assert {placement.dropped for placement in estimate.placements} == {(marker, WRONG)}
    assert [str(suspect) for suspect in estimate.suspects] == ['bearing and range a->b']
    assert estimate.n_hypotheses == 1
    assert holds(estimate, POSITIONS)


def test_a_range_no_distance_can_give_stays_one_as_it_ages():
    model = RangeErrorModel(min_error_m=0.5, max_error_m=1.0)
    localizer = make_localizer(range_error=model, max_speed_m_s=1.0, max_age_s=1.0)
    localizer.add_range('a', 'b', 0.1, NOW_S, NOW_S)
    for later_s in (0.0, 0.3, 0.9):
        estimate = localizer.step(NOW_S + later_s)
        assert estimate.verdict is Verdict.INFEASIBLE
        assert estimate.conflicts == ((WRONG,),)


@pytest.mark.parametrize('max_outliers', [0, 2])
def test_settings_that_contradict_each_other_are_no_fault_of_measurements(max_outliers):
    anchors = {'a': (0.0, 0.0), 'b': (1.0, 0.0)}
    localizer = make_localizer(anchors=anchors, min_separation_m=2.0, max_outliers=max_outliers)
    for anchor in anchors:
        assert localizer.add_range('c', anchor, 3.0, NOW_S, NOW_S) is None
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is Verdict.INFEASIBLE
    assert estimate.reason.startswith('the settings contradict each other')
    assert estimate.conflicts == estimate.suspects == ()
    assert not any(link.contradicts for link in estimate.links)


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_correction_may_cut_the_reference_robot_off(dimension):
    # Either range of the reference robot may be wrong, and one of them is all that holds it.
    localizer = make_localizer(max_outliers=1, dimension=dimension)
    for first, second, reading in (
        ('a', 'b', 1.0),
        ('b', 'c', 1.0),
        ('c', 'd', 1.0),
        ('d', 'a', 5.0),
        ('b', 'd', 1.5),
    ):
        localizer.add_range(first, second, reading, NOW_S, NOW_S)
    localizer.add_range('b', 'e', 1.0, NOW_S, NOW_S)
    estimate = localizer.step(NOW_S)
    assert estimate.verdict in (Verdict.COVERED, Verdict.OUT_OF_BUDGET)
    corrections = {placement.dropped for placement in estimate.placements}
    assert (WRONG,) in corrections
    assert (LinkKey(LinkKind.RANGE, 'd', 'a'),) in corrections
    for placement in estimate.placements:
        check_form(placement)


def test_a_correction_that_leaves_the_reference_robot_alone_bounds_nothing():
    localizer = make_localizer(max_outliers=1)
    localizer.add_range('a', 'b', 1.0, NOW_S, NOW_S)
    localizer.add_range('b', 'a', 5.0, NOW_S, NOW_S)
    assert {p.dropped[0].observer for p in localizer.step(NOW_S).placements} == {'a', 'b'}


def test_what_contradicts_is_forgotten_also_where_its_stamp_is_later_than_the_answer():
    localizer = make_localizer(max_outliers=1, memory_s=10.0)
    for name in ROBOTS:
        add_odometry(localizer, name, (0.0, 0.0), NOW_S)
    feed(localizer, stamp_s=NOW_S + 0.05, wrong=[('a', 'b')])
    (forgotten,) = localizer.step(NOW_S).forgotten
    assert WRONG.ends in forgotten.ends
    assert forgotten.after_s < NOW_S - 1.0 and NOW_S + 0.05 < forgotten.before_s


@pytest.mark.parametrize(('max_seconds', 'others'), [(1e-6, ()), (1e-6, ('g', 'h')), (5.0, ())])
def test_a_smaller_correction_that_is_not_proved_hides_no_larger_one(max_seconds, others):
    """
    Without r0->r1 the rest still contradict each other, which takes the solver long to see.

    What is proved of robots that nothing connects to these proves nothing of them.
    """
    rng = np.random.default_rng(30004)
    places = rng.uniform(0.0, 10.0, (8, 2))
    error = float(rng.choice([0.01, 0.03]))
    pairs = [(i, j) for i, j in combinations(range(8), 2) if (i, j) != (0, 1)]
    pairs = [pair for pair in pairs if rng.random() < 0.65]
    wrong = pairs[rng.integers(len(pairs))]
    off_m = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.5)
    localizer = new_localizer(
        (*(f'r{k}' for k in range(8)), *others),
        range_error=(0.0, 0.0, -error, error),
        memory_s=0.0,
        max_outliers=2,
        max_conflict_seconds=math.inf,
        max_conflict_solves=10_000,
        solver={'max_seconds': max_seconds},
    )
    apart_m = np.linalg.norm(places[:, None] - places, axis=-1)
    for i, j in pairs:
        range_m = apart_m[i, j] + (off_m if (i, j) == wrong else 0.0)
        localizer.add_range(f'r{i}', f'r{j}', range_m, NOW_S, NOW_S)
    if others:
        localizer.add_range(*others, 3.0, NOW_S, NOW_S)
    localizer.add_range('r0', 'r1', apart_m[0, 1] + 5.0, NOW_S, NOW_S)
    localizer.add_range('r1', 'r0', apart_m[0, 1], NOW_S, NOW_S)
    estimate = localizer.step(NOW_S)
    assert any(
        ((one.lower_m[:8, :8] <= apart_m + 1e-9) & (apart_m - 1e-9 <= one.upper_m[:8, :8])).all()
        for one in estimate.placements
    )


TICKS = 12
ANCHORS_M = {
    'b1': (0.0, 0.0, 0.1),
    'b2': (8.0, 0.5, 2.0),
    'b3': (0.5, 6.0, 3.0),
    'b4': (8.0, 6.5, 0.4),
    'b5': (4.0, -3.0, 1.7),
}


def estimates(
    wrong, *, error_m=1.5, n_anchors=4, dimension=2, speed_m_s=0.2, from_tick=0, **settings
):
    """Yield estimates of a robot with odometry, and where it truly is."""
    anchors_m = {name: place[:dimension] for name, place in [*ANCHORS_M.items()][:n_anchors]}
    localizer = new_localizer(
        ('r1',),
        dimension=dimension,
        anchors=anchors_m,
        range_error=(-0.05, 0.3, 0.0, 0.0),
        max_speed_m_s=0.5,
        **settings,
    )
    for tick in range(TICKS):
        for step in range(5):
            now_s = 1000.0 + 0.5 * tick + 0.1 * step
            place = np.array([2.0 + speed_m_s * (now_s - 1000.0), 2.0, 0.0])
            for name, anchor_m in anchors_m.items():
                off_m = error_m if name == wrong and tick >= from_tick else 0.05
                add_ranges(localizer, 'r1', place[:dimension], {name: anchor_m}, now_s, off_m)
            add_odometry(localizer, 'r1', place, now_s)
        yield localizer.step(now_s), place[:dimension]


@pytest.mark.parametrize(
    'case',
    [
        {'wrong': 'b2'},
        {'wrong': 'b3', 'speed_m_s': 0.0},
        {'wrong': 'b1', 'n_anchors': 5, 'error_m': -1.2},
        {'wrong': 'b2', 'n_anchors': 5, 'dimension': 3},
        {'wrong': 'b2', 'window_outliers': 1},
        {'wrong': 'b4', 'max_outliers': 2},
        {'wrong': 'b2', 'memory_s': 0.0},
    ],
)
def test_it_is_dropped_at_every_tick(case):
    for estimate, place in estimates(**{'max_outliers': 1, **case}):
        assert estimate.placements
        assert holds(estimate, place)
        assert any(case['wrong'] in str(suspect) for suspect in estimate.suspects)


def test_it_is_named_where_nothing_may_be_dropped():
    for estimate, _ in estimates('b2'):
        assert estimate.verdict is Verdict.INFEASIBLE
        assert 'range r1->b2' in map(str, estimate.suspects)


def test_what_was_remembered_before_it_went_wrong_stays():
    widths_m = []
    for tick, (estimate, place) in enumerate(estimates('b2', from_tick=6, max_outliers=1)):
        assert holds(estimate, place)
        if tick >= 6:
            assert any('b2' in str(suspect) for suspect in estimate.suspects)
        widths_m.append(float(np.ptp(estimate.placements[0].enclosure_m, axis=1).max()))
    assert max(widths_m[6:]) < 3.0 * max(widths_m[:6])


@pytest.mark.parametrize('others', [False, True], ids=['nothing', 'others'])
def test_the_first_readings_of_a_pair_are_not_trusted_either(others):
    """They are stamped after the answer, before anything of the pair is remembered."""
    places_m = {'r0': (3.0, 2.0), 'r1': (4.0, 5.0)}
    anchors_m = {'west': (0.0, 0.0), 'east': (10.0, 0.0), 'north': (4.0, 8.0)}
    localizer = new_localizer(
        tuple(places_m),
        anchors=anchors_m,
        range_error=(-0.1, 0.1, -0.03, 0.03),
        window_outliers=1,
    )

    stamps_s = 100.0 + 0.1 * np.arange(20)
    for stamp_s in stamps_s:
        for robot in places_m:
            add_odometry(localizer, robot, (0.0, 0.0), stamp_s, frame=robot)
        if others:
            add_ranges(localizer, 'r1', places_m['r1'], anchors_m, stamp_s)
    for name, anchor_m in anchors_m.items():
        target, off_m = {name: anchor_m}, float(name == 'west')
        add_ranges(localizer, 'r0', places_m['r0'], target, stamp_s + 0.05, off_m)
    estimate = localizer.step(localizer.answer_time(stamp_s + 0.06))
    assert estimate.stamp_s == stamp_s and estimate.verdict is not Verdict.INFEASIBLE
    assert not estimate.forgotten
    assert not any(missing(one, [*places_m.values()]) for one in estimate.placements)
    assert bool(estimate.placements) is others
