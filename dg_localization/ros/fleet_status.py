# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Show the diagnostics of a localizer as one screen in a terminal: `fleet_status`."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
import shutil
import sys
from textwrap import wrap
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from dg_localization.ros.executables import print_result
from dg_localization.ros.spinning import spin
from msg_adapters import Level, Status, adapter_for

USAGE = 'usage: fleet_status [--ros-args -p localizer:=NAMESPACE/NAME]'

REFRESH_S = 1.0
SILENT_S = 3.0
"""After this time without a message the localizer counts as silent; it publishes every second."""

CLEAR = '\x1b[H\x1b[2J'
SHOWN = ('yaw_deg', 'typical_m', 'guaranteed_m', 'heard')
"""Values of robots in the diagnostics that get a column."""

to_statuses = adapter_for('diagnostic_msgs/msg/DiagnosticArray').from_message


def screen(
    node: str, statuses: Sequence[Status], silent_s: float, width: int = 80
) -> Iterator[str]:
    """Yield the lines of a screen on the localizer `node`, silent for `silent_s`."""
    for text in _paragraphs(node, statuses, silent_s, width):
        yield from wrap(text, width, subsequent_indent='  ') or ['']


def _paragraphs(
    node: str, statuses: Sequence[Status], silent_s: float, width: int
) -> Iterator[str]:
    parts = {status.name.removeprefix(f'{node}: '): status for status in statuses}
    fleet = parts.pop('fleet', None)
    if fleet is None:
        yield f'{node}: no diagnostics received; is it running, in this namespace and domain?'
        return
    if silent_s > SILENT_S:
        yield f'{node}: SILENT for {silent_s:.0f} s; what follows is old'
    yield f'{node}: {_mark(fleet)}: {fleet.message}'
    yield ', '.join(_summary(fleet.values))
    yield ''
    robots = {name[6:]: part for name, part in parts.items() if name.startswith('robot ')}
    header, *rows = _table(robots)
    # Long names leave no room for the other columns.
    has_room = len(''.join(header)) <= width
    yield ''.join(header if has_room else header[1:])
    for (name, *cells), part in zip(rows, robots.values(), strict=True):
        yield from [name + ''.join(cells)] if has_room else [name.strip(), ''.join(cells)]
        problem = part.values.get('problem', '')
        if problem not in fleet.message:
            yield f'  {problem}'
    troubles = [
        f'{name}: {part.message}'
        for name, part in parts.items()
        if name.startswith('input ') and part.level != Level.OK
    ]
    if troubles:
        yield from ('', *troubles)
    advice = fleet.values.get('would_fix', '')
    if advice:
        yield from ('', *(f'next: {text}' for text in advice.split('; ')))


def _table(robots: Mapping[str, Status]) -> list[list[str]]:
    """Return the cells of a header and a row for each robot, with equal widths in a column."""
    rows = [('robot', 'state', 'x m', 'y m', 'z m', *(key.replace('_', ' ') for key in SHOWN))]
    for name, part in robots.items():
        x, y, z, *_ = [*part.values.get('position_m', '').split(), '', '', '']
        cells = (part.values.get(key, '') for key in SHOWN)
        rows.append((name, _mark(part), x, y, z, *cells))
    # Drop empty columns: in the plane there is no z.
    names, *columns = [column for column in zip(*rows, strict=True) if any(column[1:])]
    widths = [max(map(len, column)) + 2 for column in columns]
    return [
        [name.ljust(max(map(len, names))), *map(str.rjust, cells, widths)]
        for name, *cells in zip(names, *columns, strict=True)
    ]


def _mark(status: Status) -> str:
    return 'ok' if status.level is Level.OK else status.level.name


def _summary(values: Mapping[str, str]) -> Iterator[str]:
    """Yield the frame, the inputs, the answers, and the hypothesis of the poses."""
    yield values.get('frame') or 'no frame'
    yield f'{values.get("inputs_in_use", "0")} of {values.get("inputs", "0")} inputs in use'
    if 'rate_hz' in values:
        yield f'{values["rate_hz"]} answers/s'
    numbers = values.get('hypothesis_numbers', '').split()
    if len(numbers) > 1:
        yield f'poses of hypothesis {numbers[0]} of {values["hypotheses"]}'


class FleetStatusNode(Node):
    """
    Prints the screen of one localizer.

    Parameters
    ----------
    show : callable
        Takes the text of a screen.
    **kwargs
        Arguments of `rclpy.node.Node`.

    """

    def __init__(self, show: Callable[[str], object], **kwargs: Any) -> None:
        super().__init__('fleet_status', **kwargs)
        self._show = show
        self._localizer = str(self.declare_parameter('localizer', 'localizer').value).lstrip('/')
        self._statuses: tuple[Status, ...] = ()
        self._received_s = time.monotonic()
        self.create_subscription(DiagnosticArray, '/diagnostics', self._keep, 10)
        self.create_timer(REFRESH_S, self._refresh)

    def _keep(self, message: DiagnosticArray) -> None:
        """Keep the diagnostics if they come from the localizer."""
        statuses = to_statuses(message).statuses
        if any(status.name == f'{self._localizer}: fleet' for status in statuses):
            self._statuses, self._received_s = tuple(statuses), time.monotonic()

    def _refresh(self) -> None:
        """Print the screen again."""
        silent_s = time.monotonic() - self._received_s
        width = shutil.get_terminal_size().columns
        self._show('\n'.join(screen(self._localizer, self._statuses, silent_s, width)))


def _print(text: str, clear: bool) -> None:
    """Print a screen over the one before; into a file or a pipe, one after another."""
    print_result(f'{CLEAR}{text}' if clear else f'{text}\n')


def main(args: Sequence[str]) -> int:
    """Print the screen until a signal; return the exit code."""
    spin(partial(FleetStatusNode, partial(_print, clear=sys.stdout.isatty())), args, USAGE)
    return 0
