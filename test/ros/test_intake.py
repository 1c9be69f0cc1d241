# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From messages to the localizer: by link, by ids, and by pixels; and what is refused."""

from dataclasses import replace
from functools import partial
import math

from hostile_messages import BEARING, CAMERA_INFO, CLOUD, ODOMETRY, RANGE
from nav_msgs.msg import Odometry
import numpy as np
from processes import LATCHED
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, PointCloud2, Range
from std_msgs.msg import String

from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    LinkKey,
    LinkKind,
    Localizer,
    RangeErrorModel,
    RejectionReason,
)
from dg_localization.ros.interface.discovery import TopicFinder
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
    PeersReading,
    PixelReading,
    RangeReading,
    adapter_for,
    register,
)

NOW_S = 10.0
TEXT = 'std_msgs/msg/String'
RANGES, CLOUDS = f'/a/range/b {RANGE} a b', f'/a/peers {CLOUD} a'
AB = LinkKey(LinkKind.RANGE, 'a', 'b')
TABLE = ['7 a', '8 b', '9 b', '30 -']
ANCHORED = {'robots': ['a', 'b'], 'anchors.names': ['p'], 'anchors.p.position': [0.0, 0.0]}
CAMERA = CameraReading(NOW_S, 'eye', (100.0, 100.0), (50.0, 50.0))


def make_intake(use_header_stamp=False, is_simulated=False, **settings):
    """Return a localizer of three robots and its intake."""
    localizer = Localizer(FleetConfig(robots=('a', 'b', 'c'), **settings))
    return localizer, Intake(localizer, use_header_stamp, parse_ids(TABLE), is_simulated)


def take(intake, link, message, now_s=NOW_S):
    """Take a message, or its bytes, on a link; return its rejection, and what was malformed."""
    link, data = parse_link(link), message
    if not isinstance(message, bytes):
        data = serialize_message(message)
    return intake.take(link, data, now_s), intake.malformed.get(link.topic)


def cloud(rows=((1,),), ranges_m=math.nan, ray=(math.nan,) * 3):
    """Return a message of rows of (peer), or of (peer, reference, difference)."""
    peers, *differences = map(np.array, zip(*rows, strict=True))
    ranges_m, rays = np.full(len(rows), ranges_m), np.full((len(rows), 3), ray)
    reading = PeersReading(NOW_S, peers, ranges_m, rays, '', *differences)
    return adapter_for(CLOUD).to_message(reading)


def test_other_measures_come_with_peers():
    anchors = {name: Anchor((x, 0.0)) for name, x in (('p', 0.0), ('q', 5.0))}
    localizer, intake = make_intake(use_header_stamp=True, anchors=anchors)
    link = f'{CLOUDS} difference_min_error=-0.1 difference_max_error=0.3'
    rows = (4, 3, 1.5), (3, 4, math.nan), (9, 3, 1.0), (3, 1, 1.0)
    rejection, _ = take(intake, link, cloud(rows))
    assert rejection.reason is RejectionReason.UNKNOWN_ROBOT
    states = {str(s.key): (s.accepted, s.rejected) for s in localizer.input_states(NOW_S)}
    assert states == {
        'peers a': (1, {RejectionReason.UNKNOWN_ROBOT: 1, RejectionReason.SEVERAL_BODIES: 1}),
        'range_difference a->q-p': (1, {}),
        'range_difference a->peer beyond 4-p': (0, {RejectionReason.UNKNOWN_ROBOT: 1}),
        'range_difference a->p-b': (0, {RejectionReason.SEVERAL_BODIES: 1}),
    }
    (seen,) = localizer.snapshot(NOW_S).window.observations['a', 'q', 'p']
    assert (seen.least_m, seen.most_m) == pytest.approx((1.2, 1.6))


NARROW = ' min_error=-0.02 max_error=0.02 half_width=0.01'


