# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The managed node `localizer`, which publishes every feasible placement of a fleet.

It converts messages, calls the ROS-free `Localizer`, and publishes its answers. Measurements are
taken on the thread of the executor; their newest snapshot is answered on a separate thread.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
import math
from threading import Event
import time
import traceback
from typing import Any, NamedTuple

from rclpy.lifecycle import TransitionCallbackReturn
from std_srvs.srv import Trigger

from dg_localization.fleet import (
    Estimate,
    FleetConfig,
    LinkKind,
    Localizer,
    Snapshot,
    solver_warnings,
    warm_up,
    warm_up_status,
)
from dg_localization.fleet.motion import Motion
from dg_localization.ros.interface.diagnostics import Report, statuses
from dg_localization.ros.interface.intake import Intake, shortened
from dg_localization.ros.interface.links import Link
from dg_localization.ros.interface.outputs import (
    DIAGNOSTICS,
    TRANSFORM_TOPIC,
    DiagnosticsStream,
    Publishers,
    estimate_messages,
    estimate_outputs,
    transform_output,
)
from dg_localization.ros.interface.parameters.settings import Settings, declare_settings
from dg_localization.ros.interface.poses import transforms
from dg_localization.ros.node import worker
from dg_localization.ros.node.clock import NodeTime, Pace, RateMeter
from dg_localization.ros.node.inputs import Inputs
from dg_localization.ros.node.lifecycle import FleetLog, LiveParameters, ManagedNode, transition
from dg_localization.ros.node.worker import EstimateWorker, exit_code_despite_worker, load_for_good
from dg_localization.ros.spinning import BATCH_S, STEADY, at_most_every, spin
from msg_adapters import Diagnostics
from msg_adapters.poses import transforms_to_cdr

USAGE = 'usage: localizer --ros-args --params-file FILE [-p NAME:=VALUE] [-r FROM:=TO]'
DIAGNOSTICS_PERIOD_S = 1.0
DISCOVERY_PERIOD_S = 0.25
RESET = '~/reset'
REPEATED_PROGRESS_S = 10.0
CLOCK = '/clock'


class TimedEstimate(NamedTuple):
    """An estimate, its serialized messages, the motion of its snapshot, and its times."""

    estimate: Estimate
    messages: tuple[tuple[str, bytes], ...]
    motion: Motion | None = None
    estimate_s: float = 0.0
    messages_s: float = 0.0


