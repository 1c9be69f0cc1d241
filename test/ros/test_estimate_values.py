# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The plain values that are made of an estimate: poses, markers and diagnostics."""

from dataclasses import replace
import math

from estimates import AS_MAP, placement_at, report_on
from geometry_msgs.msg import PoseArray
import numpy as np
import pytest
from rclpy.serialization import deserialize_message

from dg_localization import Verdict
from dg_localization.fleet import (
    Estimate,
    FixedFrame,
    FrameKind,
    Group,
    InputState,
    LinkKey,
    LinkKind,
    LinkState,
    Offender,
    RejectionReason,
    Suspect,
    SuspectKind,
)
from dg_localization.ros.interface.diagnostics import statuses
from dg_localization.ros.interface.intake import Malformed
from dg_localization.ros.interface.links import Link
from dg_localization.ros.interface.outputs import (
    CONTRADICTING_RGBA,
    FRESH_RGBA,
    STALE_RGBA,
    estimate_messages,
    scene,
)
from dg_localization.ros.interface.poses import feasible_poses, unique_pose
from msg_adapters import Level, Shape

ROBOTS = ('a', 'b')
UNBOUNDED = np.array([[[-np.inf] * 2, [np.inf] * 2]] * 2)
NOWHERE = np.array([[[0.0] * 2, [0.5] * 2], [[-np.inf] * 2, [np.inf] * 2]])
AB = LinkKey(LinkKind.RANGE, 'a', 'b')
PEERS = LinkKey(LinkKind.PEERS, 'a', '')
BA = LinkKey(LinkKind.RANGE, 'b', 'a')
LINK = Link('/a/range/b', 'sensor_msgs/msg/Range', AB)


def placement(shift_m=0.0, dimension=2, **changes):
    """Return robot a at the origin with a known heading, robot b at (3 + shift, 1)."""
    positions = np.zeros((2, dimension))
    positions[1, :2] = 3.0 + shift_m, 1.0
    made = {
        'enclosure_m': np.stack([positions - 0.2, positions + 0.1], axis=1),
        'orientations_xyzw': np.array([[0.0, 0.0, 0.6, 0.8], [math.nan] * 4]),
        'heading_known': np.array([True, False]),
        'heading_half_width_rad': np.array([0.1, math.pi]),
    }
    return placement_at(positions, **{**made, **changes})


def estimate(*placements, **changes):
    made = Estimate(
        stamp_s=12.5,
        robots=ROBOTS,
        verdict=Verdict.COVERED,
        reason='as measured',
        placements=placements,
        n_hypotheses=len(placements),
        links=(LinkState(AB, 3.0, 3.3, 0.1, stale=False),),
    )
    return replace(made, **changes)


def input_state(**changes):
    return replace(InputState(AB, 5, {}, '', 0.1, True), **changes)


def status(part, made, **changes):
    """Return the status of a part 0.1 s after an estimate."""
    plain = {'links': (LINK,), 'inputs': {AB: input_state()}, 'robots': ROBOTS, 'now_s': 12.6}
    report = report_on(made, **{**plain, **changes})
    by_name = {status.name: status for status in statuses(report)}
    return by_name.get(f'localizer: {part}')


def test_poses_come_placement_by_placement_in_robot_order():
    poses = feasible_poses(estimate(placement(), placement(1.0)), 'map')
    assert poses.positions_m[:, :2].tolist() == [[0.0, 0.0], [3.0, 1.0], [0.0, 0.0], [4.0, 1.0]]
    # An unknown heading is no rotation at all.
    assert poses.orientations_xyzw[:2].tolist() == [[0.0, 0.0, 0.6, 0.8], [0.0] * 4]
    assert (poses.stamp_s, poses.frame_id) == (12.5, 'map')


