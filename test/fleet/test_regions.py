# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Each side of anchors nearly in a hyperplane is a hypothesis; idle anchors change nothing."""

import numpy as np
import pytest
from sensing import add_ranges, anchors_at, new_localizer
from shapes import holds, missing

from dg_localization import Verdict


def answer(anchors, places, peers=(), seen=(), bound_m=0.0, **settings):
    """Return the answer to ranges of robots to anchors, all or those seen, and to some peers."""
    rng = np.random.default_rng(5)
    localizer = new_localizer(
        places,
        anchors=anchors_at(anchors, bound_m),
        range_error=(-0.05, 0.05, 0.0, 0.0),
        memory_s=0.0,
        max_speed_m_s=0.0,
        **settings,
    )
    points = {**anchors, **places}
    links = [(robot, anchor) for robot in places for anchor in seen or anchors]
    for observer, target in (*links, *peers):
        aim = {target: points[target]}
        add_ranges(localizer, observer, points[observer], aim, 100.0, rng.uniform(-0.04, 0.04))
    return localizer.step(100.0)


def nearest_deviations(estimate, places):
    """Return how many deviations the best of the points is off on its worst axis."""
    truth_m = np.array(list(places.values()))
    found = []
    for one in estimate.placements:
        sigma_m = np.sqrt([np.diag(c)[: truth_m.shape[1]] for c in one.covariances])
        found.append(np.max(np.abs(one.positions_m - truth_m) / sigma_m))
    return min(found)


def n_holding(estimate, places):
    """Return how many placements have all robots in their enclosures."""
    return sum(not missing(one, [*places.values()]) for one in estimate.placements)


@pytest.mark.parametrize('bump_m', [1e-6, 1e-3, 0.03])
@pytest.mark.parametrize('y_m', [-3.0, 1.5])
def test_each_side_of_a_wall_is_a_hypothesis(bump_m, y_m):
    """Three anchors of which one is a little out of line leave both sides open."""
    anchors = {'w0': (0.0, 0.0), 'w1': (5.0, bump_m), 'w2': (9.0, 0.0)}
    places = {'r': (3.0, y_m)}
    estimate = answer(anchors, places)
    assert estimate.n_hypotheses == len(estimate.placements) == 2
    assert n_holding(estimate, places) == 1
    assert nearest_deviations(estimate, places) < 4.0
    sides = {np.sign(one.positions_m[0, 1]) for one in estimate.placements}
    assert sides == {-1.0, 1.0}
    assert all(
        one.enclosure_m[0, 0, 1] * one.enclosure_m[0, 1, 1] > 0 for one in estimate.placements
    )


def test_ranges_between_robots_leave_the_sides_that_agree():
    """Of four combinations of sides, two have the robots as far apart as they measured."""
    anchors = {'w0': (0.0, 0.0), 'w1': (5.0, 0.002), 'w2': (9.0, 0.0)}
    places = {'r': (3.0, 2.0), 's': (5.0, 3.0)}
    assert answer(anchors, places).n_hypotheses == 4
    estimate = answer(anchors, places, peers=[('r', 's')])
    assert estimate.n_hypotheses == len(estimate.placements) == 2
    assert n_holding(estimate, places) == 1


@pytest.mark.parametrize('bump_m', [1e-6, 0.01])
def test_each_side_of_a_ceiling_is_a_hypothesis(bump_m):
    """Four anchors nearly in a plane leave the places above and below it open."""
    anchors = {'c0': (0, 0, 3), 'c1': (8, 0, 3 + bump_m), 'c2': (8, 6, 3), 'c3': (0, 6, 3)}
    places = {'r': (3.0, 2.0, 1.0)}
    estimate = answer(anchors, places, dimension=3)
    assert estimate.n_hypotheses == len(estimate.placements) == 2
    assert n_holding(estimate, places) == 1
    assert nearest_deviations(estimate, places) < 4.0


def test_one_place_is_one_hypothesis():
    """Where the robot is near the line, or the anchors are far from one, the places touch."""
    wall = {'w0': (0.0, 0.0), 'w1': (5.0, 1e-3), 'w2': (9.0, 0.0)}
    assert answer(wall, {'r': (3.0, 0.1)}).n_hypotheses == 1
    hall = {'a': (0.0, 0.0), 'b': (9.0, 0.0), 'c': (0.0, 7.0)}
    assert answer(hall, {'r': (3.0, 2.0), 's': (6.0, 5.0)}).n_hypotheses == 1


@pytest.mark.parametrize('dimension', [2, 3])
def test_the_one_anchor_off_the_line_is_found_among_many(dimension):
    """In space one is off in each direction. Anchors that may be anywhere near tell no side."""
    anchors = {f'w{k}': (0.5 * k, 0.3 * (k == 21), 0.3 * (k == 22)) for k in range(28)}
    anchors = {name: place[:dimension] for name, place in anchors.items()}
    places = {'r': (10.0, -4.0, -3.0)[:dimension]}
    for bound_m in (0.0, 0.01):
        estimate = answer(anchors, places, bound_m=bound_m, dimension=dimension)
        assert estimate.n_hypotheses == n_holding(estimate, places) == 1
    assert answer(anchors, places, bound_m=0.4, dimension=dimension).n_hypotheses == 2


TRUTH = {'r0': (3.0, 2.0), 'r1': (6.5, 5.0)}
MAP = {f'a{k}': (1.7 * (k % 4), 2.9 * (k // 4) + 0.3 * (k % 3)) for k in range(12)}
SEEN = ('a1', 'a6', 'a9')


@pytest.mark.parametrize('bound_m', [0.0, 0.02])
def test_idle_anchors_change_no_answer_and_keep_their_places(bound_m):
    estimate = answer(MAP, TRUTH, seen=SEEN, bound_m=bound_m)
    alone = answer({name: MAP[name] for name in SEEN}, TRUTH, bound_m=bound_m)
    assert estimate.verdict is alone.verdict is Verdict.COVERED
    (placement,), (other,) = estimate.placements, alone.placements
    assert placement.enclosure_m == pytest.approx(other.enclosure_m, abs=1e-9)
    assert placement.proved and other.proved
    assert holds(estimate, [*TRUTH.values()])
    landmarks = np.array([MAP[name] for name in estimate.landmarks])
    assert placement.landmarks_m == pytest.approx(landmarks, abs=bound_m + 1e-9)
    off = np.abs(placement.landmark_enclosure_m - landmarks[:, None])
    assert np.all(off <= bound_m + 1e-9)
