# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What arrives is checked, counted by reason, aged, and forgotten when stale or stuck."""

import math

import numpy as np
import pytest
from sensing import add_odometry, new_localizer

from dg_localization.fleet import LinkKey, LinkKind, RejectionReason

NOW_S = 100.0
NOW = (NOW_S, NOW_S)
UPRIGHT = [0.0, 0.0, 0.0, 1.0]


class Torn:
    """An object that raises as soon as it is read."""

    def __iter__(self):
        raise RuntimeError('torn cable')

    def __repr__(self):
        # Processes that share the tests have to name them alike.
        return 'Torn()'


@pytest.fixture
def localizer():
    return new_localizer(
        'abc',
        max_age_s=1.0,
        max_future_s=0.1,
        max_speed_m_s=0.5,
        robot_max_speed_m_s={'c': 0.0},
        range_error=(0.0, 0.0, 0.0, 0.0),
    )


def link(localizer, now_s=NOW_S, row=0):
    return localizer.snapshot(now_s).links[row]


STAMPS = [
    (0.0, RejectionReason.ZERO_STAMP),
    (math.nan, RejectionReason.INVALID_STAMP),
    (-math.inf, RejectionReason.INVALID_STAMP),
    (98.9, RejectionReason.TOO_OLD),
    (-5.0, RejectionReason.TOO_OLD),
    (100.2, RejectionReason.FUTURE),
]


@pytest.mark.parametrize(('stamp_s', 'reason'), STAMPS)
def test_wrong_stamps_are_rejected_for_every_kind(localizer, stamp_s, reason):
    rejections = [
        localizer.add_range('a', 'b', 1.0, stamp_s, NOW_S),
        localizer.add_bearing('a', 'b', [1.0, 0.0, 0.0], stamp_s, NOW_S),
        localizer.add_odometry('a', [0.0, 0.0, 0.0], UPRIGHT, stamp_s, NOW_S),
    ]
    for rejection in rejections:
        assert rejection.reason is reason
        assert str(stamp_s) in rejection.text or reason is RejectionReason.ZERO_STAMP
    for state in localizer.input_states(NOW_S):
        assert state.accepted == 0
        assert state.rejected == {reason: 1}
        assert state.last_reason_text
        assert not state.in_use
        assert state.age_s == math.inf
    assert localizer.snapshot(NOW_S).keys == ()


@pytest.mark.parametrize(('observer', 'target'), [('a', 'a/cam'), ('a/cam', 'a/left')])
def test_points_of_one_robot_measure_nothing_of_each_other(observer, target):
    mounts = {'a': {'cam': (0.3, 0.2), 'left': (0.3, -0.2)}}
    localizer = new_localizer(('a', 'b', 'c'), mounts=mounts)
    for other, range_m in (('b', 3.0), ('c', 4.0)):
        localizer.add_range('a', other, range_m, NOW_S, NOW_S)
    of_itself = [1.0, 0.0, 0.0]
    rejections = [
        localizer.add_range(observer, target, 0.4, NOW_S, NOW_S),
        localizer.add_bearing(target, observer, of_itself, NOW_S, NOW_S),
        *localizer.add_peers(observer, [(target, of_itself)], NOW_S, NOW_S),
    ]
    assert [rejection.reason for rejection in rejections] == [RejectionReason.SAME_ROBOT] * 3
    for rejection in rejections:
        assert repr(observer) in rejection.text and repr(target) in rejection.text
    assert localizer.step(NOW_S).placements


NO_NUMBERS = [
    *('far', None, True, 10**5000, 1j, [1.0, [2.0]], [3.0], object()),
    # NumPy would read a number in these, and leave the rest out.
    *(np.array([3.0, 1j, 0.0]), ['3.0', '1.0', '0.0'], np.ma.masked),
]
INVALID = {
    RejectionReason.INVALID_RANGE: lambda one, value: one.add_range('a', 'b', value, *NOW),
    RejectionReason.INVALID_STAMP: lambda one, value: one.add_range('a', 'b', 3.0, value, NOW_S),
    RejectionReason.INVALID_RAY: lambda one, value: one.add_bearing('a', 'b', value, *NOW),
    RejectionReason.INVALID_ODOMETRY: lambda one, value: one.add_odometry(
        'a', [0.0] * 3, value, *NOW
    ),
}
OPTIONAL = {
    RejectionReason.INVALID_RANGE: {'max_range_m'},
    RejectionReason.INVALID_VARIANCE: {'variance_m2'},
}


