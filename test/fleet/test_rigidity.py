"""Fleets that are not rigid as a whole: their pieces, and what would join them."""

import math

import numpy as np
import pytest

from dg_localization import SolverOptions, Verdict
from dg_localization.fleet import Anchor, FleetConfig, Localizer, RangeErrorModel

NOW_S = 10.0
TWO_FOURS = {
    'r1': (0.0, 0.0),
    'r2': (5.0, 1.0),
    'r3': (1.0, 4.0),
    'r4': (6.0, 6.0),
    'r5': (10.0, 2.0),
    'r6': (9.0, 9.0),
    'r7': (4.0, 11.0),
}
FOURS = ('r1 r2 r3 r4', 'r4 r5 r6 r7')


def within(*bodies):
    """Return all pairs of some sets of points."""
    return [
        (first, second)
        for body in (body.split() for body in bodies)
        for i, first in enumerate(body)
        for second in body[i + 1 :]
    ]


def localizer_of(places, pairs, **settings):
    """Return a localizer that knows the distances of some pairs to 0.1 %."""
    defaults = {
        'robots': tuple(places),
        'max_speed_m_s': 0.0,
        'max_turn_rate_rad_s': 0.0,
        'range_error': RangeErrorModel(min_error_relative=-1e-3, max_error_relative=1e-3),
        'solver': SolverOptions(resolution=0.05, max_boxes=200),
    }
    localizer = Localizer(FleetConfig(**{**defaults, **settings}))
    for first, second in pairs:
        distance_m = math.dist(places[first], places[second])
        assert localizer.add_range(first, second, distance_m, NOW_S, NOW_S) is None
    return localizer


def turned(places, hinge, names, angle_rad, sign=1.0):
    """Return places with some points turned about another, or mirrored and turned."""
    center = np.array(places[hinge])
    rows = [
        [math.cos(angle_rad), -math.sin(angle_rad)],
        [math.sin(angle_rad), math.cos(angle_rad)],
    ]
    turn = np.array(rows)
    arms = {name: np.multiply(np.array(places[name]) - center, (1.0, sign)) for name in names}
    return places | {name: tuple(center + turn @ arm) for name, arm in arms.items()}


def in_frame(places, origin, toward):
    """Return the rows of places with the origin at a point and x to another."""
    edge = np.subtract(places[toward], places[origin])
    x, y = edge / np.linalg.norm(edge)
    return (np.array(list(places.values())) - places[origin]) @ np.array([[x, -y], [y, x]])


def is_in(placement, positions_m, slack_m=1e-9):
    low_m, high_m = placement.enclosure_m[:, 0], placement.enclosure_m[:, 1]
    return ((low_m - slack_m <= positions_m) & (positions_m <= high_m + slack_m)).all()


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_every_turn_of_a_hinge_is_enclosed(sign):
    estimate = localizer_of(TWO_FOURS, within(*FOURS)).step(NOW_S)
    assert estimate.verdict is Verdict.COVERED
    # The first four and its mirror image; the second turns through its own.
    assert estimate.n_hypotheses == len(estimate.placements) == 2
    assert all(placement.flexible for placement in estimate.placements)
    for angle_rad in np.linspace(0.0, 6.0, 13):
        places = turned(TWO_FOURS, 'r4', ('r5', 'r6', 'r7'), angle_rad, sign)
        positions_m = in_frame(places, 'r1', 'r2')
        assert any(is_in(placement, positions_m) for placement in estimate.placements)


def test_what_turns_has_the_bounding_box_of_its_ring():
    pairs = [*within('r1 r2 r3'), ('r3', 'r4')]
    places = {name: TWO_FOURS[name] for name in ('r1', 'r2', 'r3', 'r4')}
    estimate = localizer_of(places, pairs).step(NOW_S)
    arm_m = math.dist(places['r3'], places['r4'])
    assert len(estimate.placements) == 2
    for placement in estimate.placements:
        width_m = np.ptp(placement.enclosure_m[3], axis=0)
        assert (2.0 * arm_m <= width_m).all() and (width_m < 2.0 * arm_m + 0.1).all()
        assert is_in(placement, placement.positions_m)


def test_a_chain_of_robots_is_one_hypothesis():
    """Nothing in it is rigid, so that it turns into its own mirror image."""
    places = {name: TWO_FOURS[name] for name in ('r1', 'r2', 'r3')}
    (placement,) = localizer_of(places, [('r1', 'r2'), ('r2', 'r3')]).step(NOW_S).placements
    assert placement.flexible
    for sign in (1.0, -1.0):
        assert is_in(placement, in_frame(places, 'r1', 'r2') * [1.0, sign])


def strip(length):
    """Return the corners of a strip of fours, two by two, and the pairs within the fours."""
    rng = np.random.default_rng(1)
    names = [f's{k}' for k in range(2 * length + 2)]
    places = {
        name: (4.0 * (k // 2) + rng.uniform(-0.5, 0.5), 3.0 * (k % 2) + rng.uniform(-0.5, 0.5))
        for k, name in enumerate(names)
    }
    fours = [' '.join(names[2 * k : 2 * k + 4]) for k in range(length)]
    return places, sorted(set(within(*fours)))


@pytest.mark.parametrize('length', [2, 3, 20])
def test_hypotheses_are_counted_without_being_listed(length):
    places, pairs = strip(length)
    estimate = localizer_of(places, pairs, max_hypotheses=4).step(NOW_S)
    assert estimate.verdict is Verdict.COVERED
    assert estimate.n_hypotheses == 2**length
    assert len(estimate.placements) == 4
    if length == 2:
        truth_m = in_frame(places, 's0', 's1')
        assert any(is_in(placement, truth_m) for placement in estimate.placements)


def test_anchors_leave_the_folds_of_the_rest():
    places, pairs = strip(3)
    anchors = {name: Anchor(places[name]) for name in ('s0', 's1', 's2')}
    estimate = localizer_of(places, pairs, anchors=anchors).step(NOW_S)
    assert estimate.n_hypotheses == len(estimate.placements) == 4
    truth_m = np.array(list(places.values()))
    assert any(is_in(placement, truth_m) for placement in estimate.placements)