@pytest.mark.parametrize(
    ('overrides', 'bounds_m', 'half_width_rad'),
    [('', (1.7, 3.05), 0.2), (NARROW, (2.98, 3.02), 0.01)],
)
def test_readings_have_the_bounds_of_their_own_link(overrides, bounds_m, half_width_rad):
    ranging = RangeErrorModel(-0.05, 1.3, 0.0, 0.0)
    localizer, intake = make_intake(range_error=ranging, bearing_half_width_rad=0.2)
    message = cloud(ranges_m=3.0, ray=(1.0, 0.0, 0.0))
    assert take(intake, CLOUDS + overrides, message) == (None, None)
    snapshot = localizer.snapshot(NOW_S)
    (distance,), (ray,) = snapshot.distances, snapshot.rays
    assert (distance.lower_m, distance.upper_m) == pytest.approx(bounds_m)
    assert ray.half_width_rad == half_width_rad


@pytest.mark.parametrize('use_header_stamp', [False, True])
def test_stamps_are_corrected_by_the_offset_of_their_link(adapt, use_header_stamp):
    adapt(RANGE, lambda message: RangeReading(NOW_S, 3.0))
    _, intake = make_intake(use_header_stamp)
    assert take(intake, f'{RANGES} stamp_offset=-0.25', Range()) == (None, None)
    assert intake.states(NOW_S)[AB].age_s == 0.25
    rejection, _ = take(intake, f'{RANGES} stamp_offset=-25.0', Range())
    assert 'old' in rejection.text


@pytest.mark.parametrize('is_simulated', [False, True])
def test_a_clock_that_comes_after_what_it_dates_proves_no_stamp_wrong(adapt, is_simulated):
    adapt(RANGE, lambda message: RangeReading(NOW_S + 0.09, 3.0))
    _, intake = make_intake(True, is_simulated)
    assert take(intake, RANGES, Range()) == (None, None)
    assert ('ahead of their arrival' in intake.states(NOW_S)[AB].warning) != is_simulated
    # What is further ahead than `max_future` is refused either way.
    adapt(RANGE, lambda message: RangeReading(NOW_S + 0.2, 3.0))
    assert take(intake, RANGES, Range())[0].reason is RejectionReason.FUTURE


@pytest.mark.parametrize(
    ('overrides', 'accepted'),
    [
        ('', [3.0, 65.535]),
        (' min_reading=-1.0', [0.0, 3.0, 65.535]),
        (' min_reading=0.3 max_reading=65.535', [3.0]),
    ],
)
def test_readings_that_stand_for_none_are_refused_with_a_reason_of_their_own(overrides, accepted):
    _, intake = make_intake()
    for reading_m in (0.0, 3.0, 65.535):
        rejection, _ = take(intake, RANGES + overrides, Range(range=reading_m))
        assert (rejection is None) == (reading_m in accepted)
        if rejection is not None:
            assert rejection.reason is RejectionReason.NO_READING
            assert 'm is no reading: it is at or ' in rejection.text


def test_the_frame_of_odometry_has_no_slash_at_the_beginning():
    message = Odometry(child_frame_id='/a/base_link')
    message.header.frame_id = '/a/odom'
    message.pose.pose.orientation.w = 1.0
    localizer, intake = make_intake()
    assert take(intake, f'/a/odom {ODOMETRY} a', message) == (None, None)
    assert intake.bodies == {'a': 'a/base_link'}
    assert localizer.snapshot(NOW_S).motion.odometry['a'][-1].frame == 'a/odom'


def test_an_input_that_rejects_most_of_its_readings_lately_is_named_with_the_cause():
    _, intake = make_intake()
    for second in range(30):
        now_s = NOW_S + second
        for _ in range(3):
            take(intake, RANGES, Range(range=3.0 if second < 15 else -3.0), now_s)
        found = intake.rejecting(now_s)
        assert bool(found) == (second >= 20), second
    assert 'is negative' in found[AB]


def refuse(message):
    raise ValueError(f'range {message.range} is not for me')


