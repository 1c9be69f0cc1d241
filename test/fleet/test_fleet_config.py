# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Wrong settings are named with their values; error models turn readings into bounds."""

import copy
from fractions import Fraction
from itertools import product
import math
import pickle

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from dg_localization.fleet import (
    Anchor,
    ConfigError,
    ElevationErrorModel,
    FleetConfig,
    Localizer,
    Mount,
    OdometryErrorModel,
    RangeErrorModel,
    RejectionReason,
    SensorBounds,
    error_models,
)
from dg_localization.fleet.error_models import (
    distance_bounds_m,
    likeliest_distance_m,
    projected_half_width_rad,
)
from dg_localization.fleet.vocabulary import RangeMessage, RefusedError

WRONG = [
    ({'robots': ()}, 'robots', 'at least one'),
    (
        {'mounts': {'a': {'left': (0.1, 0.0)}}, 'anchors': {'a/left': Anchor((0.0, 0.0))}},
        "'a/left' is not allowed twice",
        'different names',
    ),
    ({'robots': ('a', '')}, "robots: ''", 'not be empty'),
    ({'reference_robot': 'z'}, "reference_robot: 'z'", "['a', 'b']"),
    ({'dimension': 4}, 'dimension: 4', '2 or 3'),
    ({'max_age_s': -1.0}, 'max_age_s: -1.0', '>= 0'),
    ({'robot_max_speed_m_s': {'a': -1.0}}, 'robot_max_speed_m_s[a]: -1.0', '>= 0'),
    ({'robot_odometry_error': {'z': OdometryErrorModel()}}, "'z'", "['a', 'b']"),
    ({'max_turn_rate_rad_s': 'fast'}, "max_turn_rate_rad_s: 'fast'", 'number'),
    ({'bearing_half_width_rad': 4.0}, 'bearing_half_width_rad: 4.0', '<= 3.14159'),
    ({'max_repeats': 0}, 'max_repeats: 0', '>= 1'),
    ({'max_hypotheses': 2.5}, 'max_hypotheses: 2.5', 'integer'),
    ({'anchors': {'c': Anchor((1.0, 2.0, 3.0))}}, 'anchors[c]', '2 coordinates'),
    ({'robots': 'robot'}, "robots: 'robot'", 'a sequence of names'),
    ({'robots': (1, 2)}, 'robots: 1', 'must be a string'),
    ({'solver': {'resolution': 0.1}}, "solver: {'resolution': 0.1}", 'must be a SolverOptions'),
    ({'drop_stuck': 'no'}, "drop_stuck: 'no'", 'must be a bool'),
    ({'anchors': {'c': (1.0, 2.0)}}, 'anchors[c]: (1.0, 2.0)', 'must be an Anchor'),
    ({'mounts': {'a': (0.1, 0.2)}}, 'mounts[a]: (0.1, 0.2)', 'must be a Mapping'),
    ({'elevations_m': {'a': 0.4}}, 'elevations_m[a]: 0.4', 'a sequence of numbers'),
    ({'max_speed_m_s': 2**53 + 1}, 'max_speed_m_s: 9007199254740993', 'finite'),
    ({'mounts': {'a': {'l/r': (0.0, 0.0)}}}, "mounts[a]: 'l/r'", 'without a slash'),
    ({'mounts': {'a': {'left': (0.0, 0.0, 0.0)}}}, 'mounts[a][left].position_m', '2 coordinates'),
    ({'elevations_m': {'a': (1.0, 0.0)}}, 'elevations_m[a]: (1.0, 0.0)', 'the least'),
    ({'elevations_m': {'a': (0.0, 1.0)}, 'dimension': 3}, "elevations_m: 'a'", 'none in space'),
    ({'max_age_s': np.longdouble(0.1) + np.longdouble(1e-19)}, 'max_age_s: ', 'finite'),
]


@pytest.mark.parametrize(('wrong', 'what', 'wanted'), WRONG)
def test_a_wrong_setting_is_refused_by_name(wrong, what, wanted):
    with pytest.raises(ConfigError) as refusal:
        FleetConfig(**{'robots': ('a', 'b'), **wrong})
    assert what in str(refusal.value)
    assert wanted in str(refusal.value)


