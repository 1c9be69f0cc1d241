# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What an estimate becomes before it is a message: poses, markers, diagnostics."""

from dataclasses import replace
import math

from estimates import placement_at
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
from dg_localization.ros.interface.diagnostics import Malformed, Report, statuses
from dg_localization.ros.interface.links import Link
from dg_localization.ros.interface.markers import (
    CONTRADICTING_RGBA,
    FRESH_RGBA,
    MOST_DRAWN,
    STALE_RGBA,
    scene,
)
from dg_localization.ros.interface.outputs import estimate_messages
from dg_localization.ros.interface.poses import (
    feasible_poses,
    frame_id,
    unique_pose,
)
from msg_adapters import Level, Shape

ROBOTS = ('a', 'b')
UNBOUNDED = np.array([[[-np.inf] * 2, [np.inf] * 2]] * 2)
NOWHERE = np.array([[[0.0] * 2, [0.5] * 2], [[-np.inf] * 2, [np.inf] * 2]])
AB = LinkKey(LinkKind.RANGE, 'a', 'b')
PEERS = LinkKey(LinkKind.PEERS, 'a', '')
BA = LinkKey(LinkKind.RANGE, 'b', 'a')
ALONE = LinkKey(LinkKind.ODOMETRY, 'b', ''), LinkKey(LinkKind.ELEVATION, 'b', '')


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


def report(made, **changes):
    plain = Report(
        node='localizer',
        trouble='',
        failure='',
        warnings=(),
        now_s=12.6,
        lifetime_s=1.0,
        estimate=made,
        robots=ROBOTS,
        links=(Link('/a/range/b', 'sensor_msgs/msg/Range', AB),),
        inputs={AB: input_state()},
        malformed={},
        wrong_types={},
    )
    return replace(plain, **changes)


def input_state(**changes):
    return replace(InputState(AB, 5, {}, '', 0.1, True), **changes)


def status(part, made, **changes):
    by_name = {status.name: status for status in statuses(report(made, **changes))}
    return by_name.get(f'localizer: {part}')


def test_poses_come_placement_by_placement_in_robot_order():
    poses = feasible_poses(estimate(placement(), placement(1.0)), 'map')
    assert poses.positions_m[:, :2].tolist() == [[0.0, 0.0], [3.0, 1.0], [0.0, 0.0], [4.0, 1.0]]
    # An unknown heading is no rotation at all.
    assert poses.orientations_xyzw[:2].tolist() == [[0.0, 0.0, 0.6, 0.8], [0.0] * 4]
    assert (poses.stamp_s, poses.frame_id) == (12.5, 'map')


def test_array_of_one_robot_leaves_unknown_positions_out_and_that_of_the_fleet_does_not():
    lost = placement(positions_m=np.array([[0.0, 0.0], [np.nan, np.nan]]))
    messages = dict(estimate_messages(estimate(placement(), lost), 'map', 1.0))
    fleet, a, b = (
        deserialize_message(messages[f'~/{name}feasible_poses'], PoseArray).poses
        for name in ('', 'a/', 'b/')
    )
    assert (len(fleet), len(a), len(b)) == (4, 2, 1)
    assert math.isnan(fleet[3].position.x) and b[0].position.x == 3.0


def estimated_covariances():
    matrix = np.diag([0.04, 0.0001, 0.0, 0.0, 0.0, 0.02])
    matrix[0, 5] = matrix[5, 0] = 0.01
    return np.array([matrix, matrix])


def test_covariance_of_an_estimate_is_that_of_the_fit_with_a_floor():
    made = estimate(placement(covariances=estimated_covariances()))
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


def test_landmarks_are_drawn_and_named_and_not_too_many_placements():
    made = estimate(
        *[placement(k, landmarks_m=np.array([[9.0, 9.0]])) for k in range(MOST_DRAWN + 9)],
        landmarks=('beacon',),
    )
    markers = scene(made, 'map', 1.0).markers
    (robots,) = [marker for marker in markers if marker.namespace == 'robots']
    assert len(robots.points_m) == 3 * MOST_DRAWN
    assert robots.points_m[2].tolist() == [9.0, 9.0, 0.0]
    assert 'beacon' in [marker.text for marker in markers]


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
    assert len(markers['enclosures'].points_m) == 2 * 4 * 2
    assert len(markers['links'].points_m) == 2


def test_what_is_not_known_is_not_drawn():
    places_m = np.array([[0.0, 0.0], [math.nan, math.nan]])
    unknown = placement(positions_m=places_m, enclosure_m=NOWHERE)
    markers = scene(estimate(unknown), 'map', 1.0).markers
    assert all(np.isfinite(marker.points_m).all() for marker in markers)
    assert [marker.text for marker in markers if marker.namespace == 'names'] == ['a']