@pytest.mark.parametrize(
    ('adapter', 'link', 'message', 'wrong'),
    [
        (lambda _: None, RANGES, Range(), 'returned NoneType, it must return RangeReading'),
        (refuse, RANGES, Range(), 'ValueError: range 0.0 is not for me'),
        (None, RANGES, bytes(serialize_message(Range())[:-4]), 'before Iron'),
        (None, CLOUDS, cloud([(1,)] * 7), 'cloud has 7 points, for this fleet at most 6'),
        (None, CLOUDS, PointCloud2(data=bytes(100_000)), 'the message has 1000'),
    ],
)
def test_what_cannot_be_read_is_counted_and_named(adapt, adapter, link, message, wrong):
    if adapter:
        adapt(RANGE, adapter)
    localizer, intake = make_intake()
    rejection, malformed = take(intake, link, message)
    assert rejection is None and malformed.count == 1 and wrong in malformed.last
    assert localizer.input_states(NOW_S) == []


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


def counts(localizer):
    """Return how many readings of each pair were accepted and rejected."""
    states = localizer.input_states(NOW_S)
    of_pairs = [state for state in states if state.key.kind is not LinkKind.PEERS]
    return {str(one.key): (one.accepted, sum(one.rejected.values())) for one in of_pairs}


TAKEN = {'range a->b': (1, 0)}


@pytest.mark.parametrize(
    ('observer', 'text', 'counted', 'wrong'),
    [
        ('*', '7 8:3.0', TAKEN, ''),
        ('a', '7 9:3.0', TAKEN, ''),
        ('a', '- 8:3.0', TAKEN, ''),
        # The name of a robot stands for itself.
        ('*', 'c a:3.0', {'range c->a': (1, 0)}, ''),
        # Strangers are counted by their id, and others passed over.
        ('*', '7 30:1.0 8:3.0 55:4.0', {**TAKEN, 'range a->id 55': (0, 1)}, ''),
        # An observer that is not named is not taken for another one.
        ('*', '5 8:3.0', {}, "'5' has no name in the parameter `ids`: name it there"),
        ('*', '30 8:3.0', {}, "observer id '30' has no name in the parameter `ids`"),
        ('a', '8 9:3.0', {}, "observer id '8' is that of b, not of a"),
        ('*', '- 8:3.0', {}, 'name the observer in the link of /uwb instead'),
        ('*', '7' + ' 8:3.0' * 7, {}, '7 robots and anchors were measured, for this fleet at mo'),
    ],
)
def test_ids_are_names_by_the_table(observer, text, counted, wrong):
    localizer, intake = make_intake()
    _, malformed = take(intake, f'/uwb {TEXT} {observer}', String(data=text))
    assert counts(localizer) == counted
    assert wrong in malformed.last and malformed.count == 1 if wrong else malformed is None


def test_strangers_cannot_fill_the_memory():
    localizer, intake = make_intake()
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
    localizer, intake = make_intake(dimension=3)
    take(intake, f'/a/info {CAMERA_INFO} a', camera_info())
    take(intake, f'/a/tags {TEXT} a {turn}', String(data='eye c:50:50'))
    (seen,) = localizer.snapshot(NOW_S).rays
    assert seen.direction == pytest.approx(ray, abs=1e-9)


@pytest.mark.parametrize('link', [f'/b/info {CAMERA_INFO} b', f'/a/info {CAMERA_INFO} a'])
def test_pixels_wait_for_the_matrix_of_their_own_camera(text_messages, link):
    text_messages(PixelReading, pixels_of_text)
    localizer, intake = make_intake()
    take(intake, link, camera_info())
    frame = 'eye' if link.endswith('b') else 'nose'
    _, malformed = take(intake, f'/a/tags {TEXT} a', String(data=f'{frame} c:50:50'))
    assert f"CameraInfo of a in frame '{frame}', which has not arrived" in malformed.last
    hint = 'is there a link' if frame == 'eye' else "it has arrived in frames 'eye'"
    assert hint in malformed.last
    assert counts(localizer) == {}


