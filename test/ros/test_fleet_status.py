# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The screen of `fleet_status`: one localizer among the diagnostics of others."""

from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticArray
from processes import Listener
import pytest

from dg_localization.ros.fleet_status import FleetStatusNode, screen
from msg_adapters import Diagnostics, Level, Status, adapter_for

to_message = adapter_for('diagnostic_msgs/msg/DiagnosticArray').to_message

POSE = {
    'position_m': '-1234.56 1234.56 -12.34',
    'yaw_deg': '-178 +- 180',
    'typical_m': '10.15',
    'guaranteed_m': '1210.41',
    'heard': '15 of 16',
}
FLEET = (
    Status(
        Level.WARN,
        'localizer: fleet',
        'ambiguous: 2 hypotheses',
        values={
            'hypotheses': '2',
            'hypothesis_numbers': '7 4',
            'frame': 'origin at a, x towards long_name',
            'inputs': '4',
            'inputs_in_use': '3',
            'rate_hz': '5.00',
            'would_fix': f'range a - d would fix the hinge at b; {"drive c " * 20}',
        },
    ),
    Status(Level.OK, 'localizer: robot a', 'localized', values={'position_m': '1.00 2.00'}),
    Status(Level.WARN, 'localizer: robot b', '', values=POSE | {'problem': 'ambiguous'}),
    Status(
        Level.ERROR, 'localizer: robot c', '', values={'problem': 'no placement: ' + 'x ' * 50}
    ),
    Status(Level.OK, 'localizer: input range a->b', 'in use'),
    Status(Level.WARN, 'localizer: input range b->c', 'stale'),
)


@pytest.mark.parametrize('name', ['b', 'a_robot_with_a_long_name'])
def test_the_screen_has_all_of_the_fleet_in_80_columns(name):
    fleet = [replace(one, name=one.name.replace('robot b', f'robot {name}')) for one in FLEET]
    lines = list(screen('localizer', fleet, 0.5))
    assert max(map(len, lines)) <= 80
    text = ' '.join(' '.join(lines).split())
    for status in fleet:
        if 'robot' in status.name:
            _, _, robot = status.name.partition('robot ')
            assert robot in text and ' '.join(status.values.get('problem', '').split()) in text
    assert lines[0] == 'localizer: WARN: ambiguous: 2 hypotheses'
    for part in (
        'origin at a, x towards long_name, 3 of 4 inputs in use, 5.00 answers/s, poses of',
        'poses of hypothesis 7 of 2',
        f'{name} WARN -1234.56 1234.56 -12.34 -178 +- 180 10.15 1210.41 15 of 16',
        'input range b->c: stale next: range a - d would fix the hinge at b next: drive c drive c',
    ):
        assert part in text
    assert 'a->b' not in text and 'WARN: ambiguous' in text and text.count('ambiguous') == 1


def test_a_silent_or_unknown_localizer_is_named_and_a_plane_has_no_z():
    assert 'SILENT for 7 s' in next(screen('localizer', FLEET, 7.0))
    (line,) = screen('localizer', (), 60.0)
    assert line.startswith('localizer: no diagnostics received; is it running')
    assert 'z m' in '\n'.join(screen('localizer', FLEET, 0.0))
    assert 'z m' not in '\n'.join(screen('localizer', FLEET[:2], 0.0))


def test_the_node_shows_its_localizer_and_no_other(node):
    shown: list[str] = []
    status_node = FleetStatusNode(shown.append, context=node.context)
    publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    other = Status(Level.ERROR, 'other: fleet', 'not mine')

    def send():
        publisher.publish(to_message(Diagnostics(1.0, FLEET)))
        publisher.publish(to_message(Diagnostics(1.0, (other,))))

    node.create_timer(0.1, send)
    listener = Listener(node, {}, status_node)
    assert listener.spin_until(lambda: any('ambiguous' in text for text in shown))
    assert 'localizer: WARN: ambiguous: 2 hypotheses' in shown[-1]
    assert not any('not mine' in text for text in shown)
