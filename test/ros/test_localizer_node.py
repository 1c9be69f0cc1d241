# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The node: lifecycle, time, parameters from files, failures, and faults of others."""

from functools import partial
import signal
import sys
from threading import Event
import time
from types import ModuleType
from unittest.mock import Mock

from builtin_interfaces.msg import Time
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import numpy as np
import pytest
import rclpy
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger

from dg_localization.fleet import Localizer
from dg_localization.ros.node import worker
from msg_adapters import Level

DEADLINE_S = 60.0


def test_managed_node_waits_to_be_told(bench, make_node):
    node = make_node(autostart=False)
    bench.until_status('fleet', Level.WARN, 'the node is unconfigured')
    assert bench.state() == 'unconfigured'
    # A transition of another state is answered as well: lifecycle managers wait for that.
    wrong = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE))
    assert not bench.call('/localizer/change_state', ChangeState, wrong).success
    assert bench.transition('configure')
    assert bench.state() == 'inactive'
    bench.until_status('fleet', Level.WARN, 'the node is inactive')
    assert node.count_subscribers('/robot_1/range/robot_2') == 0
    assert bench.transition('activate')
    assert not bench.call('/localizer/change_state', ChangeState, wrong).success
    bench.play_triangle()
    bench.until_placements(2)
    assert bench.transition('deactivate')
    bench.until(lambda: not bench.heard.fleet[-1].poses, 'an empty array')
    assert node.count_subscribers('/robot_1/range/robot_2') == 0
    assert bench.transition('activate')
    bench.until_placements(2)
    assert bench.transition('deactivate') and bench.transition('cleanup')
    assert bench.state() == 'unconfigured'
    assert node.count_publishers('/localizer/feasible_poses') == 0
    assert bench.transition('configure') and bench.transition('activate')
    bench.until_placements(2)
    assert bench.transition('shutdown')
    assert bench.state() == 'finalized'
    bench.until_status('fleet', Level.WARN, 'the node is finalized')
    assert not bench.heard.fleet[-1].poses


def play_with_clock(bench):
    """Keep sending a simulated clock, and the ranges of three robots; return the clock."""
    clock = {'s': 1000.0}

    def send():
        clock['s'] += 0.1
        bench.send_clock(clock['s'])
        bench.send_triangle(stamp_s=clock['s'])

    bench.sending = [send]
    return clock


def test_what_becomes_of_the_fleet_is_in_the_log(bench, make_node, monkeypatch):
    node = make_node(use_sim_time=True, max_future=0.5)
    logged, logger = [], node.get_logger()
    monkeypatch.setattr(logger, 'warning', lambda text, **_: logged.append(text))
    monkeypatch.setattr(logger, 'info', lambda text, **_: logged.append(text))

    def lines(beginning):
        return [text for text in logged if text.startswith(beginning)]

    silent = 'fleet: use_sim_time is set and nothing has arrived on /clock'
    bench.until(lambda: lines(silent), 'a line about the clock')
    clock = play_with_clock(bench)
    bench.until(lambda: lines('fleet: ambiguous: '), 'a line about the fleet')
    assert len(lines(silent)) == 1
    ray = 'robot_1', 'robot_2', np.array([1.0, 0.0, 0.0])
    bench.sending.append(lambda: bench.send_bearing(*ray, stamp_s=clock['s']))
    bench.until(lambda: lines('the frame has changed: '), 'a line about the frame')


def test_simulated_time_jumps_back_and_everything_is_forgotten(bench, make_node):
    make_node(use_sim_time=True, max_future=0.5)
    bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock')
    clock = play_with_clock(bench)
    bench.until_placements(2)
    bench.until_count('input range robot_1->robot_2', 'accepted')
    bench.clear()
    clock['s'] = 10.0
    bench.until(lambda: any(not array.poses for array in bench.heard.fleet), 'an empty array')
    bench.until_placements(2)
    assert 10 <= bench.heard.fleet[-1].header.stamp.sec < 100
    bench.until_count('input range robot_1->robot_2', 'accepted')