def test_cameras_are_counted_and_a_topic_has_one():
    _, intake = make_intake()
    for number in range(99):
        for topic in ('/a/left', '/a/right'):
            camera = replace(CAMERA, frame_id=f'eye {topic} {number}')
            assert take(intake, f'{topic} {CAMERA_INFO} a', camera_info(camera)) == (None, None)
    (state,) = intake.states(NOW_S + 5.0).values()
    assert (str(state.key), state.accepted, state.age_s) == ('camera a', 2 * 99, 5.0)
    assert state.in_use


@pytest.mark.parametrize(
    ('texts', 'wanted'),
    [
        (['7'], "'7' is not allowed: it must read 'ID NAME'"),
        (['7 a b'], "'7 a b' is not allowed: .* 'ID NAME', or"),
        (['7 a', '7 b'], "'7 b' is not allowed: id '7' is named twice"),
        (['7 z'], "'z' is not allowed, it must be one of a, b, p, or '-' to ignore"),
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

    bench.sending = [partial(send, '1 2:3.0 3:4.0'), partial(send, '2 3:5.0 66:1.0')]
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
    links = [f'/tags {TEXT} robot_1 yaw={0.5 * math.pi}', f'/info {CAMERA_INFO} robot_1']
    make_node(links=links, stamp_source='receive', bearing__half_width=0.02)
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

    bench.sending = [send]
    bench.until(is_there, 'one placement, turned by the camera')
    bench.until_status('input camera robot_1', Level.OK, 'in use')
    bench.until_status('input peers robot_1', Level.OK, 'in use')


def test_the_matrix_of_a_latched_camera_is_taken_before_time_is_known(bench, make_node):
    bench.node.create_publisher(CameraInfo, '/eye/info', LATCHED).publish(camera_info())
    make_node(use_sim_time=True, links=[f'/eye/info {CAMERA_INFO} robot_1'])
    bench.until_status('input camera robot_1', Level.OK, 'in use')


def make_finder(**values):
    """Return what finds the topics of three points, by parameters."""
    settings = settings_from(check_values({'robots': ['a', 'b', 'a_b'], **values}))
    return TopicFinder(settings.templates, settings.links, settings.fleet.points)


def found(*topics, **values):
    links = make_finder(**values).find([(topic, [kind]) for topic, kind in topics])
    return {link.topic: str(link.key) for link in links}


@pytest.mark.parametrize(
    'topic, type_name, key',
    [
        ('/a/range/b', RANGE, 'range a->b'),
        ('/b/bearing/a', BEARING, 'bearing b->a'),
        ('/a/odom', ODOMETRY, 'odometry a'),
        ('/a_b/peers', CLOUD, 'peers a_b'),
        ('/a/range/z', RANGE, 'range a->z'),
        ('/z/range/a', RANGE, 'range z->a'),
        ('/a/range/b', BEARING, None),
        ('/a/range/a', RANGE, None),
        ('/y/range/z', RANGE, None),
        ('/z/odom', ODOMETRY, None),
        ('/a/range/b/c', RANGE, None),
        ('/ns/a/range/b', RANGE, None),
    ],
)
def test_topic_is_understood_or_none_of_ours(topic, type_name, key):
    assert found((topic, type_name)) == ({topic: key} if key else {})


def test_known_names_decide_where_a_name_ends():
    joined = {'range.topic': '/uwb/{observer}_{target}'}
    assert found(('/uwb/a_b_b', RANGE), **joined) == {'/uwb/a_b_b': 'range a_b->b'}


def test_a_topic_that_a_link_replaces_is_told_once():
    finder = make_finder(links=[f'/cam/seen {CLOUD} a'])
    topics = [('/cam/seen', [CLOUD]), ('/a/peers', [CLOUD]), ('/b/peers', [CLOUD])]
    assert [link.topic for link in finder.find(topics)] == ['/b/peers']
    assert [link.topic for link in finder.passed_over] == ['/a/peers']
    assert list(finder.find(topics)) == [] and finder.passed_over == []


def test_only_a_few_strangers_are_listened_to():
    topics = [(f'/a/range/z{number}', RANGE) for number in range(2 * STRANGERS)]
    assert len(found(*topics, ('/a/range/b', RANGE))) == STRANGERS + 1
