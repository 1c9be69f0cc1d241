# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Messages that name observers and targets by ids, and pixels: from link to localizer."""

from dataclasses import replace
from functools import partial
import math

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import String

from dg_localization.fleet import FleetConfig, LinkKind, Localizer
from dg_localization.ros.interface.identities import OTHER_UNKNOWN, parse_ids
from dg_localization.ros.interface.intake import Intake
from dg_localization.ros.interface.links import STRANGERS, parse_link
from dg_localization.ros.interface.parameters.settings import check_values, settings_from
from dg_localization.ros.interface.parameters.spec import WrongParameterError
from msg_adapters import (
    Adapter,
    CameraReading,
    IdentifiedReading,
    Level,
    PixelReading,
    adapter_for,
    register,
)

NOW_S = 10.0
TEXT = 'std_msgs/msg/String'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
TABLE = ['7 a', '8 b', '9 b', '30 -']
ANCHORED = {'robots': ['a', 'b'], 'anchors.names': ['p'], 'anchors.p.position': [0.0, 0.0]}
CAMERA = CameraReading(NOW_S, 'eye', (100.0, 100.0), (50.0, 50.0))


@pytest.fixture(autouse=True)
def text_messages(adapt):
    """Have texts read by another function; the adapters are as before after the test."""

    def read(value_class, from_message):
        register(Adapter(TEXT, value_class, from_message, str))

    # 'OBSERVER TARGET:RANGE TARGET:RANGE'; a dash for an observer that is not named.
    read(IdentifiedReading, ranges_of_text)
    return read


def ranges_of_text(message):
    observer, *targets = message.data.split()
    ids, ranges = zip(*(word.split(':') for word in targets), strict=True) if targets else ((), ())
    return IdentifiedReading(NOW_S, observer.strip('-'), ids, np.array(ranges, float))


@pytest.fixture
def localizer():
    return Localizer(FleetConfig(robots=('a', 'b', 'c')))


@pytest.fixture
def intake(localizer):
    return Intake(localizer, False, parse_ids(TABLE))


def take(intake, link, message):
    """Take a message on a link; return what was malformed."""
    link = parse_link(link)
    intake.take(link, serialize_message(message), NOW_S)
    return intake.malformed.get(link.topic)


def counts(localizer):
    """Return how many readings of each pair were accepted and rejected."""
    return {
        str(state.key): (state.accepted, sum(state.rejected.values()))
        for state in localizer.input_states(NOW_S)
        if state.key.kind is not LinkKind.PEERS
    }


AB = {'range a->b': (1, 0)}


@pytest.mark.parametrize(
    ('observer', 'text', 'counted', 'wrong'),
    [
        ('*', '7 8:3.0', AB, ''),
        ('a', '7 9:3.0', AB, ''),
        ('a', '- 8:3.0', AB, ''),
        # The name of a robot stands for itself.
        ('*', 'c a:3.0', {'range c->a': (1, 0)}, ''),
        # Strangers are counted by their id, and others passed over.
        ('*', '7 30:1.0 8:3.0 55:4.0', {**AB, 'range a->id 55': (0, 1)}, ''),
        # An observer that is not named is not taken for another one.
        ('*', '5 8:3.0', {}, "'5' is nobody's in the parameter `ids`: name it there"),
        ('*', '30 8:3.0', {}, "observer id '30' is nobody's in the parameter `ids`"),
        ('a', '8 9:3.0', {}, "observer id '8' is that of b, not of a"),
        ('*', '- 8:3.0', {}, 'name the observer in the link of /uwb instead'),
        ('*', '7' + ' 8:3.0' * 7, {}, '7 robots and anchors were measured, for this fleet at mo'),
    ],
)
def test_ids_are_names_by_the_table(localizer, intake, observer, text, counted, wrong):
    malformed = take(intake, f'/uwb {TEXT} {observer}', String(data=text))
    assert counts(localizer) == counted
    assert wrong in malformed.last and malformed.count == 1 if wrong else malformed is None


def test_strangers_cannot_fill_the_memory(localizer, intake):
    for first in range(100, 10_000, 100):
        targets = ' '.join(f'{number}:1.0' for number in range(first, first + 100))
        take(intake, f'/uwb {TEXT} *', String(data=f'7 {targets}'))
    assert len(counts(localizer)) == max(STRANGERS, len(localizer.config.points)) + 1
    assert f'range a->{OTHER_UNKNOWN}' in counts(localizer)
    take(intake, f'/uwb {TEXT} *', String(data=f'7 {"x" * 20_000}:1.0'))
    assert max(map(len, counts(localizer))) < 100


def pixels_of_text(message):
    """Read 'FRAME ID:X:Y ID:X:Y'."""
    frame_id, *found = message.data.split()
    ids, xs, ys = zip(*(word.split(':') for word in found), strict=True)
    return PixelReading(NOW_S, ids, np.array([xs, ys], float).T, frame_id)


def camera_info(camera=CAMERA):
    return adapter_for(CAMERA_INFO).to_message(camera)