@pytest.mark.parametrize(
    ('make', 'what'),
    [
        (lambda: RangeErrorModel(min_error_m=1.0), 'range.min_error_m: 1.0'),
        (lambda: RangeErrorModel(min_error_relative=0.5), 'range.min_error_relative: 0.5'),
        (lambda: RangeErrorModel(max_error_relative=1.0), 'range.max_error_relative: 1.0'),
        (lambda: RangeErrorModel(max_error_m=math.inf), 'range.max_error_m: inf'),
        (lambda: ElevationErrorModel(0.1, -0.1), 'elevation.min_error_m: 0.1'),
        (lambda: SensorBounds(RangeErrorModel(), 4.0), 'bearing_half_width_rad: 4.0'),
        (lambda: OdometryErrorModel(translation_scale=101.0), 'translation_scale: 101.0'),
        (lambda: OdometryErrorModel(rotation_per_m=-0.1), 'rotation_per_m: -0.1'),
        (lambda: OdometryErrorModel(tilt_rad=math.nan), 'tilt_rad: nan'),
        (lambda: Anchor((0.0, 0.0), -1.0), 'anchor.bound_m: -1.0'),
        (lambda: Mount((0.0, 0.0), -1.0), 'mount.bound_m: -1.0'),
        (lambda: Mount((0.0, 0.0), 0.0, (1.0, 1.0, 0.0, 0.0)), 'a unit quaternion'),
        (lambda: SensorBounds(bearing_half_width_rad=-1.0), 'bearing_half_width_rad: -1.0'),
        # What is of another type.
        (lambda: Anchor(1.0), 'anchor.coordinates_m: 1.0 .* a sequence of numbers'),
        (lambda: Mount((0.0, 0.0), 0.0, 1.57), 'mount.rotation_xyzw: 1.57 .* a sequence'),
        (lambda: SensorBounds(0.1), 'range_error: 0.1 .* RangeErrorModel'),
        (lambda: RangeErrorModel(beyond_max_is_far='no'), "beyond_max_is_far: 'no' .* a bool"),
        (lambda: Localizer(['a', 'b']), r"config: \['a', 'b'\] .* a FleetConfig"),
    ],
)
def test_a_wrong_model_is_refused_by_name(make, what):
    with pytest.raises(ConfigError, match=what):
        make()


def test_numbers_of_numpy_are_those_of_python():
    one, two = np.int64(1), np.float32(2.0)
    assert Anchor(np.array([1, 2]), one) == Anchor((1.0, 2.0), 1.0)
    assert Mount(np.array([1, 2], np.float32), one) == Mount((1.0, 2.0), 1.0)
    assert RangeErrorModel(-one, two) == RangeErrorModel(-1.0, 2.0)
    assert OdometryErrorModel(one, tilt_rad=two) == OdometryErrorModel(1.0, tilt_rad=2.0)
    assert ElevationErrorModel(-one, two) == ElevationErrorModel(-1.0, 2.0)
    assert SensorBounds(RangeErrorModel(), one) == SensorBounds(RangeErrorModel(), 1.0)
    config = FleetConfig(np.array(['a', 'b']), dimension=np.int8(2), max_age_s=two)
    kept = (config.dimension, config.max_age_s, *Anchor(np.array([1, 2]), one).coordinates_m)
    assert kept == (2, 2.0, 1.0, 2.0)
    # In the arithmetic of single precision, bounds would not be bounds.
    assert {type(number) for number in kept} == {int, float}


@pytest.mark.parametrize('far_m', [1.1e9, math.nan])
def test_coordinates_beyond_those_that_have_enough_digits_are_refused(far_m):
    for make, what in (
        (lambda: Anchor((0.0, far_m)), 'anchor.coordinates_m'),
        (lambda: Anchor((0.0, 0.0), abs(far_m)), 'anchor.bound_m'),
        (lambda: Mount((far_m, 0.0)), 'mount.position_m'),
        (lambda: Mount((0.0, 0.0), abs(far_m)), 'mount.bound_m'),
        (lambda: FleetConfig(('a',), elevations_m={'a': (far_m, far_m)}), r'elevations_m\[a\]'),
    ):
        with pytest.raises(ConfigError, match=rf'{what}: .* <= 1e\+09'):
            make()