class LocalizerNode(ManagedNode):
    """
    The node; an unknown or wrong parameter raises `WrongParameterError`.

    `make_localizer` makes the localizer of a fleet, and the thread of the worker calls `load`
    before the first answer. Other arguments go to `rclpy.node.Node`.
    """

    _outputs: Publishers
    _worker: EstimateWorker[TimedEstimate]

    def __init__(
        self,
        make_localizer: Callable[[FleetConfig], Localizer] = Localizer,
        load: Callable[[], None] = warm_up,
        **kwargs: Any,
    ) -> None:
        super().__init__('localizer', **kwargs)
        self._load = load
        self._make_localizer = make_localizer
        self._is_simulated = bool(self.get_parameter('use_sim_time').value)
        self._adopt(declare_settings(self))
        if self.settings.publish_tf:
            transform_output()
        self._failure = ''
        self._transforms_s = -math.inf
        self._intake_s = 0.0
        self._seconds: dict[str, float] = {}
        self._has_namesake = False
        self._is_due = False
        self._inputs: Inputs | None = None
        self._time = NodeTime(self._clock_s, self._is_simulated)
        self._diagnostics = Publishers(self, [DIAGNOSTICS])
        self._stream = DiagnosticsStream()
        self._fleet_log = FleetLog(self.get_logger())
        # The node's own time stands still while a simulation pauses; the diagnostics must not.
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._on_second, clock=STEADY)
        self._live = LiveParameters(self, self._apply)
        if self.settings.autostart:
            if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
                self.trigger_activate()

    @transition
    def on_configure(self) -> None:
        """Make the outputs, the reset service and the worker, without inputs."""
        made = self._made_to_configure
        self._adopt(self._live.at_configure())
        outputs = [*estimate_outputs(self.settings.fleet.robots)]
        if self.settings.publish_tf:
            outputs.append(transform_output())
        self._outputs = Publishers(self, outputs)
        made.callback(self._outputs.destroy)
        answer_ready = self.create_guard_condition(self._on_answer)
        made.callback(self.destroy_guard_condition, answer_ready)
        on_warm = partial(self._on_warm, time.monotonic())
        self._worker = EstimateWorker(self._answer, answer_ready.trigger, self._load)
        self._worker.warm_up.add_done_callback(on_warm)
        made.callback(self._worker.close)
        for warning in solver_warnings():
            self.get_logger().warning(warning)
        service = self.create_service(Trigger, RESET, self._on_reset)
        made.callback(self.destroy_service, service)
        self._state = 'inactive'

    @transition
    def on_activate(self) -> None:
        """Start receiving, and localize at the given rate."""
        made = self._made_to_activate
        made.callback(self._forget, 'deactivated')
        if not self.settings.autostart:
            self._bond_with_manager()
        self._inputs = Inputs(self, self.settings, self._on_message)
        made.callback(self._inputs.destroy)
        self._start_ticker()
        made.callback(lambda: self.destroy_timer(self._ticker))
        searcher = self.create_timer(DISCOVERY_PERIOD_S, self._inputs.search, clock=STEADY)
        made.callback(self.destroy_timer, searcher)
        self._state = 'active'

    def _start_ticker(self) -> None:
        # The system clock may be set back by hours, and its timers would be silent for so long.
        clock, period_s = None if self._is_simulated else STEADY, 1.0 / self.settings.rate_hz
        self._ticker = self.create_timer(period_s, self._on_tick, clock=clock)

    def _adopt(self, settings: Settings) -> None:
        """Adopt the settings of a new fleet."""
        self.settings = settings
        self._localizer = self._make_localizer(settings.fleet)
        args = self._localizer, settings.use_header_stamp, settings.ids, self._is_simulated
        self._intake = Intake(*args)
        self._estimate: Estimate | None = None
        self._keep_pace()

    def _keep_pace(self) -> None:
        rate_hz, fleet = self.settings.rate_hz, self.settings.fleet
        self._rate, self._pace = RateMeter(rate_hz), Pace(rate_hz, fleet.solver.tighten_seconds)
        # The sum of its limits.
        self._longest_estimate_s = fleet.solver.max_seconds + fleet.memory_max_seconds
        self._longest_estimate_s += fleet.max_conflict_seconds

    def _apply(self, settings: Settings) -> None:
        """Apply changed settings of the same fleet."""
        before, self.settings = self.settings, settings
        self._keep_pace()
        if self._state == 'active' and settings.rate_hz != before.rate_hz:
            self.destroy_timer(self._ticker)
            self._start_ticker()
        was, now = before.fleet.sensor_bounds, settings.fleet.sensor_bounds
        # With overrides, bounds of a link may become wider where those of the fleet do not.
        narrower = all(
            x.bounds_within(now).are_within(x.bounds_within(was)) for x in settings.links
        )
        is_kept = self._localizer.configure(settings.fleet) and narrower
        if not is_kept and self._state in ('inactive', 'active'):
            self._forget('parameters have changed')

    def _on_message(self, link: Link, data: bytes, waited_s: float) -> None:
        """Take one measurement; a wrong one is counted and raises nothing."""
        now_s = self._now_s()
        arrived_s = self._time.arrived_s(waited_s)
        if link.key.kind is LinkKind.CAMERA:
            # A matrix has no age, and a latched one does not come again.
            now_s, arrived_s = now_s or 0.0, 0.0
        if now_s is None or arrived_s is None:
            return
        began_s = time.monotonic()
        rejection = self._intake.take(link, data, now_s, arrived_s)
        self._intake_s += time.monotonic() - began_s
        if rejection is not None:
            self.get_logger().warning(shortened(f'{link.topic}: {rejection}'), **at_most_every())
        if self._worker.busy_s > self._longest_estimate_s:
            # Where more messages arrive than can be taken, the estimate still gets the interpreter
            # for as long as each message took, or as one may wait.
            time.sleep(min(BATCH_S, time.monotonic() - began_s))

    def _on_tick(self) -> None:
        """Submit the newest measurements, once the worker is done with older ones."""
        now_s = self._now_s()
        if now_s is None or not self._worker.warm_up.done():
            return
        self._is_due = self._worker.busy
        if not self._is_due:
            answer_s = self._localizer.answer_time(now_s)
            self._worker.submit(self._localizer.snapshot(answer_s, self._pace.tighten_s))
            self._rate.count(now_s)

    def _answer(self, snapshot: Snapshot, cancel: Event) -> TimedEstimate:
        """Answer a snapshot and make its messages, in the thread of the worker."""
        began_s = time.perf_counter()
        estimate = self._localizer.estimate(snapshot, cancel)
        ended_s = time.perf_counter()
        messages = tuple(estimate_messages(estimate, self.settings))
        spent_s = ended_s - began_s, time.perf_counter() - ended_s
        return TimedEstimate(estimate, messages, snapshot.motion, *spent_s)

    def _on_warm(self, began_s: float, warm_up: Future[Any]) -> None:
        """Log the duration of the warm-up, in the thread of the worker."""
        took_s = time.monotonic() - began_s
        error = warm_up.exception()
        if error is None:
            self.get_logger().info(f'the solver is ready after {took_s:.1f} s')
        else:
            # The estimates will fail too, and the diagnostics will report it.
            self.get_logger().error(f'the warm-up of the solver failed: {error!r}')

    def _on_answer(self) -> None:
        """Publish the answer of the worker, unless time has jumped back since its submission."""
        self._now_s()
        took_s = self._worker.busy_s
        try:
            answer = self._worker.take()
        except Exception as error:  # a defect of ours: say so instead of showing an old answer
            self.get_logger().error(
                f'the estimate failed:\n{traceback.format_exc()}',
                **at_most_every(),
            )
            self._fail(shortened(f'internal error: {type(error).__name__}: {error}'))
            return
        if answer is not None:
            self._pace.note(took_s)
            self._failure = ''
            self._publish(answer)
            if self._is_due:
                # Waiting for the next tick would halve the rate where estimates are a little late.
                self._on_tick()

    def _publish(self, answer: TimedEstimate) -> None:
        self._estimate = answer.estimate
        if answer.estimate.frame_change:
            self.get_logger().warning(answer.estimate.frame_change, **at_most_every())
        began_s = time.perf_counter()
        self._outputs.publish(answer.messages)
        self._seconds = {
            'intake_s': self._intake_s,
            **answer.estimate.seconds,
            'estimate_s': answer.estimate_s,
            'publish_s': answer.messages_s + time.perf_counter() - began_s,
        }
        self._intake_s = 0.0
        # tf2 warns of transforms with a repeated time, and drops them.
        is_new = answer.estimate.stamp_s != self._transforms_s
        if self.settings.publish_tf and is_new and answer.motion is not None:
            self._publish_transforms(answer.estimate, answer.motion)
        self._diagnostics.publish(self._stream.messages(self._diagnose(), is_regular=False))

    def _publish_transforms(self, estimate: Estimate, motion: Motion) -> None:
        """Publish the transforms of the robots, if there are any."""
        links = self._inputs.links if self._inputs is not None else ()
        awaited = {link.key.observer for link in links if link.key.kind is LinkKind.ODOMETRY}
        found = transforms(
            estimate, self.settings.fixed_frame, motion, self._intake.bodies, awaited
        )
        if found:
            self._transforms_s = estimate.stamp_s
            self._outputs.publish([(TRANSFORM_TOPIC, transforms_to_cdr(found))])

    def _fail(self, reason: str) -> None:
        """Withdraw the last answer because of an internal error."""
        self._failure = reason
        self._publish(self._no_estimate(reason))

    def _on_second(self) -> None:
        """Check the worker, the clock and the graph, and publish the diagnostics."""
        if self._state == 'active':
            self._now_s()
            if self._worker.busy_s > worker.patience_s(self._longest_estimate_s):
                self._give_up_estimate()
        diagnostics = self._diagnose()
        if self._state in ('inactive', 'active') and not self._worker.warm_up.done():
            self.get_logger().info(warm_up_status(), **at_most_every(REPEATED_PROGRESS_S))
        elif self._state == 'active':
            self._fleet_log.look(diagnostics.statuses[0])
        self._diagnostics.publish(self._stream.messages(diagnostics))
        # Last, since names of other nodes may raise, which must not block the rest.
        own_name = (self.get_name(), self.get_namespace())
        self._has_namesake = self.get_node_names_and_namespaces().count(own_name) > 1

    def _give_up_estimate(self) -> None:
        """Withdraw the last answer; a new estimate begins when this one has ended."""
        reason = f'no answer for {self._worker.busy_s:.1f} s: if this lasts, start the node anew'
        self._worker.cancel()
        self.get_logger().error(reason)
        self._fail(reason)

    def _diagnose(self) -> Diagnostics:
        now_s = self._clock_s()
        report = Report(
            node=self.get_fully_qualified_name().lstrip('/'),
            settings=self.settings,
            now_s=now_s,
            estimate=self._estimate,
            trouble=self._trouble(now_s),
            failure=self._failure,
            warnings=(*solver_warnings(), *self._warnings()),
            rate_hz=self._rate.rate_hz(now_s),
            links=self._inputs.links if self._inputs else (),
            inputs=self._intake.states(now_s),
            malformed=self._intake.malformed,
            wrong_types=self._inputs.finder.wrong_types if self._inputs else {},
            rejecting=self._intake.rejecting(now_s),
            seconds=self._seconds,
        )
        return Diagnostics(now_s, statuses(report))

    def _trouble(self, now_s: float) -> str:
        if self._state != 'active':
            return f'the node is {self._state}'
        if not self._worker.warm_up.done():
            return warm_up_status()
        return '' if now_s > 0.0 else 'use_sim_time is set and nothing has arrived on /clock'

    def _warnings(self) -> Iterator[str]:
        if self._has_namesake:
            yield 'another node has the same name: their outputs cannot be told apart'
        n_clocks = self.count_publishers(CLOCK) if self._is_simulated else 0
        yield from self._time.warnings(n_clocks, self._state == 'active')

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._forget('reset')
        response.success = True
        response.message = 'all measurements are forgotten'
        return response

    def _forget(self, reason: str) -> None:
        """Stop the estimate, forget all measurements, and withdraw the last answer."""
        self._worker.cancel()
        if self._inputs is not None:
            self._inputs.drop_waiting()
        self._localizer.reset()
        self._rate.clear()
        self._intake.forget()
        self._failure = ''
        self.get_logger().info(f'{reason}: all measurements are forgotten', **at_most_every(1.0))
        self._publish(self._no_estimate(reason))

    def _no_estimate(self, reason: str) -> TimedEstimate:
        estimate = Estimate(self._clock_s(), self.settings.fleet.robots, None, reason)
        return TimedEstimate(estimate, tuple(estimate_messages(estimate, self.settings)))

    def _now_s(self) -> float | None:
        """Return the time, None before the first one of a simulation; forget all if it jumps."""
        # Any callback may be the first to see that a bag loops or that a clock is set back.
        now_s, back_s = self._time.now()
        if back_s > 0.0:
            self._forget(f'time jumped back by {back_s:.3f} s')
        return now_s if now_s > 0.0 else None


def main(args: Sequence[str]) -> int:
    """Run the node until a signal; return the exit code."""
    # A second signal interrupts the clean end, and must not wait for the worker either.
    with suppress(KeyboardInterrupt):
        spin(partial(LocalizerNode, load=load_for_good), args, USAGE)
    return exit_code_despite_worker(0)