@pytest.mark.parametrize('value', NO_NUMBERS, ids=lambda value: type(value).__name__)
def test_what_is_no_reading_is_rejected_by_name_and_never_raises(localizer, value):
    found = [add(localizer, value) for add in INVALID.values()]
    assert [rejection.reason for rejection in found] == [*INVALID]
    assert all(len(rejection.text) < 400 for rejection in found)
    for reason, (name,) in OPTIONAL.items() if value is not None else ():
        rejection = localizer.add_range('a', 'b', 3.0, *NOW, **{name: value})
        assert rejection.reason is reason and name.rpartition('_')[0] in rejection.text
    (rejection,) = localizer.add_peers('a', [('b', value), ('c', 3.0)], *NOW)
    assert rejection.reason in (RejectionReason.INVALID_RANGE, RejectionReason.INVALID_RAY)
    assert localizer.step(NOW_S).placements


def torn():
    yield 'c', 3.0
    raise RuntimeError('torn cable')


NO_PAIRS = [None, 'bc', {'b': 3.0, 'c': 3.0}, ('b',), ('b', 3.0, 4.0), Torn()]
PEERS = [([row, ('c', 3.0)], f'{row!r}|a target, and its distance') for row in NO_PAIRS]


@pytest.mark.parametrize(('rows', 'texts'), [*PEERS, (torn(), 'torn cable|pairs of a target')])
def test_a_peer_that_is_no_pair_is_rejected_and_the_others_are_not(localizer, rows, texts):
    (rejection,) = localizer.add_peers('a', rows, NOW_S, NOW_S)
    assert rejection.reason is RejectionReason.INVALID_PEER
    assert all(text in rejection.text for text in texts.split('|'))
    (together,) = [s for s in localizer.input_states(NOW_S) if s.key.kind is LinkKind.PEERS]
    assert together.rejected == {RejectionReason.INVALID_PEER: 1}
    assert together.accepted == 1 and together.in_use
    assert [key.target for key in localizer.snapshot(NOW_S).keys] == ['c']


def test_a_range_widens_with_the_speeds_of_both_ends(localizer):
    localizer.add_range('a', 'b', 3.0, NOW_S - 0.4, NOW_S)
    localizer.add_range('a', 'c', 3.0, NOW_S - 0.4, NOW_S)
    both, one = link(localizer), link(localizer, row=1)
    assert (both.lower_m, both.upper_m) == pytest.approx((2.6, 3.4))
    assert (one.lower_m, one.upper_m) == pytest.approx((2.8, 3.2))
    assert both.lower_m < 3.0 - 0.4
    assert both.age_s == pytest.approx(0.4)


@pytest.mark.parametrize(
    ('period_s', 'settings'),
    [(0.01, {'max_future_s': 0.0, 'max_repeats': 4}), (0.005, {'max_future_s': 0.02})],
)
def test_readings_after_the_time_of_the_answer_do_not_push_out_those_before(period_s, settings):
    """Odometry comes late, and the answer is for its time."""
    localizer = new_localizer(('a', 'b'), **settings)
    now_s = NOW_S
    for step in range(100):
        now_s = NOW_S + step * period_s
        localizer.add_range('a', 'b', 3.0, now_s, now_s)
        if step % 10 == 0:
            localizer.add_odometry('a', [0.0, 0.0, 0.0], UPRIGHT, now_s - 0.06, now_s)
        if step > 20:
            (found,) = localizer.snapshot(localizer.answer_time(now_s)).links
            assert not found.stale
    assert len(localizer.young_readings(now_s)[found.key]) <= localizer.config.max_repeats


def test_a_link_goes_stale_and_comes_back(localizer):
    localizer.add_range('a', 'b', 3.0, NOW_S, NOW_S)
    assert not link(localizer, NOW_S + 1.0).stale
    late = link(localizer, NOW_S + 1.001)
    assert late.stale
    assert (late.lower_m, late.upper_m) == (0.0, math.inf)
    assert not localizer.input_states(NOW_S + 1.001)[0].in_use
    localizer.add_range('a', 'b', 3.0, NOW_S + 2.0, NOW_S + 2.0)
    assert not link(localizer, NOW_S + 2.0).stale


def drive(localizer, robot, way):
    for tick, x in enumerate(way):
        stamp_s = NOW_S - 0.4 + 0.1 * tick
        assert localizer.add_odometry(robot, [x, 0.0, 0.0], UPRIGHT, stamp_s, NOW_S) is None