def test_array_of_one_robot_leaves_unknown_positions_out_and_that_of_the_fleet_does_not():
    lost = placement(positions_m=np.array([[0.0, 0.0], [np.nan, np.nan]]))
    messages = dict(estimate_messages(estimate(placement(), lost), AS_MAP))
    fleet, a, b = (
        deserialize_message(messages[f'~/{name}feasible_poses'], PoseArray).poses
        for name in ('', 'a/', 'b/')
    )
    assert (len(fleet), len(a), len(b)) == (4, 2, 1)
    assert math.isnan(fleet[3].position.x) and b[0].position.x == 3.0


def test_covariance_of_an_estimate_is_that_of_the_fit_with_a_floor():
    matrix = np.diag([0.04, 0.0001, 0.0, 0.0, 0.0, 0.02])
    matrix[0, 5] = matrix[5, 0] = 0.01
    made = estimate(placement(covariances=np.array([matrix, matrix])))
    pose = unique_pose(made, 0, 'map', 0.05)
    assert np.diag(pose.covariance) == pytest.approx([0.04, 0.0025, 1e-6, 1e-6, 1e-6, 0.02])
    assert pose.covariance[0, 5] == pose.covariance[5, 0] == 0.01
    assert np.linalg.eigvalsh(pose.covariance).min() > 0.0
    # The heading of the other robot is not known.
    pose = unique_pose(made, 1, 'map', 0.05)
    assert pose.covariance[5, 5] == 1e6 and pose.covariance[0, 5] == 0.0
    # An estimate of somebody else, without covariances, has its bounds.
    bounds = unique_pose(made, 0, 'map', None)
    pose = unique_pose(estimate(placement()), 0, 'map', 0.05)
    assert (pose.covariance == bounds.covariance).all()


def test_covariance_holds_the_squares_of_the_farthest_sides():
    pose = unique_pose(estimate(placement()), 0, 'map')
    assert np.diag(pose.covariance) == pytest.approx([0.04, 0.04, 1e-6, 1e-6, 1e-6, 0.01])
    assert np.count_nonzero(pose.covariance) == 6
    # An unknown heading has no weight in a filter.
    pose = unique_pose(estimate(placement()), 1, 'map')
    assert pose.orientation_xyzw.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert pose.covariance[5, 5] == 1e6
    pose = unique_pose(estimate(placement(dimension=3)), 0, 'map')
    assert np.diag(pose.covariance) == pytest.approx([0.04] * 3 + [0.01] * 3)
    # The robot that the frame is attached to is not certain to a filter.
    exact = placement(enclosure_m=np.zeros((2, 2, 2)), heading_half_width_rad=np.zeros(2))
    assert np.diag(unique_pose(estimate(exact), 0, 'map').covariance).tolist() == [1e-6] * 6


@pytest.mark.parametrize(
    'made',
    [
        estimate(),
        estimate(placement(), placement(1.0)),
        estimate(placement(), n_hypotheses=70),
        estimate(placement(enclosure_m=UNBOUNDED)),
        estimate(placement(positions_m=np.full((2, 2), np.nan))),
    ],
    ids=['none', 'two', 'more than listed', 'unbounded', 'unknown'],
)
def test_there_is_a_pose_only_while_one_hypothesis_is_left(made):
    assert unique_pose(made, 1, 'map') is None


def test_landmarks_are_drawn_and_named_once():
    placements = [placement(k, landmarks_m=np.array([[9.0, 9.0]])) for k in range(64)]
    made = estimate(*placements, landmarks=('beacon',))
    markers = scene(made, 'map', 1.0).markers
    (robots,) = [marker for marker in markers if marker.namespace == 'robots']
    assert len(robots.points_m) == 3 * 64 and robots.points_m[2].tolist() == [9.0, 9.0, 0.0]
    assert [marker.text for marker in markers].count('beacon') == 1