@pytest.mark.parametrize(
    ('turn', 'ray'),
    [
        ('yaw=1.5707963267948966', (0.0, 1.0, 0.0)),
        ('pitch=1.5707963267948966', (0.0, 0.0, -1.0)),
        ('roll=1.5707963267948966', (1.0, 0.0, 0.0)),
        # About the axes that stand still: first roll, then pitch, then yaw.
        ('pitch=1.5707963267948966 yaw=1.5707963267948966', (0.0, 0.0, -1.0)),
    ],
)
def test_camera_that_looks_elsewhere_is_turned(text_messages, turn, ray):
    text_messages(PixelReading, pixels_of_text)
    localizer = Localizer(FleetConfig(robots=('a', 'b', 'c'), dimension=3))
    intake = Intake(localizer, False, parse_ids(TABLE))
    take(intake, f'/a/info {CAMERA_INFO} a', camera_info())
    take(intake, f'/a/tags {TEXT} a {turn}', String(data='eye c:50:50'))
    (seen,) = localizer.snapshot(NOW_S).rays
    assert seen.direction == pytest.approx(ray, abs=1e-9)


@pytest.mark.parametrize('link', [f'/b/info {CAMERA_INFO} b', f'/a/info {CAMERA_INFO} a'])
def test_pixels_wait_for_the_matrix_of_their_own_camera(localizer, intake, text_messages, link):
    text_messages(PixelReading, pixels_of_text)
    take(intake, link, camera_info())
    frame = 'eye' if link.endswith('b') else 'nose'
    malformed = take(intake, f'/a/tags {TEXT} a', String(data=f'{frame} c:50:50'))
    assert f"CameraInfo of a in frame '{frame}' has arrived" in malformed.last
    hint = 'is there a link' if frame == 'eye' else "those that came are in frames 'eye'"
    assert hint in malformed.last
    assert counts(localizer) == {}


def test_cameras_are_counted_and_a_topic_has_one(intake):
    for number in range(99):
        for topic in ('/a/left', '/a/right'):
            camera = replace(CAMERA, frame_id=f'eye {topic} {number}')
            assert take(intake, f'{topic} {CAMERA_INFO} a', camera_info(camera)) is None
    (state,) = intake.states(NOW_S + 5.0).values()
    assert (str(state.key), state.accepted, state.age_s) == ('camera a', 2 * 99, 5.0)
    assert state.in_use


@pytest.mark.parametrize(
    ('texts', 'wanted'),
    [
        (['7'], "'7' is not allowed: it must read 'ID NAME'"),
        (['7 a b'], "'7 a b' is not allowed: .* 'ID NAME', or"),
        (['7 a', '7 b'], "'7 b' is not allowed: id '7' is named twice"),
        (['7 z'], "'z' is not allowed, it must be one of a, b, p, or '-' for"),
    ],
)
def test_wrong_table_is_refused(texts, wanted):
    with pytest.raises(WrongParameterError, match=wanted):
        settings_from(check_values({**ANCHORED, 'ids': texts}))


def test_ids_of_robots_and_anchors_are_accepted():
    texts = ['7 a', '1:0 p', '9 -', '', '"potted plant" -', ' "stop sign"  p ']
    assert settings_from(check_values({**ANCHORED, 'ids': texts})).ids == {
        '7': 'a',
        '1:0': 'p',
        '9': '-',
        'potted plant': '-',
        'stop sign': 'p',
    }


def test_a_fleet_whose_radios_share_one_topic_is_localized(bench, make_node):
    make_node(
        links=[f'/uwb {TEXT} *'],
        ids=['1 robot_1', '2 robot_2', '3 robot_3'],
        range__topic='',
        stamp_source='receive',
    )

    def send(text):
        bench.publisher(String, '/uwb').publish(String(data=text))

    bench.repeat(partial(send, '1 2:3.0 3:4.0'), partial(send, '2 3:5.0 66:1.0'))
    bench.until_placements(2)
    bench.until_status('input range robot_1->robot_2', Level.OK, 'in use')
    bench.until_status('input range robot_2->id 66', Level.WARN, "'id 66' is not one of")
    together = bench.until_status('input peers *', Level.OK, 'in use')
    values = dict(together.values)
    assert values['topic'] == '/uwb'
    assert int(values['accepted']) >= 3 and int(values['rejected_unknown_robot']) >= 1


def test_a_camera_and_its_detections_turn_a_fleet(bench, make_node, text_messages):
    """The reference sees two others with a camera that looks to the left, and so has a heading."""
    text_messages(PixelReading, pixels_of_text)
    yaw_rad = 0.5 * math.pi
    make_node(
        links=[f'/tags {TEXT} robot_1 yaw={yaw_rad}', f'/info {CAMERA_INFO} robot_1'],
        stamp_source='receive',
        bearing__half_width=0.02,
    )
    # robot_1 at the origin; robot_2 at (0, 3), straight ahead of the camera, robot_3 at (-4, 3).
    pixels = f'eye robot_2:50:50 robot_3:{50.0 - 100.0 * 4.0 / 3.0}:50'

    def send():
        for (a, b), range_m in {(1, 2): 3.0, (1, 3): 5.0, (2, 3): 4.0}.items():
            bench.send_range(f'robot_{a}', f'robot_{b}', range_m)
        bench.publisher(String, '/tags').publish(String(data=pixels))
        bench.publisher(CameraInfo, '/info').publish(camera_info())

    def is_there():
        # The first answers may know a part of the measurements only.
        bench.until_placements(1)
        positions_m = bench.last_poses().positions_m[:, :2]
        return np.abs(positions_m - [[0.0, 0.0], [0.0, 3.0], [-4.0, 3.0]]).max() < 0.4

    bench.repeat(send)
    bench.until(is_there, 'one placement, turned by the camera')
    bench.until_status('input camera robot_1', Level.OK, 'in use')
    bench.until_status('input peers robot_1', Level.OK, 'in use')