def test_odometry_says_how_far_a_robot_really_moved(localizer):
    drive(localizer, 'a', [0.0, 0.01, 0.02, 0.03, 0.04])
    localizer.add_range('a', 'c', 3.0, NOW_S - 0.4, NOW_S)
    error = localizer.config.odometry_error
    # The constant turns with the track.
    constant_m = error.constant_m * (1.0 + 0.04 * error.rotation_per_m)
    moved_m = 0.04 * (1.0 + error.translation_per_m) + constant_m
    assert link(localizer).upper_m == pytest.approx(3.0 + moved_m)


def test_odometry_that_starts_anew_is_said_to_for_as_long_as_its_age_counts(localizer):
    def restart(now_s):
        (state,) = localizer.input_states(now_s)
        return state.restart

    # In centimeters: the robot goes 0.02 m in 0.1 s.
    for tick in range(3):
        stamp_s = NOW_S + 0.1 * tick
        localizer.add_odometry('a', (2.0 * tick, 0.0, 0.0), UPRIGHT, stamp_s, stamp_s, 'odom')
        assert bool(restart(stamp_s)) == (tick > 0)
    assert restart(stamp_s).startswith('started anew: 2.000 m and 0.000 rad in 0.100 s are')
    assert 'max_speed 0.5 m/s' in restart(stamp_s)
    localizer.add_odometry('a', (4.0, 0.0, 0.0), UPRIGHT, stamp_s + 1.0, stamp_s + 1.0, 'odom')
    assert restart(stamp_s + 1.0) and not restart(stamp_s + 1.1)
    stamp_s += 2.0
    localizer.add_odometry('a', (4.0, 0.0, 0.0), UPRIGHT, stamp_s, stamp_s, 'base')
    assert restart(stamp_s) == "started anew: frame 'odom' has become 'base'"


def test_odometry_whose_squares_would_overflow_is_rejected(localizer):
    rejection = localizer.add_odometry('a', [0.0, -2e9, 0.0], UPRIGHT, *NOW)
    assert rejection.reason is RejectionReason.INVALID_ODOMETRY and '1e+09 m' in rejection.text


def test_arrays_of_the_caller_may_be_used_again(localizer):
    position, orientation, ray = np.zeros(3), np.array(UPRIGHT), np.array([[1.0, 0.0, 0.0]])
    for row in range(3):
        stamp_s = NOW_S - 0.1 * (2 - row)
        position[0] = 0.01 * row
        assert localizer.add_odometry('a', position, orientation, stamp_s, NOW_S) is None
        assert localizer.add_bearing('a', 'b', ray, stamp_s, NOW_S) is None
    position[:], orientation[:], ray[:] = 9.0, 9.0, 9.0
    snapshot = localizer.snapshot(NOW_S)
    track = snapshot.motion.odometry['a']
    assert [reading.position_m[0] for reading in track] == [0.0, 0.01, 0.02]
    assert all((reading.rotation == np.eye(3)).all() for reading in track)
    assert snapshot.rays[0].direction.tolist() == [1.0, 0.0, 0.0]


def test_what_an_estimate_has_proved_is_read_only(localizer):
    localizer.add_range('a', 'b', 3.0, NOW_S, NOW_S)
    (placement, *_) = localizer.step(NOW_S).placements
    for name in ('positions_m', 'enclosure_m', 'orientations_xyzw', 'lower_m', 'upper_m'):
        with pytest.raises(ValueError, match='read-only'):
            getattr(placement, name)[:] = 0.0


def test_odometry_must_be_in_order(localizer):
    drive(localizer, 'a', [0.0, 0.01])
    rejection = localizer.add_odometry('a', [0.0, 0.0, 0.0], UPRIGHT, NOW_S - 0.4, NOW_S)
    assert rejection.reason is RejectionReason.TOO_OLD
    assert 'not newer' in rejection.text


def test_what_is_later_than_the_answer_is_not_called_old():
    localizer = new_localizer(('a', 'b'), max_future_s=0.05)
    localizer.add_odometry('a', [0.0, 0.0, 0.0], UPRIGHT, NOW_S, NOW_S)
    localizer.add_range('a', 'b', 3.0, NOW_S + 0.12, NOW_S + 0.14)
    estimate = localizer.step(localizer.answer_time(NOW_S + 0.14))
    assert estimate.reason.startswith('all measurements are later than the answer')


START_S = 100.0


