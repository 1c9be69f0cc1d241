"""What rays say about distances and handedness: sampled truths are never excluded."""

import math

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from dg_localization.fleet import Anchor, FleetConfig, Localizer, RangeErrorModel
from dg_localization.fleet.cartesian import (
    contract_boxes,
    tighten_adjacent_side,
    tighten_opposite_side,
)
from dg_localization.fleet.constraints import constrain
from dg_localization.fleet.frames import hang

NOW_S = 5.0
side = st.floats(0.0, 10.0)
share = st.floats(0.0, 1.0)


def interval(ends):
    return min(ends), max(ends)


def between(ends, part):
    low, high = interval(ends)
    return min(max(low + part * (high - low), low), high)


@settings(deadline=None)
@given(
    first=st.tuples(side, side),
    second=st.tuples(side, side),
    angle=st.tuples(st.floats(0.0, math.pi), st.floats(0.0, math.pi)),
    parts=st.tuples(share, share, share),
)
def test_the_law_of_cosines_excludes_no_triangle(first, second, angle, parts):
    lower, upper = np.zeros((3, 3)), np.full((3, 3), np.inf)
    np.fill_diagonal(upper, 0.0)
    for point, ends in ((1, first), (2, second)):
        low, high = interval(ends)
        lower[0, point] = lower[point, 0] = low * low
        upper[0, point] = upper[point, 0] = high * high
    low, high = interval(angle)
    tighten_opposite_side(lower, upper, 0, 1, 2, math.cos(high) - 1e-15, math.cos(low) + 1e-15)
    x, y = between(first, parts[0]), between(second, parts[1])
    opposite = x * x + y * y - 2.0 * x * y * math.cos(between(angle, parts[2]))
    rounding = 1e-14 * (x + y) ** 2 + 1e-300
    assert lower[1, 2] - rounding <= opposite <= upper[1, 2] + rounding


