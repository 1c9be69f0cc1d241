# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What explains a contradiction: observations, sensors and robots; and repeat offenders."""

from itertools import combinations
import math
import re

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from sensing import new_localizer, ray
from shapes import holds

from dg_localization import Verdict
from dg_localization.fleet import LinkKey, LinkKind
from dg_localization.fleet.contradictions.conflicts import Effort, Limits, explain
from dg_localization.fleet.contradictions.suspects import Suspect, SuspectKind

NOW_S = 50.0
ROBOTS = ('a', 'b', 'c')
ANCHORS = {'m': (0.0, 0.0), 'n': (8.0, 1.0), 'o': (2.0, 7.0), 'p': (9.0, 8.0), 'q': (-4.0, 5.0)}
PLACES = {'a': (2.0, 3.0), 'b': (6.0, 5.0), 'c': (1.0, -3.0), **ANCHORS}
YAWS_RAD = {'a': 0.4, 'b': -2.0, 'c': 1.7}
TRUTH = [PLACES[robot] for robot in ROBOTS]
PAIRS = [(robot, other) for robot in ROBOTS for other in PLACES if other != robot]


def make_localizer(**settings):
    defaults = {
        'robots': ROBOTS,
        'anchors': ANCHORS,
        'max_speed_m_s': 0.0,
        'range_error': (0.0, 0.0, -0.02, 0.02),
        'bearing_half_width_rad': 0.02,
        'solver': {'resolution': 0.1, 'max_boxes': 200},
        'max_conflict_solves': 1000,
        'max_conflict_seconds': 60.0,
    }
    return new_localizer(**{**defaults, **settings})


def range_m(observer, target):
    return math.dist(PLACES[observer], PLACES[target])


def feed(localizer, turned=(), stamp_s=NOW_S, camera_s=None):
    """Give ranges of all pairs and rays, of the same detections unless `camera_s` is given."""
    for pair in PAIRS:
        localizer.add_range(*pair, range_m(*pair), stamp_s, stamp_s)
        off = 1.0 + 0.3 * PAIRS.index(pair) if pair in turned else 0.0
        seen = ray(*(PLACES[name] for name in pair), YAWS_RAD[pair[0]] - off)
        localizer.add_bearing(*pair, seen, camera_s or stamp_s, stamp_s)


def names(suspects):
    return [str(suspect) for suspect in suspects]


def test_a_range_and_a_ray_of_different_stamps_are_two_observations():
    localizer = make_localizer(max_outliers=1)
    feed(localizer, turned={('a', 'm')}, camera_s=NOW_S - 0.05)
    estimate = localizer.step(NOW_S)
    assert names(estimate.suspects) == ['bearing a->m']
    assert names(estimate.suspected_sensors) == ['m', "a's camera"]
    assert holds(estimate, TRUTH)


@pytest.mark.parametrize('others', [('m', 'o'), ('m', 'n', 'o', 'p', 'q', 'b', 'c')])
def test_several_wrong_observations_of_one_sensor_name_the_sensor(others):
    wrong = {('a', other) for other in others}
    localizer = make_localizer(max_outliers=2)
    feed(localizer, turned=wrong, camera_s=NOW_S - 0.05)
    estimate = localizer.step(NOW_S)
    assert names(estimate.suspects) == ["a's camera"]
    # Two observations may be dropped, more may not.
    assert holds(estimate, TRUTH) == (len(others) == 2)


def test_a_whole_sensor_may_be_what_is_dropped():
    localizer = make_localizer(max_outliers=1, outlier_unit='sensor')
    wrong = {('a', other) for other in PLACES}
    feed(localizer, turned=wrong, camera_s=NOW_S - 0.05)
    estimate = localizer.step(NOW_S)
    assert names(estimate.suspects) == ["a's camera"]
    assert all(
        key.kind is LinkKind.BEARING and key.observer == 'a'
        for placement in estimate.placements
        for key in placement.dropped
    )
    assert holds(estimate, TRUTH)


def test_repeat_offenders_are_counted_for_a_minute():
    localizer = make_localizer()
    stamps = [NOW_S + 4.0 * step for step in range(20)]
    for step, stamp_s in enumerate(stamps):
        wrong = {('a', 'm')} if step % 2 else {('b', 'n')} if step % 8 == 0 else set()
        feed(localizer, turned=wrong, stamp_s=stamp_s, camera_s=stamp_s - 0.05)
        estimate = localizer.step(stamp_s)
    counts = {str(o.sensor): (o.count, o.contradictions) for o in estimate.offenders}
    sensors = {"a's camera": (8, 10), "b's camera": (2, 10)}
    assert counts == {**sensors, 'm': (8, 10), 'n': (2, 10)}
    (named,) = [o for o in estimate.offenders if str(o.sensor) == "a's camera"]
    assert str(named) == (
        "a's camera was among the suspects in 8 of 10 contradictions of the last 60 s"
    )
    localizer.reset()
    feed(localizer, stamp_s=stamp_s + 2.0)
    assert localizer.step(stamp_s + 2.0).offenders == ()


@pytest.mark.parametrize('unit', SuspectKind)
def test_two_anchors_that_are_exchanged_are_named_together(unit):
    exchanged = {**ANCHORS, 'm': ANCHORS['p'], 'p': ANCHORS['m']}
    localizer = make_localizer(
        anchors=exchanged,
        outlier_unit=unit,
        max_outliers=1,
    )
    for robot in ROBOTS:
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
    localizer = make_localizer(
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
    distances = np.linalg.norm(places[:robots, None] - places[None, :robots], axis=-1)
    held = [
        np.all(distances <= p.upper_m + 1e-9) and np.all(p.lower_m <= distances + 1e-9)
        for p in exposed
    ]
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
        return any(
            conflict <= observations and effort >= least
            for conflict, least in zip(conflicts, efforts, strict=False)
        )

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