def test_answer_that_ends_after_the_clock_went_back_is_not_published(bench, make_node):
    """Its stamp lies ahead of the clock: it would look newest for the length of the bag."""
    answered = Event()

    class Slow(Localizer):
        def estimate(self, snapshot, cancel=None):
            estimate = super().estimate(snapshot, cancel)
            if estimate.placements:
                answered.set()
                # At once, before anything else of the node looks at the clock.
                end_s = time.monotonic() + DEADLINE_S
                while node._clock_s() > 100.0 and time.monotonic() < end_s:
                    time.sleep(1e-4)
            return estimate

    node = make_node(make_localizer=Slow, use_sim_time=True, max_future=0.5)
    bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock')
    play_with_clock(bench)
    bench.until(answered.is_set, 'an estimate')
    bench.sending = []
    end_s = time.monotonic() + 0.5
    bench.until(lambda: time.monotonic() > end_s, 'the end of what is on its way')
    bench.clear()
    # The bag starts again, and its sensors are silent at first.
    bench.send_clock(10.0)
    bench.until(lambda: bench.heard.fleet, 'an array')
    assert all(not array.poses for array in bench.heard.fleet)


def after(first):
    """Return a class of localizers that call a function with what may cancel an estimate first."""

    class Later(Localizer):
        def estimate(self, snapshot, cancel=None):
            first(cancel)
            return super().estimate(snapshot, cancel)

    return Later


def no_idea(*_):
    raise ArithmeticError('no idea')


def test_defect_of_the_estimate_is_an_error_and_no_answer(bench, make_node):
    first = Mock()
    make_node(make_localizer=after(first))
    bench.play_triangle()
    bench.until_placements(2)
    first.side_effect = no_idea
    bench.until_status('fleet', Level.ERROR, 'internal error: ArithmeticError: no idea')
    bench.until(lambda: not bench.heard.fleet[-1].poses, 'an empty array')
    first.side_effect = None
    bench.until_status('fleet', Level.WARN, 'ambiguous')


def test_solver_is_warmed_up_before_anything_else_and_says_so(bench, make_node, monkeypatch):
    release, logged = Event(), []
    node = make_node(load=lambda: release.wait(DEADLINE_S))
    monkeypatch.setattr(node.get_logger(), 'info', lambda text, **_: logged.append(text))
    bench.play_triangle()
    bench.until_status('fleet', Level.WARN, 'the solver')
    bench.until_status('robot robot_1', Level.WARN, 'the solver')
    bench.until_status('input range robot_1->robot_2', Level.OK)
    assert bench.call('/localizer/reset', Trigger).success
    bench.until_status('input range robot_1->robot_2', Level.OK)
    release.set()
    bench.until_placements(2)
    bench.until_status('fleet', Level.WARN, 'ambiguous')
    assert any('the solver is ready after' in text for text in logged)


def test_slow_solver_is_logged_once_and_shown_for_as_long(bench, start_localizer, monkeypatch):
    monkeypatch.setenv('NUMBA_DISABLE_JIT', '1')
    bench.clear()
    process = start_localizer('-p', "robots:=['a', 'b', 'c']")
    bench.until_status('fleet', Level.WARN, 'the solver runs in Python')
    bench.until(lambda: 'the solver is ready' in process.output(), 'the end of the warm-up')
    bench.until_status('fleet', Level.WARN, 'the solver runs in Python')
    _, output = process.stop(signal.SIGINT)
    assert output.count('[WARN]') >= 1 and 'more than 100 times slower' in output
    assert 'compil' not in output.replace('slower than compiled', '')


def test_defect_of_the_warm_up_is_logged_and_no_more(bench, make_node):
    make_node(load=no_idea)
    bench.play_triangle()
    bench.until_placements(2)


def test_what_waits_at_a_reset_does_not_count_after_it(bench, make_node):
    node = make_node()
    bench.play_triangle()
    bench.until_placements(2)
    bench.sending = []
    bench.send_triangle()
    # Nothing spins meanwhile: as where the node publishes for long, messages wait to be taken.
    time.sleep(0.3)
    # A reset that is called over DDS may come before these messages or after them.
    assert node._on_reset(Trigger.Request(), Trigger.Response()).success
    bench.clear()
    bench.until(lambda: len(bench.heard.fleet) > 4, 'answers')
    assert all(not array.poses for array in bench.heard.fleet)
    bench.until_status('fleet', Level.WARN, 'no usable measurement has arrived yet')


def test_running_estimate_is_cancelled_by_a_reset(bench, make_node):
    cancels = []

    def linger(cancel):
        cancels.append(cancel)
        cancel.wait(timeout=30.0)

    make_node(make_localizer=after(linger))
    bench.until(lambda: cancels, 'a running estimate')
    first = cancels[0]
    assert not first.is_set()
    bench.call('/localizer/reset', Trigger)
    assert first.is_set()
    bench.until(lambda: len(cancels) > 1, 'the next estimate')