@settings(deadline=None)
@given(
    places=st.lists(st.tuples(side, side), min_size=3, max_size=3),
    slack=st.tuples(side, side, side, st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
)
def test_an_adjacent_side_excludes_no_triangle(places, slack):
    points = np.array(places)
    true = ((points[:, None] - points[None]) ** 2).sum(axis=-1)
    widths = np.array(
        [[0.0, slack[0], slack[1]], [slack[0], 0.0, slack[2]], [slack[1], slack[2], 0.0]]
    )
    lower, upper = np.maximum(true - widths, 0.0), true + widths
    edges = points[1:] - points[0]
    lengths = np.linalg.norm(edges, axis=1)
    if lengths.min() < 1e-3:
        return
    cosine = float(np.clip(edges[0] @ edges[1] / lengths.prod(), -1.0, 1.0))
    low, high = max(-1.0, cosine - slack[3] - 1e-12), min(1.0, cosine + slack[4] + 1e-12)
    tighten_adjacent_side(lower, upper, 0, 1, 2, low, high)
    assert lower[0, 1] - 1e-9 <= true[0, 1] <= upper[0, 1] + 1e-9


def test_an_adjacent_side_is_sharp_and_may_be_none():
    lower = np.array([[0.0, 0.0, 9.0], [0.0, 0.0, 25.0], [9.0, 25.0, 0.0]])
    upper = np.array([[0.0, 99.0, 9.0], [99.0, 0.0, 25.0], [9.0, 25.0, 0.0]])
    tighten_adjacent_side(lower, upper, 0, 1, 2, -1e-16, 1e-16)
    assert upper[0, 1] == pytest.approx(16.0)
    lower[0, 2] = upper[0, 2] = lower[2, 0] = upper[2, 0] = 36.0
    tighten_adjacent_side(lower, upper, 0, 1, 2, -1e-16, 1e-16)
    assert upper[0, 1] < lower[0, 1]


def test_the_law_of_cosines_is_sharp():
    lower = np.array([[0.0, 9.0, 16.0], [9.0, 0.0, 0.0], [16.0, 0.0, 0.0]])
    upper = np.array([[0.0, 9.0, 16.0], [9.0, 0.0, np.inf], [16.0, np.inf, 0.0]])
    tighten_opposite_side(lower, upper, 0, 1, 2, -1e-16, 1e-16)
    assert lower[1, 2] == pytest.approx(25.0)
    assert upper[1, 2] == pytest.approx(25.0)


def test_an_unbounded_side_still_gives_a_lower_bound():
    lower = np.array([[0.0, 9.0, 0.0], [9.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    upper = np.array([[0.0, 9.0, np.inf], [9.0, 0.0, np.inf], [np.inf, np.inf, 0.0]])
    tighten_opposite_side(lower, upper, 0, 1, 2, 0.49, 0.5)
    assert lower[1, 2] == pytest.approx(9.0 * 0.75)
    assert upper[1, 2] == np.inf


@settings(deadline=None)
@given(
    places=st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=2, max_size=5),
    slack=st.floats(0.0, 3.0),
    looseness=st.floats(0.0, 20.0),
)
def test_coordinate_boxes_keep_every_true_point(places, slack, looseness):
    points = np.array(places, dtype=float)
    squared = ((points[:, None] - points[None]) ** 2).sum(axis=-1)
    near, far = np.maximum(squared - slack, 0.0), squared + slack
    low, high = points - looseness, points + looseness
    low[0], high[0] = points[0], points[0]
    assert contract_boxes(low, high, near, far, 20)
    assert (low <= points).all()
    assert (points <= high).all()


def test_coordinate_boxes_without_a_point_are_empty():
    low, high = np.zeros((2, 2)), np.ones((2, 2))
    far = np.array([[0.0, 200.0], [200.0, 0.0]])
    assert not contract_boxes(low, high, np.array([[0.0, 100.0], [100.0, 0.0]]), far, 20)


def make(robots='abc', **settings):
    defaults = {
        'robots': tuple(robots),
        'max_speed_m_s': 0.0,
        'max_turn_rate_rad_s': 1.0,
        'range_error': RangeErrorModel(min_error_relative=0.0, max_error_relative=0.0),
        'bearing_half_width_rad': 0.1,
    }
    return Localizer(FleetConfig(**{**defaults, **settings}))


def ray(angle_rad):
    return [math.cos(angle_rad), math.sin(angle_rad), 0.0]


@pytest.mark.parametrize(
    ('second', 'signs'),
    [(0.5, [1]), (-0.5, [-1]), (0.19, []), (0.21, [1]), (3.0, []), (2.9, [1]), (-2.9, [-1])],
)
def test_a_chirality_needs_a_sign_that_is_certain(second, signs):
    localizer = make()
    localizer.add_bearing('a', 'b', ray(0.0), NOW_S, NOW_S)
    localizer.add_bearing('a', 'c', ray(second), NOW_S, NOW_S)
    constraints = constrain(localizer.snapshot(NOW_S))
    assert [chirality.sign for chirality in constraints.chiralities] == signs
    assert all(chirality.points == (0, 1, 2) for chirality in constraints.chiralities)


def test_rays_of_one_image_do_not_widen_against_each_other():
    localizer = make(max_age_s=5.0)
    localizer.add_bearing('a', 'b', ray(0.0), NOW_S - 4.0, NOW_S)
    localizer.add_bearing('a', 'c', ray(0.3), NOW_S - 4.0, NOW_S)
    assert len(constrain(localizer.snapshot(NOW_S)).chiralities) == 1
    localizer.add_bearing('a', 'c', ray(0.3), NOW_S, NOW_S)
    assert len(constrain(localizer.snapshot(NOW_S)).chiralities) == 0


def test_odometry_turns_a_ray_instead_of_widening_it():
    localizer = make(max_age_s=5.0)
    localizer.add_bearing('a', 'b', ray(0.0), NOW_S - 1.0, NOW_S)
    for tick in range(11):
        half = 0.05 * tick * 0.5
        pose = [0.0, 0.0, math.sin(half), math.cos(half)]
        localizer.add_odometry('a', [0.0, 0.0, 0.0], pose, NOW_S - 1.0 + 0.1 * tick, NOW_S)
    (seen,) = constrain(localizer.snapshot(NOW_S)).rays[0]
    assert math.atan2(seen.direction[1], seen.direction[0]) == pytest.approx(-0.5)
    assert seen.half_width_rad == pytest.approx(0.1 + 0.05 * 1.0)


def test_a_moving_target_swings_by_the_arcsine():
    localizer = make(max_speed_m_s=0.5, max_turn_rate_rad_s=0.0, max_age_s=5.0)
    localizer.add_bearing('a', 'b', ray(0.0), NOW_S - 1.0, NOW_S)
    assert constrain(localizer.snapshot(NOW_S)).rays[0][0].half_width_rad > math.pi
    localizer.add_range('b', 'a', 4.0, NOW_S, NOW_S)
    (seen,) = constrain(localizer.snapshot(NOW_S)).rays[0]
    assert seen.half_width_rad == pytest.approx(0.1 + math.asin(1.0 / 4.0))


def test_a_robot_that_is_only_seen_is_triangulated():
    localizer = make(bearing_half_width_rad=0.01)
    localizer.add_range('a', 'b', 4.0, NOW_S, NOW_S)
    for observer, target, angle in (
        ('a', 'b', 0.0),
        ('a', 'c', math.pi / 3),
        ('b', 'a', 0.0),
        ('b', 'c', -math.pi / 3),
    ):
        localizer.add_bearing(observer, target, ray(angle), NOW_S, NOW_S)
    constraints = constrain(localizer.snapshot(NOW_S))
    for observer in (0, 1):
        low, high = constraints.lower[observer, 2], constraints.upper[observer, 2]
        assert low < 16.0 < high < 20.0
        assert low > 13.0
    (placement,) = localizer.step(NOW_S).placements
    assert placement.positions_m[2] == pytest.approx([2.0, 2.0 * 3**0.5], abs=0.3)


def test_no_two_robots_are_nearer_than_their_size_but_anchors_may_be():
    localizer = make('ab', min_separation_m=0.5, anchors={'p': Anchor((0.0, 0.0))})
    lower = constrain(localizer.snapshot(NOW_S)).lower
    assert lower[0, 1] == pytest.approx(0.25)
    assert lower[0, 2] == 0.0


def test_dropped_links_leave_no_trace():
    localizer = make()
    localizer.add_range('a', 'b', 4.0, NOW_S, NOW_S)
    localizer.add_bearing('a', 'b', ray(0.0), NOW_S, NOW_S)
    localizer.add_bearing('a', 'c', ray(1.0), NOW_S, NOW_S)
    snapshot = localizer.snapshot(NOW_S)
    bare = constrain(snapshot, frozenset(snapshot.keys))
    assert np.isinf(bare.upper[~np.eye(3, dtype=bool)]).all()
    assert bare.chiralities == ()
    assert bare.rays == {}


def test_loose_points_are_those_that_hang_on_too_few():
    localizer = make('abcdef')
    pairs = ['ab', 'ac', 'bc', 'bd', 'de', 'af', 'bf']
    for first, second in pairs:
        localizer.add_range(first, second, 2.0, NOW_S, NOW_S)
    constraints = constrain(localizer.snapshot(NOW_S))
    component = constraints.component_of(0)
    assert component == (0, 1, 2, 3, 4, 5)
    assert constraints.loose_points(component, {0, 1}) == [4, 3]
    assert constraints.loose_points(component, {0, 1, 4}) == []


def test_a_loose_robot_is_on_its_circle():
    localizer = make('abcd', range_error=RangeErrorModel())
    for first, second in ('ab', 'ac', 'bc', 'cd'):
        localizer.add_range(first, second, 2.0, NOW_S, NOW_S)
    estimate = localizer.step(NOW_S)
    assert estimate.n_hypotheses == 2
    for placement in estimate.placements:
        assert placement.flexible
        assert placement.proved
        gap = placement.positions_m[3] - placement.positions_m[2]
        assert np.linalg.norm(gap) == pytest.approx(2.0, rel=0.03)
        assert np.isfinite(placement.enclosure_m).all()


@pytest.mark.parametrize('dimension', [2, 3])
def test_hanging_keeps_the_middle_distances(dimension):
    positions = np.eye(3)[:, :dimension] * 3.0
    hooks = [(3, 0, 4.0), (3, 1, 9.0)][: dimension - 1] + [(4, 3, 1.0)]
    lower, upper = np.zeros((5, 5)), np.full((5, 5), np.inf)
    for i, j, squared in hooks:
        lower[i, j] = lower[j, i] = upper[i, j] = upper[j, i] = squared
    hung = hang(positions, lower, upper)
    assert hung.shape == (5, dimension)
    for i, j, squared in hooks:
        assert ((hung[i] - hung[j]) ** 2).sum() == pytest.approx(squared)