@pytest.mark.parametrize('memory_s', [1e-310, 0.0009])
def test_a_memory_shorter_than_stamps_resolve_is_refused(memory_s):
    with pytest.raises(ConfigError, match='memory_s: .* 0, which remembers nothing, or >= 0.001'):
        FleetConfig(('a', 'b'), memory_s=memory_s)
    for allowed_s in (0.0, 0.001):
        localizer = Localizer(FleetConfig(('a', 'b'), memory_s=allowed_s))
        assert localizer.add_range('a', 'b', 3.0, 1.7e9, 1.7e9) is None
        assert localizer.step(1.7e9).placements


def test_settings_are_copies_of_what_the_caller_gave():
    place, sensors, elevation_m = np.array([0.3, 0.2]), {}, [0.4, 0.5]
    sensors['left'] = place
    config = FleetConfig(
        robots=('a',),
        mounts={'a': sensors},
        anchors={'c': Anchor(place)},
        elevations_m={'a': elevation_m},
    )
    place[:], elevation_m[0], sensors['right'] = 9.0, -9.0, (1.0, 0.0)
    assert config.mounts == {'a': {'left': (0.3, 0.2)}}
    assert config.sensors['a/left'].position_m == (0.3, 0.2)
    assert config.anchors['c'].coordinates_m == (0.3, 0.2)
    assert config.elevation_m('a') == (0.4, 0.5)
    with pytest.raises(TypeError):
        config.mounts['a']['right'] = (1.0, 0.0)