def test_scene_has_a_namespace_for_each_thing():
    states = ((False, False), FRESH_RGBA), ((True, False), STALE_RGBA)
    for state, color in (*states, ((True, True), CONTRADICTING_RGBA)):
        made = estimate(placement(), links=(LinkState(AB, 3.0, 3.3, 0.1, *state),))
        markers = {marker.namespace: marker for marker in scene(made, 'map', 1.0).markers}
        assert markers['links'].colors_rgba.tolist() == [color.tolist()] * 2
    assert set(markers) == {'robots', 'headings', 'enclosures', 'links', 'names'}
    assert markers['robots'].shape is Shape.SPHERE_LIST and len(markers['robots'].points_m) == 2
    assert len(markers['headings'].points_m) == 2  # one known heading
    assert markers['headings'].points_m[1] == pytest.approx([0.6 * 0.28, 0.6 * 0.96, 0.0])
    assert [len(markers[name].points_m) for name in ('enclosures', 'links')] == [2 * 4 * 2, 2]


def test_what_is_not_known_is_not_drawn():
    places_m = np.array([[0.0, 0.0], [math.nan, math.nan]])
    unknown = placement(positions_m=places_m, enclosure_m=NOWHERE)
    markers = scene(estimate(unknown), 'map', 1.0).markers
    assert all(np.isfinite(marker.points_m).all() for marker in markers)
    assert [marker.text for marker in markers if marker.namespace == 'names'] == ['a']


OK, WARN, ERROR = Level.OK, Level.WARN, Level.ERROR
FLEET, ROBOT, INPUT = 'fleet', 'robot b', 'input range a->b'
ONE, TWO = estimate(placement()), estimate(placement(), placement(1.0))
NONE = estimate(verdict=Verdict.INFEASIBLE)
NEVER, UNKNOWN = replace(ONE, links=()), estimate(verdict=None, reason='all is stale')
STALE = replace(ONE, links=(LinkState(AB, 0.0, math.inf, 9.0, stale=True),))
CONFLICT = replace(NONE, conflicts=((AB, BA),))
HERE, THERE = FixedFrame(FrameKind.ROBOTS, ('a', 'b')), FixedFrame(FrameKind.HEADING, ('a',))
MOVED = replace(ONE, frame=HERE, previous_frame=THERE)
MISFIT = placement(misfits=('beacon a4',))
AGAINST = LinkState(AB, 3.0, 3.3, 0.1, stale=False, contradicts=True)
DOUBTED = estimate(placement(enclosure_m=NOWHERE), links=(AGAINST,))
WIDE = placement(enclosure_m=np.array([[[0.0] * 2, [0.5] * 2], [[0.0] * 2, [3.0, 6.16]]]))
FITTED = estimate(
    placement(covariances=np.tile(np.diag([0.01, 0.03, 1.0, 1.0, 1.0, 1.0]), (2, 1, 1))),
    links=(
        LinkState(AB, 3.0, 3.3, 0.1, stale=False),
        LinkState(LinkKey(LinkKind.RANGE, 'c/left', 'b'), 3.0, 3.3, 9.0, stale=True),
    ),
)
FITTED_TEXT = 'within 0.20 m (typical), within 0.28 m (guaranteed), 1 of 2 neighbours heard'
NARROW, ANY_WIDTH = {'localized_width_m': 1.0}, {'localized_width_m': 7.0}
SLOW, FAST = ({'rate_hz': rate_hz} for rate_hz in (0.42, 4.9))
WARNED = {'warnings': ('two nodes',)}
SILENT = {'links': (Link('/uwb', 'sensor_msgs/msg/Range', AB, explicit=True),), 'inputs': {}}
MALFORMED = {'malformed': {'/a/range/b': Malformed(3, 'too short', 12.0)}}
RAY = LinkKey(LinkKind.BEARING, 'a', 'b')


def lied(count):
    """Return an estimate of a sensor that was suspected so often in five contradictions."""
    suspect = Suspect(SuspectKind.SENSOR, 'a', measures=(LinkKind.RANGE,))
    return replace(ONE, offenders=(Offender(suspect, count, 5, 60.0),))


