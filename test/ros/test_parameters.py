# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The parameter table: what its values become, and that any other is refused by name.

The environment variable DG_FUZZ_PARAMETERS says how many files are tried.
"""

from array import array
from contextlib import suppress
from dataclasses import replace
import math
import os
from random import Random
import re

from hostile_messages import FLOATS
from processes import REPOSITORY
import pytest
from rclpy.node import Node
import yaml

from dg_localization.fleet import ElevationErrorModel, LinkKey, LinkKind
from dg_localization.ros.interface.links import parse_link
from dg_localization.ros.interface.parameters.settings import (
    check_values,
    declare_settings,
    settings_from,
)
from dg_localization.ros.interface.parameters.spec import LIST_TEXTS, WrongParameterError
from dg_localization.ros.interface.parameters.table import OWN, TABLE, named_specs

CONFIG = REPOSITORY / 'config'
ROBOTS = {'robots': ['a', 'b', 'c']}
NAMED = {
    'anchors.names': ['p'],
    'anchors.p.position': [0.0, 0.0],
    'mounts.names': ['a/left'],
    'mounts.a.left.position': [0.3, 0.2],
}
LINK, WHEELS = '/t sensor_msgs/msg/Range a b', 'nav_msgs/msg/Odometry a'
BARO = '/baro geometry_msgs/msg/PointStamped a min_error=-1.0'


def settings(**given):
    return settings_from(check_values({**ROBOTS, **given}))


def bounds_of_links(found):
    return [link.bounds_within(found.fleet.sensor_bounds) for link in found.links]


SCALARS = [
    name
    for name, spec in TABLE.items()
    if spec.list_of is None and not name.endswith(('.topic', '.stamp_offset', 'dimension'))
]


@pytest.mark.parametrize('name', SCALARS)
def test_every_parameter_reaches_the_settings(name):
    anchor = {'anchors.names': ['p'], 'anchors.p.position': [0.0, 0.0]}
    others = {float: [-0.01, 0.015], int: [3], bool: [True, False], str: ['b']}
    found = []
    spec = TABLE[name]
    for value in [str(choice) for choice in spec.choices] or others[type(spec.default)]:
        with suppress(WrongParameterError):
            found.append(settings(**{**anchor, name: value}))
    assert any(one != settings(**anchor) for one in found)


def given_in(text):
    """Return the parameters of the text of a file, flattened as ROS does."""
    tree = yaml.safe_load(text)['/**']['ros__parameters']

    def flatten(prefix, node):
        for key, value in node.items():
            if isinstance(value, dict):
                yield from flatten(f'{prefix}{key}.', value)
            else:
                yield f'{prefix}{key}', None if value == [] else value

    return dict(flatten('', tree))


def same(value, other):
    """Return whether two values are equal, NaN too."""
    return value == other or (value != value and other != other)


@pytest.mark.parametrize('name, spec', [*TABLE.items(), *OWN.items()], ids=[*TABLE, *OWN])
def test_the_file_says_what_a_parameter_is_and_may_be(name, spec):
    facts = ', '.join(filter(None, [LIST_TEXTS.get(spec.list_of), spec.unit, spec.limits()]))
    said = f'{spec.description[0].upper()}{spec.description[1:]}{facts and f" ({facts})"}.'
    text = (CONFIG / 'localizer.yaml').read_text()
    room, _, own = name.rpartition('.')
    if name in OWN:
        comment = text.partition(f'# {name}: {spec.default}.')[2]
    else:
        _, _, after = text.partition(f'\n    {room}:\n' if room else 'ros__parameters:\n')
        before = re.split(rf'(?m)^ +{own}:', after, maxsplit=1)[0]
        comment = re.split(r'\n +\w+:', before)[-1]
    assert said in ' '.join(re.sub(r'\n *#', ' ', f'\n{comment}').split())


def test_commented_file_holds_every_parameter_with_its_default():
    given = given_in((CONFIG / 'localizer.yaml').read_text())
    assert len(given.pop('robots')) == 3
    defaults = {name: spec.default for name, spec in TABLE.items() if name != 'robots'}
    assert given.keys() == defaults.keys()
    for name, value in given.items():
        assert same(value or [] if value is None else value, defaults[name])


@pytest.mark.usefixtures('third_party_messages')
def test_links_in_the_comments_of_the_file_are_allowed():
    text = (CONFIG / 'localizer.yaml').read_text()
    examples = re.findall(r"# +- '(.*)'", text)
    assert len(examples) == 5
    assert [parse_link(example).topic for example in examples]


PAGES = (REPOSITORY / 'README.md', *(REPOSITORY / 'docs').glob('*.md'))
# Other files are for other programs; what has a module beside it is tried with that.
OTHERS = 'ekf_filter_node', "\n    adapter_modules: ['"
TEXTS = {path.name: path.read_text('utf-8') for path in CONFIG.glob('*.yaml')}
TEXTS |= {
    f'{page.name} {number}': text
    for page in PAGES
    for number, text in enumerate(re.findall(r'```yaml\n([^`]*)```', page.read_text('utf-8')))
    if 'ros__parameters' in text
}


@pytest.mark.usefixtures('third_party_messages')
@pytest.mark.parametrize('name', sorted(TEXTS))
def test_every_file_and_example_of_a_page_gives_settings(name):
    if not any(word in TEXTS[name] for word in OTHERS):
        assert settings_from(check_values(given_in(TEXTS[name]))).fleet.robots


@pytest.mark.parametrize(
    'name, value, wanted',
    [
        ('rate', 0.0, r"'rate': 0.0 is not .* a number >= 0.01 and <= 1000 \(Hz\)"),
        ('stamp_source', 'now', "'now' is not allowed, it must be 'header' or 'receive'"),
        ('autostart', 'yes', "'autostart': 'yes' is not allowed, it must be true or false"),
        ('robots', [1, 2], r"'robots': \[1, 2\] is not allowed, it must be a list of strings"),
        ('robots', None, 'robots: .* must name at least one'),
        ('robots', ['a', 'a'], "'a' is repeated"),
        ('robots', ['a b'], "'robots': 'a b' is not allowed, a name must begin with a letter"),
        ('reference_robot', 'z', "reference_robot: 'z' is not allowed, it must be one of"),
        ('max_speed', -1.0, "'max_speed': -1.0 is not allowed, it must be a finite number >= 0"),
        ('range.min_error', 1.0, 'range.min_error: 1.0 .* at most range.max_error, which'),
        ('range.topic', '/range', 'it must be empty, or hold {observer} and'),
        ('odometry.topic', '/{robot:>9}/odom', 'hold {robot} once and no other braces'),
        ('range.topic', '/a b/{observer}/{target}', "'/a b/name/name' is no topic name"),
        ('peers.topic', '{observer}/odom', "those of 'odometry.topic', .* topics of its own"),
        ('fixed_frame', '', "'fixed_frame': '' .* the name of a frame"),
        ('fixed_frame', '/map', "'/map' .* without blanks or a slash"),
        ('robots', [], "at least one, below '/\\*\\*:'"),
        ('links', ['/t sensor_msgs/Range a b'], "mean 'sensor_msgs/msg/Range'"),
        ('mounts.names', ['a/left', 'left'], "'left' is not allowed, it must read 'ROBOT/SENSOR'"),
        ('mounts.names', ['a/left', 'a/right'], r'mounts.a.right.position: \(\) is not allowed'),
        ('anchors.names', ['p', 'q', 'p'], "'anchors.names': 'p' is not allowed twice"),
        ('mounts.names', ['a/left', 'a/left'], "'mounts.names': 'a/left' is not allowed twice"),
        ('elevations.names', ['a', 'a'], "'elevations.names': 'a' is not allowed twice"),
        ('elevations.names', ['a'], r'elevations.a: \(\) is not allowed'),
        ('links', ['/t+ sensor_msgs/msg/Range a b'], r"'/t\+' is no topic name"),
        ('links', ['/t nav_msgs/msg/Odometry a b'], 'takes no target'),
        (
            'links',
            ['/t sensor_msgs/msg/PointCloud2 a x=1'],
            'half_width, difference_min_error, difference_max_error, roll, pitch, yaw',
        ),
        ('links', ['/t nav_msgs/msg/Odometry a yaw=1'], 'an odometry link allows stamp_offset'),
        ('links', ['/t'], "it must read 'TOPIC TYPE OBSERVER"),
        ('links', ['/t px4_msgs/msg/SensorUwb *'], 'install the ROS package px4_msgs'),
        ('links', ['/t gps_msgs/msg/Fix a b'], "type 'gps_msgs/msg/Fix' is no input; .*Range"),
        ('links', ['/t sensor_msgs/msg/Range a b max_eror=1'], "'max_eror' cannot"),
        ('links', ['/t sensor_msgs/msg/Range a b max_error=x'], 'must end in a finite number'),
        ('links', ['/t sensor_msgs/msg/Range a b max_error=-9'], "'/t' .*range.min_error: "),
        ('links', ['/t sensor_msgs/msg/Range a a'], "'a' cannot measure itself"),
        ('links', ['/t sensor_msgs/msg/Range * b'], 'needs the name of its observer'),
        ('elevation.min_error', 0.6, 'must be at most elevation.max_error'),
        ('elevation.topic', '{observer}/depth', "is not allowed without 'elevations.names'"),
        ('links', ['/t sensor_msgs/msg/PointCloud2 *'], 'do not say who measured; name the obs'),
        ('links', [f'{LINK} max_error=1.0 max_error=0.1'], "'max_error' is named twice"),
        ('links', [f'/s {WHEELS}', f'/t {WHEELS}'], "the odometry of 'a' is named 2 times"),
        ('links', [LINK, 't sensor_msgs/msg/Range b a'], "topic '/t' is named twice"),
        ('solver.resolutoin', 0.1, "'solver.resolutoin' is unknown; did you mean 'solver.resol"),
        ('robot_max_speed.z', 1.0, "'robot_max_speed.z' is unknown; name its point in 'robots'"),
        ('anchors.beacon.position', [0.0, 0.0], "name its point in 'anchors.names'"),
        ('anchors.p.position', [0.0, 1e155], r'numbers >= -1e\+09 and <= 1e\+09 \(m\)'),
        ('anchors.p.position', [1.0], r': \(1.0,\) is not allowed, it must have 2 coordinates'),
        ('anchors.p.bound', 1e10, r'<= 1e\+09 or negative \(m\)'),
        ('mounts.a.left.rotation', [1.0], r'must be roll, pitch and yaw \(rad\)'),
        ('mounts.a.left.bound', 1e200, r'>= 0 and <= 1e\+09 \(m\)'),
        ('memory.seconds', 1e-300, r'0 or >= 0.001 \(s\)'),
    ],
)
def test_wrong_value_is_refused_by_name_with_the_allowed_values(name, value, wanted):
    with pytest.raises(WrongParameterError, match=wanted):
        settings(**{**NAMED, name: value})


def test_a_robot_and_an_anchor_have_values_of_their_own_or_the_common_ones():
    fleet = settings(
        **{
            'max_speed': 0.5,
            'robot_max_speed.b': 2,
            'anchors.names': ['p', 'q'],
            'anchors.bound': 0.1,
            'anchors.p.position': [1, 2],
            'anchors.q.position': [3.0, 4.0],
            'anchors.q.bound': 0.5,
            'odometry.translation_per_m': 0.3,
            'odometry.tilt': 0.1,
            'robot_odometry.b.translation_scale': 0.9,
            'robot_odometry.b.constant_rotation': 0,
            'robot_odometry.b.tilt': math.nan,
            'robot_odometry.c.latency': -2.0,
        }
    ).fleet
    assert [fleet.speed_m_s(robot) for robot in 'abc'] == [0.5, 2.0, 0.5]
    assert [anchor.bound_m for anchor in fleet.anchors.values()] == [0.1, 0.5]
    assert fleet.anchors['p'].coordinates_m == (1.0, 2.0)
    of_all, of_b = fleet.odometry_error, fleet.odometry_error_of('b')
    assert (of_all.translation_per_m, of_all.translation_scale, of_all.tilt_rad) == (0.3, 1.0, 0.1)
    assert of_b == replace(of_all, translation_scale=0.9, constant_rad=0.0, tilt_rad=None)
    assert fleet.odometry_error_of('a') == fleet.odometry_error_of('c') == of_all


def test_topics_that_are_swapped_by_remapping_are_refused():
    """A subscription to the new name would be remapped back."""
    swapped = {'/uwb_1': '/uwb_2', '/uwb_2': '/uwb_1'}
    given = {**ROBOTS, 'links': ['/uwb_1 sensor_msgs/msg/Range a b']}
    with pytest.raises(WrongParameterError, match="'/uwb_2', and that to '/uwb_1': name"):
        settings_from(check_values(given), lambda topic: swapped.get(topic, topic))


def test_empty_template_means_no_topics():
    found = settings(**dict.fromkeys((name for name in TABLE if name.endswith('.topic')), ''))
    assert found.links == () and found.templates == ()


def test_parameters_of_others_are_left_alone():
    given = {**ROBOTS, 'qos_overrides./tf.publisher.depth': 5}
    assert 'qos_overrides./tf.publisher.depth' not in check_values(given)


def test_a_template_under_which_two_pairs_have_one_topic_is_refused():
    wanted = "'/a_b_c' is the topic of a and b_c, and of a_b and c"
    with pytest.raises(WrongParameterError, match=wanted):
        settings(robots=['a', 'a_b', 'b_c', 'c'], **{'range.topic': '/{observer}_{target}'})
    settings(robots=['a', 'a_b', 'b_c', 'c'], **{'range.topic': '/{observer}/{target}'})


def test_links_have_bounds_and_stamps_of_their_own():
    found = settings(
        **{
            'range.stamp_offset': -0.1,
            'odometry.stamp_offset': 0.02,
            'stamp_error': 0.01,
            'bearing.expected_error': 0.03,
        },
        links=[
            '/uwb_1/ab sensor_msgs/msg/Range a b max_error=1.5 expected_error=0.2',
            '/uwb_2/ab sensor_msgs/msg/Range a b min_error=-0.4 sigma_factor=2.0',
            '/ac sensor_msgs/msg/Range a c stamp_offset=-0.3',
            '/ab_seen geometry_msgs/msg/Vector3Stamped a b expected_error=-0.01 half_width=0.2',
            '/a/wheels nav_msgs/msg/Odometry a stamp_offset=0',
            '/b/all sensor_msgs/msg/PointCloud2 b stamp_offset=-0.2 max_error=0.7 half_width=0.1',
        ],
    )
    fleet = found.fleet
    assert [link.stamp_offset_s for link in found.links] == [-0.1, -0.1, -0.3, 0.0, 0.0, -0.2]
    by_kind = {template.kind: template for template in found.templates}
    assert by_kind[LinkKind.RANGE].link_of('/b/range/c', 'abc').stamp_offset_s == -0.1
    assert by_kind[LinkKind.ODOMETRY].link_of('/b/odom', 'abc').stamp_offset_s == 0.02
    assert fleet.stamp_error_s == 0.01
    assert fleet.odometry_error_of('a').latency_s == pytest.approx(0.02)
    # A stamp offset is no bound: those of the fleet hold.
    first, second, late, seeing, _, peers = bounds_of_links(found)
    assert late == fleet.sensor_bounds
    of_all = fleet.range_error
    assert first.range_error == replace(of_all, max_error_m=1.5, expected_error_m=0.2)
    assert second.range_error == replace(of_all, min_error_m=-0.4, sigma_factor=2.0)
    assert seeing == replace(late, bearing_half_width_rad=0.2, bearing_expected_error_rad=-0.01)
    assert peers.range_error == replace(of_all, max_error_m=0.7)
    assert (peers.bearing_half_width_rad, peers.bearing_expected_error_rad) == (0.1, 0.03)


def test_sensors_on_robots_and_elevations_reach_the_fleet():
    given = {
        'mounts.names': ['a/left', 'a/camera'],
        'mounts.a.left.position': [0.3, 0.2],
        'mounts.a.camera.position': [0.4, 0.0],
        'mounts.a.camera.bound': 0.01,
        'mounts.a.camera.rotation': [0.0, 0.0, math.pi],
        'elevations.names': ['a'],
        'elevations.a': [0.4, 0.5],
        'elevation.topic': '{observer}/depth',
        'elevation.stamp_offset': -0.1,
        'links': ['/a/all sensor_msgs/msg/PointCloud2 a/camera max_error=0.7', BARO],
    }
    found = settings(**given)
    fleet = found.fleet
    assert fleet.points == ('a', 'b', 'c', 'a/left', 'a/camera')
    assert fleet.sensors['a/left'].position_m == (0.3, 0.2)
    assert fleet.sensors['a/camera'].bound_m == 0.01
    assert fleet.sensors['a/camera'].rotation_xyzw == pytest.approx((0.0, 0.0, 1.0, 0.0))
    assert fleet.elevation_m('a/left') == (0.4, 0.5)
    of_camera, of_height = bounds_of_links(found)
    assert of_camera.range_error.max_error_m == 0.7
    assert of_height.elevation_error == ElevationErrorModel(-1.0, 0.5)
    assert of_height.range_error == fleet.range_error
    by_kind = {template.kind: template for template in found.templates}
    link = by_kind[LinkKind.RANGE].link_of('/b/range/a/left', fleet.points)
    assert link.key == LinkKey(LinkKind.RANGE, 'b', 'a/left')
    link = by_kind[LinkKind.ELEVATION].link_of('/a/depth', fleet.points)
    assert (str(link.key), link.stamp_offset_s) == ('elevation a', -0.1)
    with pytest.raises(WrongParameterError, match="a/camera->a is not allowed, .* robot 'a'"):
        settings(**{**given, 'links': ['/own sensor_msgs/msg/Range a/camera a max_error=0.7']})


INPUTS = int(os.environ.get('DG_FUZZ_PARAMETERS', '10000'))
NOTHING = {'mounts.names': [], 'elevations.names': []}
USUAL = {
    **ROBOTS,
    'anchors.names': ['p', 'q'],
    'anchors.p.position': [0.0, 0.0],
    'anchors.q.position': [5.0, 0.0],
}
ANY_NAMES = (*TABLE, *(name for name, _ in named_specs({**NOTHING, **USUAL})))
ANY_TEXTS = (
    *('', ' ', 'a', 'b', 'p', 'header', 'true', '1', 'nan', '/', '//', '~', '~/x', '{', '}', '{}'),
    *('/{observer}', '/{robot}', '/{observer}/{target}', '{observer}{target}', '/{observer!r}'),
    *('/{observer:>9999999999}', '/{robot}/{robot!r}', '/{0}/{1}', '/{observer.x}/{target}'),
    *('/{robot}/{robot}', '/ä'),
    *('\x00', '\n', 'x' * 5000, '🤖', '/t sensor_msgs/msg/Range a b', '/t sensor_msgs/msg/Range'),
    *('/t nav_msgs/msg/Odometry a', '/t sensor_msgs/msg/Range a b max_error=nan', 'os', 'no.such'),
    *('/t sensor_msgs/msg/Range a z max_error=1e400', '/t x y z', '= = = =', '/t a/b a b', '..'),
    *('/t sensor_msgs/msg/Range a b sigma_factor=-1', '/u sensor_msgs/msg/Range a b min_error=5'),
    *('/t geometry_msgs/msg/Vector3Stamped a b half_width=4', '/t std_msgs/msg/String a b'),
)
NUMBERS = (*(0, 1, -1, 2, 3, 7, 2**31, 2**63 - 1, -(2**63), 0.5), *FLOATS)


def any_value(random):
    """Return what rclpy makes of something in a file."""

    def several(values):
        return [random.choice(values) for _ in range(random.choice((0, 1, 2, 3, 5)))]

    kinds = (
        lambda: random.choice((None, True, False, [], array('d'), array('q'), [b'x'], b'x')),
        *2 * (lambda: random.choice(NUMBERS), lambda: random.choice(ANY_TEXTS)),
        lambda: several(ANY_TEXTS),
        lambda: [float(number) for number in several(NUMBERS)],
        lambda: array('q', several((0, 1, -1, 2**62))),
    )
    return random.choice(kinds)()


def names_something(text, given):
    """Return whether a message names one of the parameters that were given, or its setting."""
    # The list of names belongs to the setting that they name: elevations.names to elevations_m.
    names = [name.removesuffix('.names') for name in given]
    return any(name in text or name.replace('.', '_') in text for name in names)


def test_any_value_is_taken_or_refused_by_name():
    random = Random(1)
    refused = 0
    for _ in range(INPUTS):
        names = random.sample(ANY_NAMES, random.choice((1, 1, 3)))
        given = {name: any_value(random) for name in names}
        try:
            settings_from(check_values({**USUAL, **given}))
        except WrongParameterError as error:
            refused += 1
            assert names_something(str(error), given), (given, str(error))
            assert len(str(error)) < 12_000
    assert INPUTS // 4 < refused < INPUTS


def test_any_name_is_known_or_refused_by_name():
    random = Random(2)
    for _ in range(INPUTS // 20):
        name = random.choice(ANY_NAMES)
        at = random.randrange(len(name))
        wrong = name[:at] + random.choice('xyz._-é 1') + name[at + random.choice((0, 1)) :]
        if wrong not in ANY_NAMES:
            with pytest.raises(WrongParameterError, match='is unknown') as caught:
                check_values({**USUAL, wrong: 1})
            assert f"'{wrong}'" in str(caught.value)


YAMLS = ('null', '~', '[]', '{}', "''", 'yes', '-1', '1e400', '.nan', '[1, a]', '[[1]]', '"\\0"')


@pytest.mark.parametrize('text', YAMLS)
def test_any_text_in_a_file_is_taken_or_refused_by_name(node, text, tmp_path):
    for name in Random(text).sample(ANY_NAMES, 15):
        path = tmp_path / 'parameters.yaml'
        lines = [f'    {key}: {value}' for key, value in {**USUAL, name: text}.items()]
        path.write_text('\n'.join(['/**:', '  ros__parameters:', *lines]))
        refused = declared(node.context, path)
        by_rcl = 'parse params file' in refused and 'line' in refused
        assert not refused or by_rcl or names_something(refused, [name]), refused


def declared(context, path):
    """Declare the settings of a file on a node; return why they were refused, if so."""
    arguments = ['--ros-args', '--params-file', str(path)]
    try:
        node = Node('localizer', context=context, cli_args=arguments)
    except Exception as error:  # the file is refused by rcl, which names the line or the file
        return str(error)
    try:
        declare_settings(node)
    except WrongParameterError as error:
        return str(error)
    finally:
        node.destroy_node()
    return ''
