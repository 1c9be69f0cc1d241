# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Any content of a parameter file gives settings, or an error that names the parameter."""

from array import array
import os
from random import Random

from hostile_messages import FLOATS
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from dg_localization.ros.interface.parameters.settings import (
    check_values,
    declare_settings,
    settings_from,
)
from dg_localization.ros.interface.parameters.spec import WrongParameterError
from dg_localization.ros.interface.parameters.table import TABLE, named_specs

INPUTS = int(os.environ.get('DG_FUZZ_PARAMETERS', '20000'))
NOTHING = {'mounts.names': [], 'elevations.names': []}
USUAL = {
    'robots': ['a', 'b', 'c'],
    'anchors.names': ['p', 'q'],
    'anchors.p.position': [0.0, 0.0],
    'anchors.q.position': [5.0, 0.0],
}
NAMES = (*TABLE, *(name for name, _ in named_specs({**NOTHING, **USUAL})))
TEXTS = (
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
        *2 * (lambda: random.choice(NUMBERS), lambda: random.choice(TEXTS)),
        lambda: several(TEXTS),
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
        names = random.sample(NAMES, random.choice((1, 1, 3)))
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
        name = random.choice(NAMES)
        at = random.randrange(len(name))
        wrong = name[:at] + random.choice('xyz._-é 1') + name[at + random.choice((0, 1)) :]
        if wrong not in NAMES:
            with pytest.raises(WrongParameterError, match='is unknown') as caught:
                check_values({**USUAL, wrong: 1})
            assert f"'{wrong}'" in str(caught.value)


YAMLS = ('null', '~', '[]', '{}', "''", 'yes', '-1', '1e400', '.nan', '[1, a]', '[[1]]', '"\\0"')


@pytest.mark.parametrize('text', YAMLS)
def test_any_text_in_a_file_is_taken_or_refused_by_name(text, tmp_path):
    context = Context()
    rclpy.init(context=context)
    try:
        for name in Random(text).sample(NAMES, 15):
            path = tmp_path / 'parameters.yaml'
            given = {**USUAL, name: text}
            lines = [f'    {key}: {value}' for key, value in given.items()]
            path.write_text('\n'.join(['/**:', '  ros__parameters:', *lines]))
            refused = declared(context, path)
            by_rcl = 'parse params file' in refused and 'line' in refused
            assert not refused or by_rcl or names_something(refused, [name]), refused
    finally:
        rclpy.shutdown(context=context)


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
