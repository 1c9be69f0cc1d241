# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `localize_bag`: a rosbag2 in, a rosbag2 with every answer out, and a report.

It does in the time of the bag what the node does: the same parameters, the same inputs, the same
estimate at the same rate, the same messages on the same topics. The same bag gives the same bytes
on every run: no limit depends on a clock of the machine. `solver.max_seconds`,
`solver.tighten_seconds` and `conflicts.max_seconds` are not used, `solver.max_boxes` and
`conflicts.max_solves` are.
"""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
import time

from dg_localization.fleet import solver_warnings, warm_up
from dg_localization.ros.bags.arguments import PAGE, REPORTS, localize_parser
from dg_localization.ros.bags.bag import NS_PER_S, Bag, BagError, open_bag
from dg_localization.ros.bags.many_bags import localize_many
from dg_localization.ros.bags.offline import (
    BagLocalizer,
    Event,
    Inputs,
    Task,
    find_inputs,
    in_seconds,
    read_task,
    timeline,
)
from dg_localization.ros.bags.page import as_page
from dg_localization.ros.bags.picture import AnswerPicture, check_can_draw
from dg_localization.ros.bags.reading import Reading
from dg_localization.ros.bags.report import BagReport, Tally, as_markdown
from dg_localization.ros.bags.truth import Truth, read_truth
from dg_localization.ros.bags.truth_tally import TruthTally
from dg_localization.ros.bags.writer import BagWriter, new_bag, write_text, writing
from dg_localization.ros.executables import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    ExecutableError,
    UsageError,
)
from dg_localization.ros.signals import StopRequest, stop_request
from dg_localization.ros.spinning import own_arguments
from dg_localization.ros.terminal import (
    LINE_PERIOD_S,
    make_progress,
    print_line,
    print_result,
    told_while_waiting,
)


class InterruptedRun(Exception):
    """A signal came."""


@dataclass
class BagRun:
    """One bag, and all that is made of its answers."""

    options: argparse.Namespace
    task: Task
    bag: Bag
    inputs: Inputs
    truth: Truth
    tally: Tally
    compared: TruthTally | None
    picture: AnswerPicture | None

    @classmethod
    def prepare(cls, options: argparse.Namespace, task: Task, bag: Bag) -> 'BagRun':
        """Look for the inputs and read the truth, before kernels are compiled for minutes."""
        fleet = task.settings.fleet
        inputs = find_inputs(task.settings, bag.types)
        with told_while_waiting('reading the ground truth'):
            truth = read_truth(options.truth, task.settings, bag)
        compared = truth.of_fleet(fleet) if options.truth else None
        tally = TruthTally(compared) if compared else None
        picture = None
        if options.plot is not None or _wants_page(options):
            name, period_s = options.bag.resolve().name, 1.0 / task.settings.rate_hz
            picture = AnswerPicture(fleet, name, period_s, compared)
        return cls(options, task, bag, inputs, truth, Tally(fleet.robots), tally, picture)

    def span_ns(self) -> tuple[int, int]:
        """Return the first and the last time to read."""
        bag, options = self.bag, self.options
        start_ns = bag.start_ns + round(options.start * NS_PER_S)
        end_ns = bag.end_ns
        if options.duration is not None:
            end_ns = min(end_ns, start_ns + round(options.duration * NS_PER_S))
        period_s, span_s = 1.0 / self.task.settings.rate_hz, (end_ns - start_ns) / NS_PER_S
        if span_s < period_s:
            cut = ''
            if options.start > 0.0 or options.duration is not None:
                cut = f'--start and --duration leave {max(0.0, span_s):.1f} of them; '
            raise BagError(
                f'the bag has {bag.duration_s:.1f} s; {cut}there must be {period_s:g} s, one '
                "period of the parameter 'rate'"
            )
        return start_ns, end_ns

    def localize(self, stop: StopRequest) -> BagReport:
        """Localize, write the answers, and return the report."""
        settings, span_ns = self.task.settings, self.span_ns()
        reading = Reading(self.bag, self.inputs.topics)
        with new_bag(self.options.output, self.options.storage) as writer:
            copied = _add_copies(reading, writer) if self.options.inputs else ()
            localizer = BagLocalizer(self.task, self.inputs, writer, copied)
            ending = self._write_answers(reading, span_ns, localizer, stop)
        notices = (*self.bag.notices, *self.inputs.notices, *reading.notices, *self.truth.notices)
        return BagReport(
            bag=self.options.bag.resolve().name,
            start_s=self.options.start,
            end_s=self._at_s(span_ns[1]),
            rate_hz=settings.rate_hz,
            ending=ending,
            tally=self.tally,
            links=self.inputs.links,
            states=localizer.intake.states(in_seconds(span_ns[1])),
            malformed=localizer.intake.malformed,
            unreadable=reading.unreadable,
            # What is wrong with a topic that is an input and a truth is found twice.
            notices=tuple(dict.fromkeys(notices)),
            damage=tuple(dict.fromkeys((*reading.damage, *self.truth.damage))),
            checksums=self.bag.checksums,
            max_boxes=settings.fleet.solver.max_boxes,
            truth=self.compared,
        )

    def _at_s(self, time_ns: int) -> float:
        return (time_ns - self.bag.start_ns) / NS_PER_S

    def _write_answers(
        self,
        reading: Reading,
        span_ns: tuple[int, int],
        localizer: BagLocalizer,
        stop: StopRequest,
    ) -> str:
        """Localize from the first to the last time; return why the answers end early."""
        with closing(make_progress((span_ns[1] - span_ns[0]) / NS_PER_S)) as progress:
            try:
                done_s = self._at_s(span_ns[0])
                for time_ns in self._answer_times_ns(reading, span_ns, localizer, stop):
                    at_s = self._at_s(time_ns)
                    progress.update(at_s - done_s)
                    done_s = at_s
            except InterruptedRun:
                if not self.tally.ticks:
                    raise
                return f'It ends at {self.tally.last_s:.1f} s: interrupted.'
        return ''

    def _answer_times_ns(
        self,
        reading: Reading,
        span_ns: tuple[int, int],
        localizer: BagLocalizer,
        stop: StopRequest,
    ) -> Iterator[int]:
        """Let everything happen in order; yield the time of each answer once it is counted."""
        began_s, at_s, last_ns = time.monotonic(), 0.0, span_ns[0]
        slowest_s, slowest_at_s = 0.0, 0.0

        def state() -> str:
            took_s = time.monotonic() - began_s
            is_long = at_s and took_s >= LINE_PERIOD_S
            return f'{took_s:.0f} s for the answer at {at_s:.1f} s' if is_long else ''

        messages = reading.messages(self.options.start, self.options.duration)
        events = timeline(messages, *span_ns, self.task.settings.rate_hz)
        with told_while_waiting(state, LINE_PERIOD_S):
            for time_ns, event, message in events:
                if message is not None:
                    localizer.take(message)
                    last_ns = time_ns
                elif event is Event.DIAGNOSTICS:
                    localizer.write_diagnostics(time_ns)
                elif event is Event.GAP:
                    self.tally.add_gap(self._at_s(last_ns), self._at_s(time_ns))
                else:
                    began_s, at_s = time.monotonic(), self._at_s(time_ns)
                    if self._answer(localizer, time_ns, at_s, stop):
                        yield time_ns
                    if time.monotonic() - began_s > slowest_s:
                        slowest_s, slowest_at_s = time.monotonic() - began_s, at_s
                    at_s = 0.0
                if stop.is_set():
                    raise InterruptedRun
        if slowest_s >= LINE_PERIOD_S:
            print_line(
                f'the slowest answer, at {slowest_at_s:.1f} s of the bag, took {slowest_s:.1f} s; '
                "the parameter 'solver.max_boxes' bounds the search"
            )

    def _answer(
        self, localizer: BagLocalizer, time_ns: int, at_s: float, stop: StopRequest
    ) -> bool:
        """Localize once and count the answer; return False where it was cancelled."""
        estimate = localizer.tick(time_ns, stop)
        if estimate is None:
            return False
        self.tally.add(estimate, at_s, localizer.statuses)
        if self.compared is not None and localizer.snapshot is not None:
            self.compared.add(estimate, localizer.snapshot, at_s)
        if self.picture is not None:
            self.picture.add(estimate, localizer.snapshot, at_s)
        return True


def _add_copies(reading: Reading, writer: BagWriter) -> frozenset[str]:
    """Add the topics of the bag to what is written, and return those that can be."""
    known = [topic for topic in reading.topics if writer.knows(topic.type_names[0])]
    for topic in known:
        writer.add_copy(topic)
    for topic in reading.topics:
        if topic not in known:
            print_line(
                f'{topic.name} is not copied: the definition of {topic.type_names[0]} is not known'
            )
    return frozenset(topic.name for topic in known)


def _get_solver_ready() -> None:
    """Load the kernels, or compile them in sight: that takes minutes, and a signal ends it."""
    warm_up(print_line)
    for warning in solver_warnings():
        print_line(warning)


def _wants_page(options: argparse.Namespace) -> bool:
    return options.report is not None and options.report.suffix == PAGE


def _localize_one(options: argparse.Namespace, task: Task) -> int:
    """Localize a bag, print and write what came of it; return the exit code."""
    with open_bag(options.bag) as bag:
        run = BagRun.prepare(options, task, bag)
        _get_solver_ready()
        with stop_request() as stop:
            began_s = time.perf_counter()
            report = run.localize(stop)
            took_s = time.perf_counter() - began_s
            if _wants_page(options) and run.picture is not None:
                page = as_page(report, task.settings.fleet, run.picture)
                write_text(options.report, page)
            elif options.report is not None:
                write_text(options.report, REPORTS[options.report.suffix](report))
            print_result(as_markdown(report))
            read_s = report.tally.last_s - report.start_s
            print_result(
                f'{read_s:.1f} s of the bag took {took_s:.1f} s: {read_s / took_s:.1f} times real '
                'time.'
            )
            if run.picture is not None and options.plot is not None:
                with told_while_waiting(f'drawing {options.plot}'), writing(options.plot):
                    run.picture.draw(Path(options.plot))
            if stop.is_set():
                return EXIT_INTERRUPTED
    return EXIT_FAILED if report.ending or report.damage else 0


def main(args: Sequence[str]) -> int:
    """Localize a bag, or several, until their end or a signal; return the exit code."""
    options = localize_parser().parse_args(own_arguments(args))
    task = read_task(options.params, args)
    if options.plot is not None or _wants_page(options):
        check_can_draw()
    if len(options.bags) > 1 and _wants_page(options):
        raise UsageError('--report: of several bags it is .json or .md')
    try:
        if len(options.bags) > 1:
            _get_solver_ready()
            return localize_many(options, args)
        options.bag = options.bags[0]
        return _localize_one(options, task)
    except OSError as error:  # of the report that is printed, as on a full disk
        raise ExecutableError(str(error)) from error
    except (InterruptedRun, KeyboardInterrupt):
        kept = f'{options.output} has the answers so far' if options.output.exists() else ''
        print_line(f'interrupted; {kept or "nothing is written"}')
        return EXIT_INTERRUPTED