def given(**changes):
    """Return the state of the one input."""
    return {'inputs': {AB: input_state(**changes)}}


def camera(explicit):
    """Return a camera that sees nothing now."""
    link = Link('/a/bearing/b', 'geometry_msgs/msg/Vector3Stamped', RAY, explicit)
    return {'links': (link,), 'inputs': {RAY: input_state(key=RAY, in_use=False)}}


@pytest.mark.parametrize(
    'part, made, changes, level, text',
    [
        (FLEET, None, {}, WARN, 'no estimate yet'),
        (FLEET, ONE, {}, OK, 'localized: one hypothesis'),
        (FLEET, TWO, {}, WARN, 'ambiguous: 2 hypotheses'),
        (FLEET, estimate(placement(flexible=True)), {}, WARN, 'flexible'),
        (FLEET, estimate(placement(dropped=(AB,))), {}, WARN, 'contradicting inputs dropped'),
        (FLEET, replace(ONE, verdict=Verdict.OUT_OF_BUDGET), {}, WARN, 'out of budget'),
        (FLEET, UNKNOWN, {}, WARN, 'all is stale'),
        (FLEET, NONE, {}, ERROR, 'contradiction: as measured'),
        (FLEET, ONE, SLOW, WARN, 'hypothesis; localizes at 0.42 Hz, not at the 5 Hz of `rate`'),
        (FLEET, ONE, FAST, OK, 'localized: one hypothesis'),
        (FLEET, ONE, WARNED, WARN, 'localized: one hypothesis; two nodes'),
        (FLEET, NONE, WARNED, ERROR, 'as measured; two nodes'),
        (FLEET, ONE, {'trouble': 'inactive', 'failure': 'bug'}, WARN, 'inactive'),
        (FLEET, ONE, {'failure': 'internal error'}, ERROR, 'internal error'),
        (FLEET, MOVED, {}, WARN, 'the frame has changed: body frame of a before, origin at a, x'),
        (FLEET, replace(ONE, frame_doubt='a is silent'), {}, WARN, 'a is silent'),
        (FLEET, estimate(MISFIT), {}, WARN, 'bounds look too narrow: beacon a4'),
        (FLEET, lied(3), {}, WARN, "one hypothesis; a's ranging was among the suspects in 3 of"),
        (FLEET, lied(2), {}, OK, 'localized'),
        (FLEET, estimate(placement(enclosure_m=NOWHERE)), {}, WARN, 'not bounded: b'),
        (FLEET, estimate(WIDE), NARROW, WARN, 'one hypothesis, 6.2 m wide'),
        (FLEET, estimate(WIDE), ANY_WIDTH, OK, 'localized'),
        # How wide each of several hypotheses is does not settle which is true.
        (FLEET, estimate(WIDE, WIDE), NARROW, WARN, 'ambiguous: 2 hypotheses'),
        (ROBOT, ONE, {}, OK, 'localized'),
        (ROBOT, FITTED, {}, OK, f'localized: {FITTED_TEXT}'),
        (ROBOT, TWO, {}, WARN, 'ambiguous'),
        (ROBOT, UNKNOWN, {}, WARN, 'no placement'),
        (ROBOT, estimate(placement(enclosure_m=UNBOUNDED)), {}, WARN, 'not bounded'),
        (ROBOT, estimate(WIDE), NARROW, WARN, 'one hypothesis, 6.2 m wide: within 5.97 m (guar'),
        ('robot a', estimate(WIDE), NARROW, OK, 'localized'),
        ('robot a', CONFLICT, {}, ERROR, 'contradict'),
        (ROBOT, DOUBTED, {}, WARN, 'in doubt: it contradicts what was measured before'),
        (ROBOT, STALE, {}, WARN, 'stale'),
        (ROBOT, NEVER, {}, WARN, 'never measured'),
        (INPUT, ONE, {}, OK, 'in use'),
        (INPUT, ONE, given(in_use=False), WARN, 'stale'),
        (INPUT, ONE, given(stuck='stuck: 9 readings'), WARN, 'stuck: 9 readings'),
        (INPUT, ONE, given(restart='started anew: by a jump'), WARN, 'anew: by a jump'),
        (INPUT, ONE, given(in_use=False, accepted=0, last_reason_text='NaN'), WARN, 'NaN'),
        (INPUT, ONE, SILENT, WARN, 'nothing received'),
        (INPUT, ONE, {**MALFORMED, 'inputs': {}}, WARN, 'malformed: too short'),
        (INPUT, ONE, {**MALFORMED, **given(in_use=False, age_s=5.0)}, WARN, 'malformed: too sh'),
        (INPUT, ONE, {**MALFORMED, **given(in_use=False, age_s=0.5)}, WARN, 'stale'),
        (INPUT, ONE, {'rejecting': {AB: 'rejects 9 of 10'}}, WARN, 'rejects 9 of 10'),
        (INPUT, CONFLICT, {}, ERROR, 'contradict'),
        # A camera that sees no robot is no warning, unless a link names it.
        ('input bearing a->b', ONE, camera(explicit=False), OK, ''),
        ('input bearing a->b', ONE, camera(explicit=True), WARN, 'stale'),
    ],
)
def test_status(part, made, changes, level, text):
    found = status(part, made, **changes)
    assert found.level is level and text in found.message


