# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Contradictions are named, explained and survived; who is always wrong is named and dropped."""

from itertools import combinations
import math
import re

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from sensing import add_odometry, add_ranges, new_localizer, ray
from shapes import check_form, holds, missing

from dg_localization import Verdict
from dg_localization.fleet import LinkKey, LinkKind, RangeErrorModel
from dg_localization.fleet.contradictions.conflicts import Effort, Limits, explain
from dg_localization.fleet.contradictions.suspects import Suspect, SuspectKind

ROBOTS = ('a', 'b', 'c', 'd', 'e', 'f')
POSITIONS = np.array([[0.0, 0.0], [6.0, 0.0], [5.0, 4.0], [1.0, 5.0], [3.0, 8.0], [-2.0, 2.0]])
PLACES_M = dict(zip(ROBOTS, POSITIONS, strict=True))
NOW_S = 50.0
WRONG = LinkKey(LinkKind.RANGE, 'a', 'b')


def make_localizer(**settings):
    defaults = {
        'robots': ROBOTS,
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
    # With a in the origin and b on the x axis, the fleet and its mirror image.
    assert all(holds(estimate, POSITIONS * [1.0, side]) for side in (1.0, -1.0))


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
    bounds = [(one.lower_m[:8, :8], one.upper_m[:8, :8]) for one in estimate.placements]
    assert any(np.all((low <= apart_m + 1e-9) & (apart_m - 1e-9 <= high)) for low, high in bounds)


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
        tuple(places_m), anchors=anchors_m, range_error=(-0.1, 0.1, -0.03, 0.03), window_outliers=1
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


TRIO = ('a', 'b', 'c')
ANCHORS = {'m': (0.0, 0.0), 'n': (8.0, 1.0), 'o': (2.0, 7.0), 'p': (9.0, 8.0), 'q': (-4.0, 5.0)}
POINTS_M = {'a': (2.0, 3.0), 'b': (6.0, 5.0), 'c': (1.0, -3.0), **ANCHORS}
YAWS_RAD = {'a': 0.4, 'b': -2.0, 'c': 1.7}
TRIO_M = [POINTS_M[robot] for robot in TRIO]
PAIRS = [(robot, other) for robot in TRIO for other in POINTS_M if other != robot]


def make_trio(**settings):
    """Return a localizer of three robots with cameras among anchors."""
    among = {'robots': TRIO, 'anchors': ANCHORS, 'bearing_half_width_rad': 0.02}
    return make_localizer(**{**among, 'range_error': (0.0, 0.0, -0.02, 0.02), **settings})


def range_m(observer, target):
    return math.dist(POINTS_M[observer], POINTS_M[target])


def feed_trio(localizer, turned=(), stamp_s=NOW_S, camera_s=None):
    """Give ranges of all pairs and rays, of the same detections unless `camera_s` is given."""
    for pair in PAIRS:
        localizer.add_range(*pair, range_m(*pair), stamp_s, stamp_s)
        off = 1.0 + 0.3 * PAIRS.index(pair) if pair in turned else 0.0
        seen = ray(*(POINTS_M[name] for name in pair), YAWS_RAD[pair[0]] - off)
        localizer.add_bearing(*pair, seen, camera_s or stamp_s, stamp_s)


def names(suspects):
    return [str(suspect) for suspect in suspects]


def test_a_range_and_a_ray_of_different_stamps_are_two_observations():
    localizer = make_trio(max_outliers=1)
    feed_trio(localizer, turned={('a', 'm')}, camera_s=NOW_S - 0.05)
    estimate = localizer.step(NOW_S)
    assert names(estimate.suspects) == ['bearing a->m']
    assert names(estimate.suspected_sensors) == ['m', "a's camera"]
    assert holds(estimate, TRIO_M)


@pytest.mark.parametrize('others', [('m', 'o'), ('m', 'n', 'o', 'p', 'q', 'b', 'c')])
def test_several_wrong_observations_of_one_sensor_name_the_sensor(others):
    wrong = {('a', other) for other in others}
    localizer = make_trio(max_outliers=2)
    feed_trio(localizer, turned=wrong, camera_s=NOW_S - 0.05)
    estimate = localizer.step(NOW_S)
    assert names(estimate.suspects) == ["a's camera"]
    # Two observations may be dropped, more may not.
    assert holds(estimate, TRIO_M) == (len(others) == 2)


def test_a_whole_sensor_may_be_what_is_dropped():
    localizer = make_trio(max_outliers=1, outlier_unit='sensor')
    wrong = {('a', other) for other in POINTS_M}
    feed_trio(localizer, turned=wrong, camera_s=NOW_S - 0.05)
    estimate = localizer.step(NOW_S)
    assert names(estimate.suspects) == ["a's camera"]
    dropped = [key for placement in estimate.placements for key in placement.dropped]
    assert all(key.kind is LinkKind.BEARING and key.observer == 'a' for key in dropped)
    assert holds(estimate, TRIO_M)


def test_repeat_offenders_are_counted_for_a_minute():
    localizer = make_trio()
    stamps = [NOW_S + 4.0 * step for step in range(20)]
    for step, stamp_s in enumerate(stamps):
        wrong = {('a', 'm')} if step % 2 else {('b', 'n')} if step % 8 == 0 else set()
        feed_trio(localizer, turned=wrong, stamp_s=stamp_s, camera_s=stamp_s - 0.05)
        estimate = localizer.step(stamp_s)
    counts = {str(o.sensor): (o.count, o.contradictions) for o in estimate.offenders}
    sensors = {"a's camera": (8, 10), "b's camera": (2, 10)}
    assert counts == {**sensors, 'm': (8, 10), 'n': (2, 10)}
    (named,) = [o for o in estimate.offenders if str(o.sensor) == "a's camera"]
    text = "a's camera was among the suspects in 8 of 10 contradictions of the last 60 s"
    assert str(named) == text
    localizer.reset()
    feed_trio(localizer, stamp_s=stamp_s + 2.0)
    assert localizer.step(stamp_s + 2.0).offenders == ()


@pytest.mark.parametrize('unit', SuspectKind)
def test_two_anchors_that_are_exchanged_are_named_together(unit):
    exchanged = {**ANCHORS, 'm': ANCHORS['p'], 'p': ANCHORS['m']}
    localizer = make_trio(anchors=exchanged, outlier_unit=unit, max_outliers=1)
    for robot in TRIO:
        for anchor in ANCHORS:
            localizer.add_range(robot, anchor, range_m(robot, anchor), NOW_S, NOW_S)
    estimate = localizer.step(NOW_S)
    # By chance the three others and these two are symmetric to a line.
    assert names(estimate.suspects) == ['m', 'n', 'p', 'q']
    assert names(offender.sensor for offender in estimate.offenders) == ['m', 'n', 'p', 'q']
    assert 'together these explain it: m and p, or n and q' in estimate.reason
    assert re.search(r'range a->\w \(\d+\.\d\d to \d+\.\d\d m\)', estimate.reason)


@settings(max_examples=40, derandomize=False)
@given(
    seed=st.integers(0, 2**32 - 1),
    wrong=st.integers(1, 3),
    robots=st.integers(2, 5),
    anchors=st.sampled_from([0, 3, 5]),
    kept=st.sampled_from([0.6, 0.9, 1.0]),
    agreeing=st.booleans(),
)
def test_wrong_observations_that_are_exposed_never_cost_the_truth(
    seed, wrong, robots, anchors, kept, agreeing
):
    """
    The truth is in the answer, unless a proper part of the wrong ones explains everything.

    Wrong observations that agree with one another say that one robot is somewhere else.
    """
    rng = np.random.default_rng(seed)
    places = rng.uniform(-6.0, 6.0, (robots + anchors, 2))
    points = [*(f'r{i}' for i in range(robots)), *(f'm{i}' for i in range(anchors))]
    pairs = [(i, j) for i in range(robots) for j in range(i + 1, robots + anchors)]
    pairs = [pair for pair in pairs if rng.random() < kept]
    if len(pairs) < wrong:
        return
    liars = {pairs[i] for i in rng.choice(len(pairs), wrong, replace=False)}
    elsewhere = places + rng.uniform(-4.0, 4.0, places.shape) if agreeing else None
    localizer = make_trio(
        robots=tuple(points[:robots]),
        anchors=dict(zip(points[robots:], places[robots:], strict=True)),
        max_outliers=wrong,
        max_hypotheses=5000,
    )
    for i, j in pairs:
        reading = math.dist(places[i], places[j]) * rng.uniform(0.981, 1.019)
        if (i, j) in liars:
            reading = (
                math.dist(elsewhere[i], places[j]) if agreeing else reading + rng.exponential(2)
            )
        localizer.add_range(points[i], points[j], reading, NOW_S, NOW_S)
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is not Verdict.INFEASIBLE
    if not estimate.placements:
        return
    wanted = {LinkKey(LinkKind.RANGE, points[i], points[j]) for i, j in liars}
    assert any(wanted.issuperset(placement.dropped) for placement in estimate.placements)
    exposed = [p for p in estimate.placements if wanted == set(p.dropped)]
    apart_m = np.linalg.norm(places[:robots, None] - places[None, :robots], axis=-1)
    held = [np.all((p.lower_m - 1e-9 <= apart_m) & (apart_m <= p.upper_m + 1e-9)) for p in exposed]
    assert not held or any(held)


SEEN = tuple(Suspect(SuspectKind.OBSERVATION, f'r{i}', 's', (LinkKind.RANGE,)) for i in range(8))
EVERYTHING = frozenset(SEEN)
ALONE = {one: frozenset([one]) for one in SEEN}
AMPLE = (10_000, 60.0)

conflict_sets = st.lists(
    st.frozensets(st.sampled_from(SEEN), min_size=1, max_size=4), min_size=1, max_size=4
)
efforts = st.lists(st.sampled_from(Effort), min_size=4, max_size=4)
parts = st.lists(st.frozensets(st.sampled_from(SEEN), min_size=1), max_size=3)


def contradiction_of(conflicts, efforts=(Effort.BRIEF,) * 4):
    """Return an oracle that sees each conflict from some effort on."""

    def contradicts(observations, effort):
        pairs = zip(conflicts, efforts, strict=False)
        return any(one <= observations and effort >= least for one, least in pairs)

    return contradicts


def explained(conflicts, max_outliers, *, efforts=(Effort.BRIEF,) * 4, regions=()):
    limits = Limits(max_outliers, *AMPLE)
    return explain(EVERYTHING, regions, (ALONE,), contradiction_of(conflicts, efforts), limits)


def hitting(conflicts, named, most):
    """Return all minimal sets of up to `most` suspects that are part of every conflict."""
    sets = [frozenset(s) for size in range(most + 1) for s in combinations(named, size)]
    covered = {s: frozenset().union(*(named[one] for one in s)) for s in sets}
    hit = [s for s in sets if all(covered[s] & conflict for conflict in conflicts)]
    return {s for s in hit if not any(other < s for other in hit)}


@settings(derandomize=False)
@given(conflicts=conflict_sets, max_outliers=st.integers(0, 3), regions=parts, efforts=efforts)
def test_all_minimal_corrections(conflicts, max_outliers, regions, efforts):
    explanation = explained(conflicts, max_outliers, efforts=efforts, regions=regions)
    assert not explanation.stopped and not explanation.among
    assert explanation.conflicts
    for found in explanation.conflicts:
        assert any(conflict <= found for conflict in conflicts)
    expected = hitting(conflicts, ALONE, max_outliers) if max_outliers else set()
    assert set(explanation.corrections) == expected


@pytest.mark.parametrize('most', [2, 3])
def test_more_tolerance_gives_at_least_what_less_does(most):
    conflicts = [frozenset(SEEN[:3]), frozenset(SEEN[3:6]), frozenset(SEEN[1:5])]
    less = explained(conflicts, most - 1)
    for solves in range(0, 400, 7):
        limited = Limits(most, solves, 60.0)
        more = explain(EVERYTHING, (), (ALONE,), contradiction_of(conflicts), limited)
        if more.searched >= most - 1:
            assert set(less.corrections) <= set(more.corrections)
