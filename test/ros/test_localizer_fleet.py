# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `localizer` as a process, driven over DDS with the paper's fleet."""

import math
import signal

from estimates import half_widths_of, pose_from_message
import numpy as np
from processes import LocalizerProcess
import pytest

from benchmarks.problems import fleet_placements
from dg_localization.fleet.rotations import yaw_of
from msg_adapters import Level

CONFIG = 'config/paper_fleet.yaml'
# Ranges known to 1 %, so that the eight solutions are far apart.
SHARP = (
    *('-p', 'covariance:=enclosure'),
    *('-p', 'range.min_error_relative:=-0.01'),
    *('-p', 'range.max_error_relative:=0.01'),
    *('-p', 'bearing.half_width:=0.02'),
    *('-p', 'max_speed:=0.05'),
    *('-p', 'max_turn_rate:=0.05'),
)
REFERENCE = 1


@pytest.fixture(scope='module')
def process(bench, tmp_path_factory):
    log = tmp_path_factory.mktemp('localizer') / 'log'
    process = LocalizerProcess(log, '--params-file', CONFIG, *SHARP)
    bench.until_status('fleet', Level.WARN, 'no usable measurement', deadline_s=60.0)
    yield process
    process.stop()


@pytest.fixture
def fresh(bench, process):
    """One localizer for all tests of this module, which remembers nothing."""
    bench.forget()
    return bench


def gaps_m(positions_m):
    return np.linalg.norm(positions_m[:, None] - positions_m[None, :], axis=-1)


def hypotheses(bench):
    """Return the newest positions as (hypothesis, robot, 3)."""
    return bench.last_poses().positions_m.reshape(-1, 6, 3)


def until_nothing_is_left(bench):
    """Wait until every latched topic is empty: no subscriber gets an old answer."""

    def is_empty():
        arrays = [bench.heard.fleet, *bench.heard.robots.values()]
        cleared = bench.heard.markers and len(bench.heard.markers[-1].markers) == 1  # DELETEALL
        return cleared and all(heard and not heard[-1].poses for heard in arrays)

    bench.until(is_empty, 'empty arrays and a cleared view')


def test_ranges_alone_give_the_eight_solutions_and_their_mirror_images(fresh, paper_fleet):
    fresh.play(paper_fleet, cameras=False)
    status = fresh.until_status('fleet', Level.WARN, 'ambiguous: 16 hypotheses')
    assert status.values['hypotheses_proved'] == '16'
    assert {'intake_s', 'memory_s', 'moment_s', 'narrow_and_fit_s'} <= status.values.keys()
    # Before all pairs had measured, the fleet was another one.
    fresh.clear()
    fresh.until_placements(16, robots=6)
    found = [gaps_m(positions) for positions in hypotheses(fresh)]
    for solution in map(gaps_m, fleet_placements()):
        errors = [np.abs(gaps - solution).max() for gaps in found]
        # Ranges off by 1 % move a robot at the far end of two triangles by several times that.
        assert sum(error < 0.8 for error in errors) == 2, errors
    assert not any(fresh.heard.poses.values())


def test_cameras_leave_the_true_placement_only(fresh, paper_fleet):
    fresh.play(paper_fleet, cameras=True)
    fresh.until_status('fleet', Level.OK, 'one hypothesis')
    fresh.clear()

    def poses():
        return [[pose_from_message(x) for x in heard] for heard in fresh.heard.poses.values()]

    def narrow(pose):
        half_widths = half_widths_of(pose)
        return half_widths[:2].max() < 1.0 and half_widths[5] < 0.5

    # An answer of a busy machine may be coarser than the next one.
    fresh.until(lambda: all(any(map(narrow, heard)) for heard in poses()), 'a narrow pose of each')
    places_m, yaws_rad = paper_fleet.in_frame_of(REFERENCE)
    for place_m, yaw_rad, heard in zip(places_m, yaws_rad, poses(), strict=True):
        for pose in heard:
            half_widths = half_widths_of(pose)
            assert (np.abs(pose.position_xyz[:2] - place_m) <= half_widths[:2] + 1e-9).all()
            turn_rad = math.remainder(yaw_of(pose.orientation_xyzw) - yaw_rad, math.tau)
            assert abs(turn_rad) <= half_widths[5] + 1e-9
            assert half_widths[2:5] == pytest.approx(1e-3)
    assert fresh.until_status('robot robot_4', Level.OK, 'localized')


def test_contradiction_empties_everything_and_heals(fresh, paper_fleet):
    fresh.play(paper_fleet, cameras=False)
    fresh.until(lambda: fresh.heard.fleet and fresh.heard.fleet[-1].poses, 'placements')
    # Triangle 1-2-3 cannot close: the sides are 7.3, 6.4 and four times 7.6 m.
    fresh.play(paper_fleet, cameras=False, stretch={(0, 1): 4.0})
    fresh.until_status('fleet', Level.ERROR, 'contradiction')
    until_nothing_is_left(fresh)
    fresh.until_status('input range robot_1->robot_2', Level.ERROR, 'contradicts')
    fresh.until_status('robot robot_1', Level.ERROR, 'contradict')
    assert 'range robot_1->robot_2' in fresh.status('fleet').values['conflict_0']
    fresh.play(paper_fleet, cameras=False)
    fresh.until_status('fleet', Level.WARN, 'ambiguous')
    fresh.until(lambda: fresh.heard.fleet[-1].poses, 'placements again')


def test_silence_leaves_no_stale_answer(fresh, paper_fleet):
    fresh.play(paper_fleet, cameras=True)
    fresh.until_status('fleet', Level.OK)
    fresh.sending = []
    fresh.until_status('fleet', Level.WARN, 'stale')
    fresh.until_status('input range robot_1->robot_2', Level.WARN, 'stale')
    until_nothing_is_left(fresh)


def test_a_signal_ends_a_working_node_cleanly(fresh, process, paper_fleet):
    """Leave this the last test: it ends the localizer of the module."""
    fresh.play(paper_fleet, cameras=False)
    fresh.until(lambda: fresh.heard.fleet and fresh.heard.fleet[-1].poses, 'placements')
    fresh.sending = []
    code, output = process.stop(signal.SIGTERM)
    assert code == 0 and 'Traceback' not in output, output
    # Nothing is left on a screen.
    until_nothing_is_left(fresh)