ONE, NONE = estimate(placement()), estimate(verdict=Verdict.INFEASIBLE)
SLOW = {'wanted_rate_hz': 5.0, 'rate_hz': 0.42}
MOVED = replace(
    ONE,
    frame=FixedFrame(FrameKind.ROBOTS, ('a', 'b')),
    previous_frame=FixedFrame(FrameKind.HEADING, ('a',)),
)


def lied(count):
    """Return an estimate of a sensor that was suspected so often in five contradictions."""
    offender = Offender(
        Suspect(SuspectKind.SENSOR, 'a', measures=(LinkKind.RANGE,)), count, 5, 60.0
    )
    return replace(ONE, offenders=(offender,))


@pytest.mark.parametrize(
    'made, changes, level, text',
    [
        (None, {}, Level.WARN, 'no estimate yet'),
        (ONE, {}, Level.OK, 'localized: one hypothesis'),
        (estimate(placement(), placement(1.0)), {}, Level.WARN, 'ambiguous: 2 hypotheses'),
        (estimate(placement(flexible=True)), {}, Level.WARN, 'flexible'),
        (estimate(placement(dropped=(AB,))), {}, Level.WARN, 'contradicting inputs dropped'),
        (replace(ONE, verdict=Verdict.OUT_OF_BUDGET), {}, Level.WARN, 'out of budget'),
        (estimate(verdict=None, reason='all is stale'), {}, Level.WARN, 'all is stale'),
        (NONE, {}, Level.ERROR, 'contradiction: as measured'),
        (ONE, SLOW, Level.WARN, 'one hypothesis; localizes at 0.42 Hz, not at the 5 Hz of `rate`'),
        (ONE, {'wanted_rate_hz': 5.0, 'rate_hz': 4.9}, Level.OK, 'localized: one hypothesis'),
        (ONE, {'warnings': ('two nodes',)}, Level.WARN, 'localized: one hypothesis; two nodes'),
        (NONE, {'warnings': ('two nodes',)}, Level.ERROR, 'as measured; two nodes'),
        (ONE, {'trouble': 'inactive', 'failure': 'bug'}, Level.WARN, 'inactive'),
        (ONE, {'failure': 'internal error'}, Level.ERROR, 'internal error'),
        (MOVED, {}, Level.WARN, 'the frame has changed: body frame of a before, origin at a, x'),
        (replace(ONE, frame_doubt='a is silent'), {}, Level.WARN, 'a is silent'),
        (lied(3), {}, Level.WARN, "one hypothesis; a's ranging was among the suspects in 3 of"),
        (lied(2), {}, Level.OK, 'localized'),
        (estimate(placement(enclosure_m=NOWHERE)), {}, Level.WARN, 'not bounded: b'),
    ],
)
def test_fleet_status(made, changes, level, text):
    found = status('fleet', made, **changes)
    assert found.level is level and text in found.message


@pytest.mark.parametrize(
    'made, level, text',
    [
        (ONE, Level.OK, 'localized'),
        (estimate(placement(), placement(1.0)), Level.WARN, 'ambiguous'),
        (estimate(placement(), links=()), Level.WARN, 'stale'),
        (estimate(verdict=None), Level.WARN, 'no placement'),
        (NONE, Level.WARN, 'no placement'),
        (estimate(placement(enclosure_m=UNBOUNDED)), Level.WARN, 'not bounded'),
    ],
)
def test_robot_status(made, level, text):
    found = status('robot b', made)
    assert found.level is level and text in found.message


@pytest.mark.parametrize(
    ('part', 'width_m', 'n_hypotheses', 'level', 'text'),
    [
        ('fleet', 1.0, 1, Level.WARN, 'one hypothesis, 6.2 m wide'),
        ('robot b', 1.0, 1, Level.WARN, 'one hypothesis, 6.2 m wide: within 5.97 m (guaranteed)'),
        ('robot a', 1.0, 1, Level.OK, 'localized'),
        ('fleet', 7.0, 1, Level.OK, 'localized'),
        # How wide each of several hypotheses is does not settle which is true.
        ('fleet', 1.0, 2, Level.WARN, 'ambiguous: 2 hypotheses'),
    ],
)
def test_only_narrow_enclosures_are_called_localized(part, width_m, n_hypotheses, level, text):
    wide = placement(enclosure_m=np.array([[[0.0] * 2, [0.5] * 2], [[0.0] * 2, [3.0, 6.16]]]))
    found = status(part, estimate(*[wide] * n_hypotheses), localized_width_m=width_m)
    assert found.level is level and found.message.startswith(text)


def test_robot_never_measured_is_not_called_stale():
    silent = input_state(accepted=0, in_use=False)
    for inputs, text in (
        ({}, 'never measured'),
        ({AB: silent}, 'never measured'),
        ({AB: input_state()}, 'stale'),
        # That it says where it drives, and how high it is, measures it from nowhere.
        ({key: input_state(key=key) for key in ALONE}, 'never measured'),
    ):
        found = status('robot b', estimate(placement(), links=()), inputs=inputs)
        assert found.level is Level.WARN and text in found.message


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


