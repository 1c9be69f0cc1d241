# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `localize_bag`: a rosbag2 in, a rosbag2 with every answer out, and a report.

    localize_bag BAG [BAG ...] -o OUT --params FILE [--storage mcap|sqlite3] [--start S]
                 [--duration S] [--truth TOPIC ... | --truth FILE.csv] [--report FILE]
                 [--plot FILE] [--inputs] [--jobs N] [--scheduler ADDRESS] [--ros-args ...]

It does in the time of the bag what the node does: the same parameters, the same inputs, the same
estimate at the same rate, the same messages on the same topics. The same bag gives the same bytes
on every run: no limit depends on a clock of the machine. `solver.max_seconds`,
`solver.tighten_seconds` and `conflicts.max_seconds` are not used, `solver.max_boxes` and
`conflicts.max_solves` are.

Several bags are localized by a process each (`many_bags`), on this machine or by the workers of a
Dask cluster; OUT has a folder for each.
"""

import argparse
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
import time

from dg_localization.calibration.answers import FleetTruth
from dg_localization.fleet import Estimate, solver_warnings, warm_up
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.ros.bags.arguments import REPORTS, make_parser, shared_arguments
from dg_localization.ros.bags.contents import Contents, contents_of, damage_of
from dg_localization.ros.bags.ground_truth import (
    TruthReader,
    read_truth,
    tracks_of,
    truth_reader,
)
from dg_localization.ros.bags.many_bags import (
    MANY_REPORTS,
    by_name,
    localize_many,
    many_as_markdown,
)
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
from dg_localization.ros.bags.picture import AnswerPicture, check_can_draw
from dg_localization.ros.bags.reader import NS_PER_S, Bag, BagError, BagMessage, recorded_types
from dg_localization.ros.bags.report import BagReport, Tally, as_markdown
from dg_localization.ros.bags.truth_tally import TruthTally
from dg_localization.ros.bags.watch import TickWatch
from dg_localization.ros.bags.writer import BagWriter, new_bag, write_text, writing
from dg_localization.ros.executables import EXIT_FAILED, EXIT_INTERRUPTED, ExecutableError
from dg_localization.ros.interface.parameters.settings import Settings
from dg_localization.ros.signals import StopRequest, stop_request
from dg_localization.ros.spinning import own_arguments
from dg_localization.ros.terminal import (
    make_progress,
    print_line,
    print_result,
    told_while_waiting,
)

# Some weeks at 5 Hz; one damaged receive time makes a bag of a century.
MAX_TICKS = 10_000_000
# Stamps have 32 bits for the seconds.
END_OF_ROS_TIME_NS = 2**31 * NS_PER_S
SLOW_TICK_S = 5.0


class InterruptedRun(Exception):
    """A signal came."""


@dataclass(frozen=True)
class Gathered:
    """
    What is made of all answers.

    Parameters
    ----------
    tally : Tally
        Counts them.
    compared : TruthTally or None
        Compares the answers with a ground truth, if there is one.
    picture : AnswerPicture or None
        Draws the answers, if that is asked for.

    """

    tally: Tally
    compared: TruthTally | None
    picture: AnswerPicture | None

    def add(self, estimate: Estimate, snapshot: Snapshot | None, at_s: float) -> None:
        """Add the answer to a snapshot, for a time from the start of the bag."""
        self.tally.add(estimate, at_s)
        if self.compared is not None and snapshot is not None:
            self.compared.add(estimate, snapshot, at_s)
        if self.picture is not None:
            self.picture.add(estimate, snapshot, at_s)


def localize_bag(
    options: argparse.Namespace,
    task: Task,
    inputs: Inputs,
    gathered: Gathered,
    contents: Contents,
    truth: TruthReader,
    stop: StopRequest,
) -> BagReport:
    """
    Do what the command line asks for.

    Parameters
    ----------
    options : argparse.Namespace
        What `make_parser` returned.
    task : Task
    inputs : Inputs
        Those of the fleet among the topics of the bag.
    gathered : Gathered
        Gets all answers.
    contents : Contents
        What the files of the bag hold.
    truth : TruthReader
        What there is to say of the ground truth.
    stop : StopRequest
        Ends it early, with the answers there are by then.

    Returns
    -------
    BagReport

    Raises
    ------
    BagError
        If there is nothing to localize, or damage before the first answer; no bag is written.
    InterruptedRun
        If it was stopped before the first answer; no bag is written.

    """
    settings = task.settings
    with closing(Bag(options.bag, inputs.topics, contents.span_ns())) as bag:
        span_ns = _span_ns(bag, options, settings.rate_hz)
        with new_bag(options.output, options.storage) as writer:
            copied = _add_copies(bag, writer) if options.inputs else ()
            localizer = BagLocalizer(task, inputs.links, writer, copied)
            ending = _write_answers(bag, options, span_ns, localizer, task, gathered, stop)
        damage = damage_of(bag, contents, None if ending else _read_ns(span_ns, options))
        return BagReport(
            bag=options.bag.resolve().name,
            start_s=options.start,
            end_s=(span_ns[1] - bag.start_ns) / NS_PER_S,
            rate_hz=settings.rate_hz,
            ending=ending,
            tally=gathered.tally,
            links=inputs.links,
            states=localizer.intake.states(in_seconds(span_ns[1])),
            malformed=localizer.intake.malformed,
            unreadable=bag.unreadable,
            # What is wrong with the bag as a whole, or with a topic that is both, is found twice.
            notices=tuple(dict.fromkeys((*inputs.notices, *bag.notices, *truth.notices))),
            damage=tuple(dict.fromkeys((*damage, *truth.damage))),
            checksums=contents.checksums,
            max_boxes=settings.fleet.solver.max_boxes,
            truth=gathered.compared,
        )


def _write_answers(
    bag: Bag,
    options: argparse.Namespace,
    span_ns: tuple[int, int],
    localizer: BagLocalizer,
    task: Task,
    gathered: Gathered,
    stop: StopRequest,
) -> str:
    """Localize from the first to the last time; return why the answers end early."""
    rate_hz, ending = task.settings.rate_hz, ''
    events = timeline(bag.messages(options.start, options.duration), *span_ns, rate_hz)
    with (
        closing(make_progress((span_ns[1] - span_ns[0]) / NS_PER_S)) as progress,
        closing(TickWatch(progress)) as watch,
    ):
        try:
            for time_ns, estimate in _answers(events, localizer, bag.start_ns, watch, stop):
                at_s = (time_ns - bag.start_ns) / NS_PER_S
                gathered.add(estimate, localizer.snapshot, at_s)
                progress.update(1.0 / rate_hz)
        except (BagError, InterruptedRun) as error:
            if not gathered.tally.ticks:
                raise
            ending = f'It ends at {gathered.tally.last_s:.1f} s: {error}.'
    _print_slowest(watch)
    return ending


def _span_ns(bag: Bag, options: argparse.Namespace, rate_hz: float) -> tuple[int, int]:
    """Return the first and the last time to read."""
    start_ns = bag.start_ns + round(options.start * NS_PER_S)
    end_ns = bag.end_ns
    if options.duration is not None:
        end_ns = min(end_ns, start_ns + round(options.duration * NS_PER_S))
    period_s, span_s = 1.0 / rate_hz, (end_ns - start_ns) / NS_PER_S
    if span_s < period_s:
        is_cut = options.start > 0.0 or options.duration is not None
        cut = f'--start and --duration leave {max(0.0, span_s):.1f} of them; ' if is_cut else ''
        raise BagError(
            f'the bag has {bag.duration_s:.1f} s; {cut}there must be {period_s:g} s, one period '
            "of the parameter 'rate'"
        )
    received = f'received from {start_ns / NS_PER_S:.3f} to {end_ns / NS_PER_S:.3f} s'
    if start_ns < 0 or end_ns >= END_OF_ROS_TIME_NS:
        raise BagError(f'messages were {received}: these are no times of ROS')
    if span_s * rate_hz > MAX_TICKS:
        raise BagError(
            f'messages were {received}, too long for one run: if that is right and no receive '
            'time is damaged, choose parts with --start and --duration'
        )
    return start_ns, end_ns


def _read_ns(span_ns: tuple[int, int], options: argparse.Namespace) -> tuple[int, int]:
    """Return the first and the last time of a message that was to be read."""
    if options.duration is None:
        return span_ns
    # A message at the very end of the duration is not read.
    return span_ns[0], min(span_ns[1], span_ns[0] + round(options.duration * NS_PER_S) - 1)


def _add_copies(bag: Bag, writer: BagWriter) -> frozenset[str]:
    """Add the topics of the bag to what is written, and return those that can be."""
    known = [topic for topic in bag.topics if writer.knows(topic.type_name)]
    for topic in known:
        writer.add_copy(topic)
    for topic in bag.topics:
        if topic not in known:
            print_line(
                f'{topic.name} is not copied: the definition of {topic.type_name} is not known'
            )
    return frozenset(topic.name for topic in known)


def _answers(
    events: Iterable[tuple[int, Event, BagMessage | None]],
    localizer: BagLocalizer,
    bag_start_ns: int,
    watch: TickWatch,
    stop: StopRequest,
) -> Iterator[tuple[int, Estimate]]:
    """Let the events happen, and yield every answer with its time in ns."""
    for time_ns, event, message in events:
        if message is not None:
            localizer.take(message)
        elif event is Event.DIAGNOSTICS:
            localizer.write_diagnostics(time_ns)
        else:
            with watch.solving((time_ns - bag_start_ns) / NS_PER_S):
                estimate = localizer.tick(time_ns, stop)
            if estimate is not None:
                yield time_ns, estimate
        if stop.is_set():
            raise InterruptedRun('interrupted')


def _read_truth(
    options: argparse.Namespace,
    settings: Settings,
    recorded: Mapping[str, Sequence[str]],
    contents: Contents,
) -> TruthReader:
    """Read the truth that the command line names, if it does."""
    reader = truth_reader(options.truth, settings, recorded)
    with told_while_waiting('reading the ground truth'):
        read_truth(options.bag, reader, contents)
    return reader


def _gathering(options: argparse.Namespace, settings: Settings, reader: TruthReader) -> Gathered:
    """Return what gathers the answers, as the command line asks."""
    truth, picture = None, None
    if options.truth:
        truth = FleetTruth(settings.fleet, tracks_of(reader.poses, settings.fleet))
    if options.plot is not None:
        name = options.bag.resolve().name
        picture = AnswerPicture(settings.fleet, name, 1.0 / settings.rate_hz, truth)
    return Gathered(Tally(settings.fleet.robots), TruthTally(truth) if truth else None, picture)


def _draw(picture: AnswerPicture | None, path: Path) -> None:
    """Draw the picture that was asked for."""
    if picture is not None:
        with told_while_waiting(f'drawing {path}'), writing(path):
            picture.draw(path)


def _print_slowest(watch: TickWatch) -> None:
    """Print which answer took longest, where somebody may wonder what the time went into."""
    if watch.slowest_s >= SLOW_TICK_S:
        print_line(
            f'the slowest answer, at {watch.slowest_at_s:.1f} s of the bag, took '
            f"{watch.slowest_s:.1f} s; the parameter 'solver.max_boxes' bounds the search"
        )


def _print_report(report: BagReport, path: Path | None, took_s: float) -> None:
    """Print the report and how long it took, and write the file that was asked for."""
    if path is not None:
        write_text(path, REPORTS[path.suffix](report))
    print_result(as_markdown(report))
    read_s = report.tally.last_s - report.start_s
    print_result(
        f'{read_s:.1f} s of the bag took {took_s:.1f} s: {read_s / took_s:.1f} times real time.'
    )


def _get_solver_ready() -> None:
    """Load the kernels, or compile them in sight: that takes minutes, and a signal ends it."""
    warm_up(print_line)
    for warning in solver_warnings():
        print_line(warning)


def _localize_many(options: argparse.Namespace, args: Sequence[str]) -> int:
    """Localize several bags, print and write what came of all; return the exit code."""
    shared = shared_arguments(options, args)
    bags = by_name(options.bags)
    if options.scheduler is None:
        # Else each process would compile them, and nobody would see how far they are.
        _get_solver_ready()
    try:
        outcomes = localize_many(
            bags,
            options.output,
            shared,
            options.jobs,
            options.scheduler,
            options.plot and options.plot.name,
        )
        if options.report is not None:
            write_text(options.report, MANY_REPORTS[options.report.suffix](outcomes))
    except OSError as error:
        raise ExecutableError(str(error)) from error
    print_result(many_as_markdown(outcomes))
    return max(outcome.exit_code for outcome in outcomes)


def main(args: Sequence[str]) -> int:
    """
    Localize a bag, or several, until their end or a signal.

    Parameters
    ----------
    args : sequence of str
        Command line.

    Returns
    -------
    int
        Exit code, see `localize_bag --help`.

    Raises
    ------
    ExecutableError
        If the bag cannot be read or written, or an argument or a parameter is wrong.

    """
    options = make_parser().parse_args(own_arguments(args))
    task = read_task(options.params, args)
    if options.plot is not None:
        check_can_draw()
    try:
        if len(options.bags) > 1 or options.scheduler is not None:
            return _localize_many(options, args)
        options.bag = options.bags[0]
        with contents_of(options.bag) as contents:
            recorded = recorded_types(options.bag)
            inputs = find_inputs(task.settings, recorded)
            truth = _read_truth(options, task.settings, recorded, contents)
            gathered = _gathering(options, task.settings, truth)
            _get_solver_ready()
            with stop_request() as stop:
                began_s = time.perf_counter()
                report = localize_bag(options, task, inputs, gathered, contents, truth, stop)
                _print_report(report, options.report, time.perf_counter() - began_s)
                _draw(gathered.picture, options.plot)
    except (InterruptedRun, KeyboardInterrupt):
        kept = f'{options.output} has the answers so far' if options.output.exists() else ''
        print_line(f'interrupted; {kept or "nothing is written"}')
        return EXIT_INTERRUPTED
    if stop.is_set():
        return EXIT_INTERRUPTED
    return EXIT_FAILED if report.ending or report.damage else 0