@pytest.mark.parametrize('copied', [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_settings_can_be_copied_and_pickled(copied):
    config = FleetConfig(
        ('a', 'b'),
        anchors={'x': Anchor((1.0, 2.0), 0.1)},
        mounts={'a': {'left': (0.1, 0.0), 'right': Mount((0.2, 0.0), 0.01)}},
        elevations_m={'a': (0.0, 1.0)},
        robot_max_speed_m_s={'b': 0.2},
    )
    other = copied(config)
    assert other == config and other.sensors == config.sensors
    with pytest.raises(TypeError):
        other.anchors['y'] = Anchor((0.0, 0.0))


@pytest.mark.parametrize('now_s', [math.nan, math.inf, None, '1'])
def test_a_time_now_that_is_none_is_named(now_s):
    localizer = Localizer(FleetConfig(('a', 'b')))
    rejection = localizer.add_range('a', 'b', 1.0, 1.0, now_s)
    assert 'the time now' in rejection.text and repr(now_s) in rejection.text
    with pytest.raises(ValueError, match='now_s: .* must be a finite number'):
        localizer.step(now_s)


def test_what_is_no_snapshot_is_named():
    with pytest.raises(TypeError, match='snapshot must be of type Snapshot, not float'):
        Localizer(FleetConfig(('a', 'b'))).estimate(1.0)


EXACT = RangeErrorModel(min_error_relative=0.0, max_error_relative=0.0)
UWB = RangeErrorModel(
    min_error_m=-0.1, max_error_m=1.3, min_error_relative=0.0, max_error_relative=0.02
)
FAR = RangeErrorModel(beyond_max_is_far=True)


def interpret_range(model, *values, variance_m2=None):
    """Return what a range says, or why it is refused."""
    message = RangeMessage(*values)._replace(variance_m2=variance_m2)
    try:
        return error_models.interpret_range(model, message)
    except RefusedError as refused:
        return refused.rejection


finite = st.floats(-2.0, 2.0)
fraction = st.floats(-0.9, 0.9)


@settings(derandomize=False)
@given(
    reading=st.floats(0.0, 1e3),
    absolute=st.tuples(finite, finite),
    relative=st.tuples(fraction, fraction),
    share=st.fractions(0, 1),
)
def test_every_true_distance_of_the_model_is_inside(reading, absolute, relative, share):
    model = RangeErrorModel(
        min_error_m=min(absolute),
        max_error_m=max(absolute),
        min_error_relative=min(relative),
        max_error_relative=max(relative),
    )
    lower, upper = distance_bounds_m(model, reading)
    exact = Fraction(reading)
    low = Fraction(min(absolute)) + Fraction(min(relative)) * exact
    high = Fraction(max(absolute)) + Fraction(max(relative)) * exact
    true = exact - (low + share * (high - low))
    if true >= 0:
        assert Fraction(lower) <= true <= Fraction(upper)


def test_bounds_that_grow_with_the_range_may_cross():
    model = RangeErrorModel(-1.0, 1.0, 0.07, 0.05)
    for reading, share in product((0.0, 10.0, 100.0, 200.0), (0.0, 0.5, 1.0)):
        ends = -1.0 + 0.07 * reading, 1.0 + 0.05 * reading
        distance = max(0.0, reading - (ends[0] + share * (ends[1] - ends[0])))
        low, high = distance_bounds_m(model, reading)
        assert low <= distance <= high
    with pytest.raises(ConfigError, match='min_error_relative'):
        RangeErrorModel(0.0, 0.0, 0.07, 0.05)


@pytest.mark.parametrize(
    ('bounds', 'expected_m', 'likeliest_m'),
    [((-0.2, 1.0), None, 4.8), ((0.2, 0.4), None, 4.75), ((-0.2, 1.0), 0.3, 4.7)],
)
def test_the_likeliest_error_is_near_zero_or_as_is_stated(bounds, expected_m, likeliest_m):
    model = RangeErrorModel(*bounds, 0.0, 0.0, expected_error_m=expected_m)
    assert likeliest_distance_m(model, 5.0) == pytest.approx(likeliest_m)
    assert math.isnan(likeliest_distance_m(model, math.inf))


def test_the_likeliest_error_may_grow_with_the_range():
    model = RangeErrorModel(-1.0, 1.0, 0.0, 0.1, expected_error_relative=0.0625)
    assert likeliest_distance_m(model, 32.0) == 30.0
    model = RangeErrorModel(-1.0, 1.0, 0.0, 0.1, 0.0, False, 0.5, 0.0625)
    assert likeliest_distance_m(model, 32.0) == 29.5


def test_variance_counts_with_a_sigma_factor():
    model = RangeErrorModel(sigma_factor=3.0, min_error_relative=0.0, max_error_relative=0.0)
    assert interpret_range(model, 5.0, variance_m2=0.01) == pytest.approx((4.7, 5.3))
    assert interpret_range(model, 5.0) == pytest.approx((5.0, 5.0))
    assert interpret_range(model, 5.0, variance_m2=math.inf) == (0.0, math.inf)
    assert interpret_range(EXACT, 5.0, variance_m2=math.nan) == pytest.approx((5.0, 5.0))
    for wrong in (math.nan, -1.0):
        rejection = interpret_range(model, 5.0, variance_m2=wrong)
        assert rejection.reason is RejectionReason.INVALID_VARIANCE
        assert str(wrong) in rejection.text


@pytest.mark.parametrize('limits', [(0.0, 0.0), (None, None), (math.nan, math.nan), (0.0, 100.0)])
def test_limits_that_are_not_given_exclude_nothing(limits):
    assert interpret_range(EXACT, 42.0, *limits) == pytest.approx((42.0, 42.0))


def test_beyond_the_maximum_is_a_lower_bound_only_where_stated():
    lower, upper = interpret_range(FAR, math.inf, 0.1, 8.0)
    assert lower == pytest.approx(8.0 * 0.97)
    assert upper == math.inf
    for model, limits in ((FAR, (0.0, 0.0)), (UWB, (0.1, 8.0))):
        assert interpret_range(model, math.inf, *limits).reason is RejectionReason.NOTHING_IN_RANGE


def test_closer_than_the_minimum_is_an_upper_bound():
    assert interpret_range(UWB, -math.inf, 0.3, 8.0) == pytest.approx((0.0, 0.4))


def test_the_projection_of_a_steep_ray_turns_more_than_the_ray():
    half_width_rad, rise = 0.05, math.atan2(3.0, 0.8)
    true = np.array([math.cos(rise), 0.0, math.sin(rise)])
    random = np.random.default_rng(0)
    largest_share = 0.0
    for _ in range(2000):
        across = np.cross(true, random.normal(size=3))
        across /= np.linalg.norm(across)
        seen = math.cos(half_width_rad) * true + math.sin(half_width_rad) * across
        bound_rad = projected_half_width_rad(seen, half_width_rad)
        off_rad = abs(math.atan2(seen[1], seen[0]))
        assert off_rad <= bound_rad
        largest_share = max(largest_share, off_rad / bound_rad)
    assert largest_share > 0.99
    assert projected_half_width_rad(np.array([0.01, 0.0, 1.0]), half_width_rad) == math.pi
