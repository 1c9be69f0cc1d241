# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Show the diagnostics of a localizer as one screen in a terminal: `fleet_status`."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
import shutil
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from dg_localization.ros.spinning import spin
from msg_adapters import Level, Status, adapter_for

USAGE = 'usage: fleet_status [--ros-args -r __ns:=/NAMESPACE -p localizer:=NAME]'

REFRESH_S = 1.0
SILENT_S = 3.0
"""The localizer publishes once a second: after this long without a message it is called silent."""

CLEAR = '\x1b[H\x1b[2J'
MARKS = {Level.OK: 'ok', Level.WARN: 'WARN', Level.ERROR: 'ERROR'}

to_statuses = adapter_for('diagnostic_msgs/msg/DiagnosticArray').from_message


def screen(
    node: str, statuses: Sequence[Status], silent_s: float, width: int = 120
) -> Iterator[str]:
    """Yield the lines of a screen about the localizer `node`, whose diagnostics may be silent."""
    parts = {status.name.removeprefix(f'{node}: '): status for status in statuses}
    fleet = parts.pop('fleet', None)
    if fleet is None:
        yield f'{node}: no diagnostics received; is it running, in this namespace and domain?'
        return
    if silent_s > SILENT_S:
        yield f'{node}: SILENT for {silent_s:.0f} s; what follows is old'
    yield _cut(f'{node}: {MARKS.get(fleet.level, "STALE")}: {fleet.message}', width)
    yield _cut(_summary(fleet.values), width)
    yield ''
    robots = {name[6:]: part for name, part in parts.items() if name.startswith('robot ')}
    indent = max([5, *map(len, robots)])
    for name, part in robots.items():
        mark = MARKS.get(part.level, 'STALE')
        yield _cut(f'{name:<{indent}}  {mark:<5}  {part.message}', width)
        for key, value in part.values.items():
            if key.startswith('hypothesis_'):
                yield _cut(f'{"":<{indent}}         {value}', width)
                break
    troubles = [
        _cut(f'{name}: {part.message}', width)
        for name, part in parts.items()
        if name.startswith('input ') and part.level != Level.OK
    ]
    if troubles:
        yield ''
        yield from troubles
    advice = fleet.values.get('would_fix', '')
    if advice:
        yield ''
        yield from (_cut(f'next: {text}', width) for text in advice.split('; '))


def _summary(values: Mapping[str, str]) -> str:
    """Return how many hypotheses, inputs and answers there are."""
    count = values.get('hypotheses', '0')
    hypotheses = 'hypothesis' if count == '1' else 'hypotheses'
    parts = [
        f'{count} {hypotheses} in frame {values.get("frame") or "-"}',
        f'{values.get("inputs_in_use", "0")} of {values.get("inputs", "0")} inputs in use',
    ]
    if 'rate_hz' in values:
        parts.append(f'{values["rate_hz"]} answers a second')
    return ', '.join(parts)


def _cut(text: str, width: int) -> str:
    """Return a line that fits the terminal."""
    return text if len(text) <= width else f'{text[: width - 3]}...'


class FleetStatusNode(Node):
    """
    Prints the screen of one localizer.

    Parameters
    ----------
    show : callable
        Takes the text of a screen.
    **kwargs
        Those of `rclpy.node.Node`.

    """

    def __init__(self, show: Callable[[str], object], **kwargs: Any) -> None:
        super().__init__('fleet_status', **kwargs)
        self._show = show
        self._localizer = str(self.declare_parameter('localizer', 'localizer').value)
        self._statuses: tuple[Status, ...] = ()
        self._received_s = time.monotonic()
        self.create_subscription(DiagnosticArray, '/diagnostics', self._keep, 10)
        self.create_timer(REFRESH_S, self._refresh)

    def _keep(self, message: DiagnosticArray) -> None:
        """Keep the diagnostics if they are those of the localizer."""
        statuses = to_statuses(message).statuses
        if any(status.name == f'{self._localizer}: fleet' for status in statuses):
            self._statuses, self._received_s = tuple(statuses), time.monotonic()

    def _refresh(self) -> None:
        """Print the screen anew."""
        silent_s = time.monotonic() - self._received_s
        width = shutil.get_terminal_size().columns
        self._show('\n'.join(screen(self._localizer, self._statuses, silent_s, width)))


def _print(text: str, clear: bool) -> None:
    """Print a screen over the one before; into a file or a pipe, one after another."""
    print(f'{CLEAR}{text}' if clear else f'{text}\n', flush=True)


def main(args: Sequence[str]) -> int:
    """Print the screen until a signal; return the exit code."""
    spin(partial(FleetStatusNode, partial(_print, clear=sys.stdout.isatty())), args, USAGE)
    return 0