def test_conflicts_are_named():
    made = estimate(verdict=Verdict.INFEASIBLE, conflicts=((AB, BA),))
    assert status('fleet', made).values['conflict_0'] == 'range a->b (3.00 to 3.30 m), range b->a'
    assert status('robot a', made).level is Level.ERROR
    assert status('input range a->b', made).level is Level.ERROR


SILENT = Link('/uwb', 'sensor_msgs/msg/Range', AB, explicit=True)
MALFORMED = {'malformed': {'/a/range/b': Malformed(3, 'too short', 12.0)}}


@pytest.mark.parametrize(
    'state, changes, level, text',
    [
        (input_state(), {}, Level.OK, 'in use'),
        (input_state(in_use=False), {}, Level.WARN, 'stale'),
        (input_state(stuck='stuck: 9 readings'), {}, Level.WARN, 'stuck: 9 readings'),
        (input_state(restart='started anew: by a jump'), {}, Level.WARN, 'anew: by a jump'),
        (input_state(in_use=False, accepted=0, last_reason_text='NaN'), {}, Level.WARN, 'NaN'),
        (None, {'links': (SILENT,)}, Level.WARN, 'nothing received'),
        (None, MALFORMED, Level.WARN, 'malformed: too short'),
        (input_state(in_use=False, age_s=5.0), MALFORMED, Level.WARN, 'malformed: too short'),
        (input_state(in_use=False, age_s=0.5), MALFORMED, Level.WARN, 'stale'),
        (input_state(), {'rejecting': {AB: 'rejects 9 of 10'}}, Level.WARN, 'rejects 9 of 10'),
    ],
)
def test_input_status(state, changes, level, text):
    inputs = {} if state is None else {AB: state}
    found = status('input range a->b', estimate(), inputs=inputs, **changes)
    assert found.level is level and text in found.message


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


@pytest.mark.parametrize(('explicit', 'level'), [(False, Level.OK), (True, Level.WARN)])
def test_a_camera_that_sees_nothing_is_no_warning(explicit, level):
    ray = LinkKey(LinkKind.BEARING, 'a', 'b')
    inputs = {ray: input_state(key=ray, in_use=False)}
    links = (Link('/a/bearing/b', 'geometry_msgs/msg/Vector3Stamped', ray, explicit),)
    assert status('input bearing a->b', estimate(), links=links, inputs=inputs).level is level


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
    conflict = estimate(verdict=Verdict.INFEASIBLE, conflicts=((AB, BA),))
    assert status('input peers a', conflict, **changes).level is Level.ERROR
    assert status('input bearing a->b', conflict, **changes).level is Level.OK
    values = status('fleet', estimate(), **changes).values
    assert (values['inputs'], values['inputs_in_use']) == ('2', '1')
    # What was malformed is counted once.
    changes['malformed'] = {'/a/peers': Malformed(2, 'no peer')}
    assert status('input peers a', None, **changes).values['malformed'] == '2'
    assert 'malformed' not in status('input range a->b', None, **changes).values


def test_a_robot_is_told_its_typical_and_its_guaranteed_error_and_whom_it_hears():
    fitted = placement(covariances=np.tile(np.diag([0.01, 0.03, 1.0, 1.0, 1.0, 1.0]), (2, 1, 1)))
    links = (
        LinkState(AB, 3.0, 3.3, 0.1, stale=False),
        LinkState(LinkKey(LinkKind.RANGE, 'c/left', 'b'), 3.0, 3.3, 9.0, stale=True),
    )
    assert status('robot b', estimate(fitted, links=links)).message == (
        'localized: within 0.20 m (typical), within 0.28 m (guaranteed), 1 of 2 neighbours heard'
    )


def test_frames_are_named_after_what_they_are_tied_to():
    names = [
        frame_id(frame, 'hall')
        for frame in (
            FixedFrame(FrameKind.ANCHORS, ('p', 'q')),
            FixedFrame(FrameKind.ODOMETRY, ('b',), 'b/odom'),
            FixedFrame(FrameKind.HEADING, ('b',)),
            FixedFrame(FrameKind.ROBOTS, ('a', 'b')),
            None,
        )
    ]
    assert names == ['hall', 'b/odom', 'b/base_link', 'fleet', 'hall']


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


def test_the_diagnostics_say_what_is_rigid_and_what_would_fix_the_rest():
    made = estimate(
        placement(), rigid_groups=(('a', 'b'), ('b', 'c')), would_fix=('range a - c',) * 50
    )
    values = status('fleet', replace(made, ruled_out=('mirror image by range a->b',))).values
    assert values['ruled_out'] == 'mirror image by range a->b'
    assert values['rigid_groups'] == 'a, b; b, c'
    assert values['would_fix'].startswith('range a - c; range a - c')
    assert len(values['would_fix']) == 300


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