def test_parameters_come_from_a_file_and_have_the_types_of_the_table(make_node):
    anchor = {'anchors__names': ['p'], 'anchors__p__position': [0.0, 0.0]}
    node = make_node('--params-file', 'config/tiers_uwb.yaml', rate=7, **anchor)
    assert node.settings.rate_hz == 7.0
    assert not node.settings.use_header_stamp
    assert node.settings.fleet.range_error.max_error_m == 1.3
    described = node.describe_parameter('rate')
    assert described.description == 'how often the fleet is localized (Hz)'
    assert described.floating_point_range[0].to_value == 1000.0
    assert len(node.get_parameter('links').value) == 6
    # Of lists also where they are empty.
    texts = dict.fromkeys(('links', 'robots', 'adapter_modules'), Parameter.Type.STRING_ARRAY)
    for name, kind in {**texts, 'anchors.p.position': Parameter.Type.DOUBLE_ARRAY}.items():
        described = node.describe_parameter(name)
        assert (described.type, described.dynamic_typing) == (kind.value, False)
        assert node.get_parameter(name).type_ is kind


def test_bounds_and_rates_that_are_set_take_effect_at_once(bench, make_node):
    node = make_node()
    bench.play_triangle()
    bench.until_placements(2)
    given = Parameter('rate', value=20.0), Parameter('range.max_error', value=0.5)
    assert all(result.successful for result in node.set_parameters([*given]))
    assert node.settings.rate_hz == 20.0 and node.settings.fleet.range_error.max_error_m == 0.5
    bench.clear()
    bench.until_placements(2)
    lower_m = node._localizer.snapshot(bench.now_s()).distances[0].lower_m
    assert lower_m < 2.5
    assert node.set_parameters([Parameter('max_outliers', value=1)])[0].successful
    assert node._localizer.config.max_outliers == 1
    narrower = {'range.max_error': 0.4, 'memory.seconds': 9.0, 'odometry.translation_per_m': 0.0}
    wider = {'odometry.translation_per_m': 0.2}
    for values, is_kept in ((narrower, True), (wider, False)):
        changes = [Parameter(name, value=value) for name, value in values.items()]
        assert all(result.successful for result in node.set_parameters(changes))
        assert bool(node._localizer.snapshot(bench.now_s()).links) == is_kept


@pytest.mark.parametrize(
    ('name', 'value', 'wanted'),
    [
        ('range.max_error', -2.0, 'range.min_error: 0.0 is not allowed, it must be at most'),
        ('use_sim_time', True, 'only when the node starts'),
    ],
)
def test_wrong_values_that_are_set_are_refused_as_at_start(make_node, name, value, wanted):
    node = make_node()
    before = node.settings
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful and wanted in result.reason
    assert node.settings is before


def test_another_fleet_is_that_of_the_next_configuration(bench, make_node):
    node = make_node()
    assert node.set_parameters([Parameter('robots', value=['robot_1', 'robot_9'])])[0].successful
    assert node.settings.fleet.robots == ('robot_1', 'robot_2', 'robot_3')
    for name in ('deactivate', 'cleanup', 'configure', 'activate'):
        assert bench.transition(name)
    assert node.settings.fleet.robots == ('robot_1', 'robot_9')
    assert node.has_parameter('robot_max_speed.robot_9')
    bench.until_status('robot robot_9', Level.WARN, '')


def test_signal_while_starting_ends_cleanly(bench, start_localizer):
    process = start_localizer('-p', "robots:=['a', 'b', 'c']")
    # The line is written while the topics are still being made.
    bench.until(lambda: 'the solver' in process.output(), 'the first line of the log')
    code, output = process.stop(signal.SIGHUP)
    assert (code, 'Traceback' in output) == (0, False), output


@pytest.mark.parametrize(('number', 'pause_s'), [(signal.SIGINT, None), (signal.SIGTERM, 0.5)])
def test_signal_while_compiling_ends_cleanly(
    bench, start_localizer, tmp_path, monkeypatch, number, pause_s
):
    pytest.importorskip('numba', reason='numba is not installed')
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path))
    process = start_localizer('-p', "robots:=['a', 'b', 'c']")
    bench.until(lambda: 'compiling the solver' in process.output(), 'compilation')
    if pause_s is not None:
        # The first one waits for 2 s, the second one for nothing, not for the compiler either.
        process.process.send_signal(number)
        time.sleep(pause_s)
    code, output = process.stop(number)
    assert (code, 'Traceback' in output) == (0, False), output
    assert 'the solver is ready' not in output