def watched(value_of, motion, count=30, **settings):
    """Return a localizer, and what it says of an input after some readings of it."""
    localizer = new_localizer(('a', 'b'), stuck_readings=10, **settings)
    for step in range(count):
        now_s = START_S + 0.1 * step
        for robot, (x_m, yaw_rad) in motion(step).items():
            add_odometry(localizer, robot, (x_m, 0.0), now_s, yaw_rad)
        value = value_of(step)
        if isinstance(value, float):
            localizer.add_range('a', 'b', value, now_s, now_s)
        else:
            localizer.add_bearing('a', 'b', value, now_s, now_s)
    kind = LinkKind.RANGE if isinstance(value, float) else LinkKind.BEARING
    states = {state.key: state for state in localizer.input_states(now_s)}
    return localizer, states[LinkKey(kind, 'a', 'b')]


def driving(step):
    return {'a': (0.0, 0.0), 'b': (0.1 * step, 0.0)}


def turning(step):
    return {'a': (0.0, 0.1 * step), 'b': (0.0, 0.0)}


def parked(step):
    return {'a': (0.0, 0.0), 'b': (0.0, 0.0)}


def unknown(step):
    return {}


def test_the_sensor_the_value_and_the_time_are_named():
    _, state = watched(lambda step: 3.0 + 0.01 * step if step < 5 else 3.217, driving)
    assert state.stuck == (
        'stuck: 25 readings in a row are 3.217 m, since 100.500 s, while b moved by 0.5 m'
    )
    assert state.accepted == 30


@pytest.mark.parametrize(
    ('value_of', 'motion', 'count', 'stuck'),
    [
        (lambda step: 3.0, parked, 400, False),
        (lambda step: 3.0, driving, 9, False),
        (lambda step: 3.0 + 1e-15 * (step % 2), driving, 30, False),
        (lambda step: math.inf, driving, 30, False),
        (lambda step: 3.0, unknown, 99, False),
        (lambda step: 3.0, unknown, 100, True),
        (lambda step: 3.0, turning, 30, False),
        (lambda step: [1.0, 0.5, 0.0], turning, 30, True),
        (lambda step: [1.0, 0.5, 0.0], parked, 30, False),
        (lambda step: [1.0, 0.1 * step, 0.0], turning, 30, False),
    ],
)
def test_what_is_stuck(value_of, motion, count, stuck):
    _, state = watched(value_of, motion, count)
    assert bool(state.stuck) == stuck


def test_stuck_readings_are_dropped_only_if_wanted():
    _, state = watched(lambda step: 3.0, driving, 30, drop_stuck=True)
    assert 0 < state.rejected[RejectionReason.STUCK] < 30
    assert 'stuck' in state.last_reason_text
    _, state = watched(lambda step: 3.0, driving, 30)
    assert not state.rejected


def test_odometry_that_starts_anew_is_no_motion():
    def jumping(step):
        return {'a': (0.0, 0.0), 'b': (0.0 if step < 15 else 100.0, 0.0)}

    _, state = watched(lambda step: 3.0, jumping, max_speed_m_s=1.0)
    assert state.stuck == ''

    def moving_after(step):
        return parked(step) if step < 5 else {'b': (100.0 + 0.1 * step, 0.0)}

    _, state = watched(lambda step: 3.0, moving_after, max_speed_m_s=1.0)
    assert state.stuck.endswith('while b moved by 0.5 m')


@pytest.mark.parametrize(
    ('value_of', 'motion', 'frozen'),
    [
        (lambda step: 3.0 + 0.1 * step, parked, True),
        (lambda step: 3.0 + 0.1 * step, driving, False),
        (lambda step: 3.0 + 0.002 * step, parked, False),
        (lambda step: 5.0 if step % 5 == 0 else 3.0, parked, False),
        (lambda step: 3.0 + 0.1 * step, unknown, False),
    ],
)
def test_odometry_that_never_changes_while_ranges_show_motion_is_told(value_of, motion, frozen):
    localizer, _ = watched(value_of, motion)
    now_s = START_S + 2.9
    states = {state.key: state.warning for state in localizer.input_states(now_s)}
    of_b = states.get(LinkKey(LinkKind.ODOMETRY, 'b', ''), '')
    assert of_b.startswith('the pose has not changed since 100.000 s, while range a->b') == frozen
    told = [text for text in localizer.snapshot(now_s).warnings if 'is frozen' in text]
    assert len(told) == (2 if frozen else 0)