def test_a_hypothesis_can_be_followed_although_the_order_changes():
    first = placement(number=7)
    second = placement(1.0, number=3, proved=False)
    third = placement(2.0, number=12, enclosure_m=UNBOUNDED)
    for order in ((first, second, third), (third, first, second)):
        values = status('fleet', estimate(*order)).values
        numbers = [str(one.number) for one in order]
        assert values['hypothesis_numbers'].split() == numbers
        assert values['proved_numbers'].split() == [n for n in numbers if n != '3']
        assert values['hypothesis_7'] == 'proved, 0.30 m wide'
        assert values['hypothesis_3'] == 'not proved, 0.30 m wide'
        assert values['hypothesis_12'] == 'proved, not bounded'
        poses = feasible_poses(estimate(*order), 'map').positions_m.reshape(3, 2, 3)
        at = status('robot b', estimate(*order)).values['hypothesis_3']
        assert at.startswith('at 4.000 1.000 m')
        assert poses[numbers.index('3'), 1, 0] == 4.0
    many = estimate(*[placement(k, number=k + 1) for k in range(64)])
    values = status('robot b', many).values
    assert sum(name.startswith('hypothesis_') for name in values) == 8
    values = status('fleet', many).values
    assert values['hypothesis_numbers'].split() == [str(k + 1) for k in range(64)]
    assert sum(name.startswith('hypothesis_') for name in values) == 9


def test_only_inputs_that_are_named_or_were_heard_have_a_status():
    assert status('input range a->b', estimate(), inputs={}) is None
    rejected = {RejectionReason.NAN: 2, RejectionReason.TOO_OLD: 3}
    state = input_state(rejected=rejected, last_reason_text='too old')
    changes = {'inputs': {AB: state}, 'rejecting': {AB: 'rejects 5 of 10'}, **MALFORMED}
    values = status('input range a->b', estimate(), **changes).values
    assert (values['rejected'], values['rejected_too_old']) == ('5', '3')
    assert (values['malformed'], values['last_malformed']) == ('3', 'too short')
    assert 'rejects 5 of 10' in status('fleet', estimate(placement()), **changes).message
    # Two topics of one link have names of their own.
    links = tuple(Link(topic, 'sensor_msgs/msg/Range', AB, True) for topic in ('/x', '/y'))
    assert status('input range a->b by /y', None, links=links).values['topic'] == '/y'