def test_solver_that_hangs_is_reported_and_comes_back(bench, make_node, monkeypatch):
    # Long enough for several diagnostics that say that the answer is late.
    monkeypatch.setattr(worker, 'PATIENCE_S', 1.0)
    release, hanging = Event(), Event()

    def hang(_):
        first.side_effect = None
        hanging.set()
        assert release.wait(DEADLINE_S)

    first = Mock()
    make_node(make_localizer=after(first))
    bench.play_triangle()
    bench.until_placements(2)
    first.side_effect = hang
    bench.until(hanging.is_set, 'an estimate that hangs')
    bench.clear()
    bench.until_status('fleet', Level.WARN, 'late: the last answer is')
    bench.until_status('robot robot_1', Level.WARN, 'late: the last answer is')
    bench.until_status('fleet', Level.ERROR, 'no answer for')
    assert not bench.heard.fleet[0].poses, 'the last answer is taken back'
    release.set()
    bench.until_placements(2)
    bench.until_status('fleet', Level.WARN, 'ambiguous')


def test_after_a_backlog_what_is_taken_is_young_enough(bench, make_node):
    node = make_node(robots=['robot_1', 'robot_2'], max_age=1.6)
    bench.sending = [partial(bench.send_range, 'robot_1', 'robot_2', 3.0)]
    bench.until_count('input range robot_1->robot_2', 'accepted')
    bench.forget()
    bench.executor.remove_node(node)
    # The executor of the node gets no processor for three seconds, at 10 Hz.
    for _ in range(30):
        bench.send_range('robot_1', 'robot_2', 3.0)
        time.sleep(0.1)
    bench.executor.add_node(node)
    bench.clear()
    values = dict(bench.until_count('input range robot_1->robot_2', 'accepted'))
    assert not int(values.get('rejected_too_old', '0')), values


def test_negative_time_on_the_clock_does_not_end_the_node(bench, start_localizer):
    bench.clear()
    process = start_localizer('-p', "robots:=['robot_1', 'robot_2']", '-p', 'use_sim_time:=true')
    clock = bench.publisher(Clock, '/clock')
    bench.until_status('fleet', Level.WARN, 'nothing has arrived on /clock')
    bench.sending = [partial(clock.publish, Clock(clock=Time(sec=-1)))]
    bench.until(lambda: 'must not be negative' in process.output(), 'a word about it')
    bench.sending = [partial(bench.send_clock, 100.0)]
    bench.until_status('fleet', Level.WARN, 'time has stood still')
    bench.sending = []
    assert process.process.poll() is None
    code, output = process.stop()
    assert code == 0 and output.count('a callback failed') == 1


def test_stranger_of_another_type_does_not_silence_an_input(bench, make_node, node):
    publisher = node.create_publisher(String, '/robot_1/range/robot_2', 10)
    make_node()
    name = 'input range robot_1->robot_2'
    status = bench.until_status(name, Level.WARN, 'wrong type')
    assert 'std_msgs/msg/String' in status.message and 'sensor_msgs/msg/Range' in status.message
    node.destroy_publisher(publisher)
    bench.sending = [partial(bench.send_range, 'robot_1', 'robot_2', 3.0)]
    bench.until_status(name, Level.OK, 'in use')


def test_many_resets_do_not_flood_the_log(bench, make_node, capfd):
    make_node()
    capfd.readouterr()
    for _ in range(10):
        assert bench.call('/localizer/reset', Trigger).success
    assert capfd.readouterr().err.count('reset: all measurements are forgotten') in range(1, 5)


def test_second_node_of_the_same_name_is_reported(bench, make_node):
    make_node()
    namesake = rclpy.create_node('localizer', context=bench.context)
    bench.until_status('fleet', Level.WARN, 'another node has the same name')
    namesake.destroy_node()


def test_bond_with_the_manager_is_formed_while_active(bench, make_node, monkeypatch):
    bond = Mock()
    for name in ('bondpy', 'bondpy.bondpy'):
        module = ModuleType(name)
        module.__spec__, module.__path__, module.Bond = object(), [], bond
        monkeypatch.setitem(sys.modules, name, module)
    make_node(autostart=False)
    assert bench.transition('configure') and not bond.called
    assert bench.transition('activate')
    assert bond.call_args.args[:2] == ('bond', 'localizer')
    assert bench.transition('deactivate')
    calls = [name for name, *_ in bond.return_value.method_calls]
    assert calls == ['start', 'break_bond', 'shutdown']


def test_managed_node_without_bondpy_names_the_setting(bench, make_node, monkeypatch):
    logged = []
    node = make_node(autostart=False)
    monkeypatch.setattr(node.get_logger(), 'info', lambda text, **_: logged.append(text))
    assert bench.transition('configure') and bench.transition('activate')
    assert any('bond_timeout: 0.0' in text for text in logged)
