# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The gates: what must not get worse, in one table, beside an earlier state of the package.

    python -m benchmarks.gates [--only NAME ...] [--quick] [--json FILE] [--against FILE]

Seeds are fixed, and times are those of the processor. Absolute limits hold always; limits relative
to an earlier state are checked with `--against`, for which both states should be measured on one
machine in one sitting. The exit code is 1 where a gate is broken. `--quick` runs fewer fleets, and
is to be compared with a quick run.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatch
import json
import math
from pathlib import Path
import sys
import time

from benchmarks import gate_rows as rows
from benchmarks.gate_rows import Figures


@dataclass(frozen=True)
class Limit:
    """How good a figure has to be: in each row, or in the sum of all rows."""

    most: float = math.inf
    least: float = -math.inf
    times: float = math.inf
    """At most this multiple of the figure of the earlier state."""
    more: float = 0.0
    """A difference from the multiple that is too small to count."""
    total: bool = False

    def broken(self, value: float, before: float | None) -> bool:
        """Return whether a value is beyond the limit."""
        most = self.most
        if before is not None and math.isfinite(self.times):
            most = min(most, self.times * before + self.more)
        return not self.least <= value <= most


NONE = Limit(most=0, total=True)


SOUND = {'lost': NONE, 'false': NONE}
RARE = {'not held': Limit(times=1.0, more=0.02), 'not named': Limit(times=1.0, more=0.02)}
DENSE = {**SOUND, 'out': NONE, 'ms': Limit(times=1.5, more=0.2), 'width': Limit(times=1.05)}
GATES: dict[str, tuple[Callable[[bool], rows.Rows], dict[str, Limit]]] = {
    'paper': (
        rows.paper,
        {
            **SOUND,
            'ms': Limit(times=1.5, more=0.05),
            'hypotheses off': NONE,
            'boxes': Limit(times=1.0),
            'empty': Limit(times=1.0),
        },
    ),
    'uwb': (rows.fleets('uwb', 10), DENSE),
    'plane': (rows.fleets('plane', 10), DENSE),
    'space': (rows.fleets('space', 10), {**SOUND, 'out': Limit(most=3, total=True)}),
    'networks': (rows.networks, {**SOUND, 'out': Limit(most=1, total=True)}),
    'large': (rows.large_fleets, {**SOUND, 'out': NONE, 'ms': Limit(times=2.0)}),
    'widths': (rows.hull_widths, {'median': Limit(times=1.1)}),
    'mrclam': (
        rows.mrclam,
        {'lost': NONE, 'width over limit': Limit(most=1.0), 'point_m': Limit(most=0.13)},
    ),
    'moving': (rows.moving, {'lost': NONE, 'short by': Limit(most=0.0)}),
    'tutorial': (rows.tutorial, {'short by': Limit(most=0.0)}),
    'liars-landmarks': (rows.liars_among_landmarks, RARE),
    'liars-window': (rows.liars_in_window, RARE),
    'rates': (rows.rates, {'ms': Limit(times=1.1, more=5.0, most=200.0)}),
}


def report(
    name: str, found: dict[str, Figures], limits: dict[str, Limit], before: dict[str, Figures]
) -> bool:
    """Print the table of a gate; return whether it holds."""
    broken = []
    columns = list(dict.fromkeys(key for figures in found.values() for key in figures))
    print(f'\n### {name}\n\n| row | {" | ".join(columns)} |\n|{"---|" * (len(columns) + 1)}')
    for row, figures in found.items():
        cells = []
        for key, value in figures.items():
            old = before.get(row, {}).get(key)
            limit = limits.get(key, Limit())
            cell = f'{value:.4g}' if old is None else f'{old:.4g} -> {value:.4g}'
            if old:
                cell += f' ({value / old:.2f}x)'
            if not limit.total and limit.broken(value, old):
                broken.append(f'{row}: {key} {cell}')
                cell = f'**{cell}**'
            cells.append(cell)
        print(f'| {row} | {" | ".join(cells)} |')
    for key, limit in limits.items():
        total = sum(figures.get(key, 0.0) for figures in found.values())
        if limit.total and limit.broken(total, None):
            broken.append(f'all: {key} {total:g}, at most {limit.most:g}')
    print(f'\n{name}: {"BROKEN: " + "; ".join(broken) if broken else "holds"}', flush=True)
    return not broken


def main() -> None:
    """Run the gates, print their tables, and leave with 1 where one is broken."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.gates', description=__doc__)
    parser.add_argument('--only', nargs='+', metavar='NAME', help=', '.join(GATES))
    parser.add_argument('--quick', action='store_true', help='a minute of the processor')
    parser.add_argument('--json', type=Path, metavar='FILE', help='write the figures')
    parser.add_argument('--against', type=Path, metavar='FILE', help='figures of an earlier state')
    options = parser.parse_args()
    names = [g for g in GATES if any(fnmatch(g, p) for p in options.only or ['*'])]
    before = json.loads(options.against.read_text()) if options.against else {}
    found, broken = {}, []
    rows.warm_up()
    for name in names:
        measure, limits = GATES[name]
        start_s = time.process_time()
        found[name] = dict(measure(options.quick))
        if not report(name, found[name], limits, before.get(name, {})):
            broken.append(name)
        print(f'{time.process_time() - start_s:.0f} s', flush=True)
        if options.json:
            options.json.write_text(json.dumps(found, indent=1) + '\n')
    print(f'\nbroken: {", ".join(broken) or "none"} of {len(names)} gates')
    sys.exit(bool(broken))


if __name__ == '__main__':
    main()