def test_peers_have_a_status_together_and_one_each():
    state = input_state(accepted=3, rejected={RejectionReason.NAN: 1}, age_s=0.4, in_use=False)
    together = input_state(key=PEERS, accepted=8)
    changes = {
        'links': (Link('/a/peers', 'sensor_msgs/msg/PointCloud2', PEERS),),
        'inputs': {AB: state, AB._replace(kind=LinkKind.BEARING): input_state(), PEERS: together},
    }
    found = status('input peers a', estimate(), **changes)
    assert (found.level, found.message, found.values['accepted']) == (Level.OK, 'in use', '8')
    one = status('input range a->b', estimate(), **changes)
    assert (one.level, one.message) == (Level.OK, 'not measured now')
    assert one.values['topic'] == '/a/peers'
    assert status('input peers a', CONFLICT, **changes).level is ERROR
    assert status('input bearing a->b', CONFLICT, **changes).level is OK
    values = status('fleet', estimate(), **changes).values
    assert (values['inputs'], values['inputs_in_use']) == ('2', '1')
    # What was malformed is counted once.
    changes['malformed'] = {'/a/peers': Malformed(2, 'no peer')}
    assert status('input peers a', None, **changes).values['malformed'] == '2'
    assert 'malformed' not in status('input range a->b', None, **changes).values


def test_robots_that_are_not_connected_to_the_frame_are_placed_in_their_own():
    frame = FixedFrame(FrameKind.HEADING, ('b',))
    group = Group(('b',), frame, (placement(),), 1)
    made = estimate(placement(), frame=FixedFrame(FrameKind.ROBOTS, ('a',)), groups=(group,))
    fleet, robot = status('fleet', made), status('robot b', made)
    assert (fleet.level, fleet.message) == (Level.WARN, '1 more in frames of their own')
    assert fleet.values['group_0'] == 'b: body frame of b; hypotheses: 1'
    assert robot.level == Level.WARN
    assert robot.message == 'not connected to the published frame: placed in body frame of b'
    assert robot.values['hypothesis_0'].startswith('at 3.000 1.000 m')
    assert status('robot a', made).level == Level.OK


def test_the_diagnostics_say_what_contradicts_what_is_rigid_and_what_would_fix_the_rest():
    said = status('fleet', CONFLICT).values['conflict_0']
    assert said == 'range a->b (3.00 to 3.30 m), range b->a'
    made = estimate(
        placement(), rigid_groups=(('a', 'b'), ('b', 'c')), would_fix=('range a - c',) * 50
    )
    values = status('fleet', replace(made, ruled_out=('mirror image by range a->b',))).values
    assert values['ruled_out'] == 'mirror image by range a->b'
    assert values['rigid_groups'] == 'a, b; b, c'
    assert values['would_fix'].startswith('range a - c; ') and len(values['would_fix']) == 300


@pytest.mark.parametrize('off_rad', [0.07, -0.4, 6.2])
def test_the_heading_of_the_best_point_is_published_within_its_bounds(off_rad):
    middle_rad = 2.0 * math.atan2(0.6, 0.8)
    made = placement(fitted_yaws_rad=np.array([middle_rad + off_rad, 1.0]))
    clipped_rad = min(max(math.remainder(off_rad, math.tau), -0.1), 0.1)
    xyzw = unique_pose(estimate(made), 0, 'map').orientation_xyzw
    yaw_rad = 2.0 * math.atan2(xyzw[2], xyzw[3])
    assert math.remainder(yaw_rad - middle_rad - clipped_rad, math.tau) == pytest.approx(0.0)
    half_widths_rad = made.best_headings[1]
    assert half_widths_rad == pytest.approx([0.1 + abs(clipped_rad), math.pi])
    variance = unique_pose(estimate(made), 0, 'map').covariance[5, 5]
    assert variance == pytest.approx(half_widths_rad[0] ** 2)
    assert np.isnan(made.best_headings[0][1]).all()
