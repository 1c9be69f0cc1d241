# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The report on a bag as one page for a colleague: it needs no network and no other file.

The picture is an SVG by matplotlib, which `--plot` needs already, and which a printer and a mail
program show as well as a browser.
"""

from collections.abc import Sequence
from html import escape
from typing import Any

from dg_localization.fleet import FleetConfig
from dg_localization.ros.bags.report import Sheet, Tree, parts

STYLE = """
body { font: 15px/1.5 sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { border: 1px solid #ccc; padding: .25rem .6rem; text-align: left; vertical-align: top; }
th { background: #f3f3f3; }
svg { max-width: 100%; height: auto; }
.verdict { font-size: 1.2rem; background: #eef4fa; padding: .8rem 1rem; }
""".strip()


def as_page(tree: Tree, fleet: FleetConfig, picture: str) -> str:
    """Return a report as HTML, with its picture, an SVG, in it."""
    heard = [
        (
            row['input'],
            ', '.join(row['topics']),
            row['accepted'],
            sum(row['rejected'].values()),
            row['last_rejection'],
        )
        for row in tree['inputs']
    ]
    default = vars(FleetConfig(fleet.robots))
    settings = [
        (name, value)
        for name, value in vars(fleet).items()
        if name == 'robots' or value != default.get(name)
    ]
    title = escape(tree['bag'])
    body = [
        f'<p class="verdict">{escape(verdict(tree))}</p>',
        picture[picture.index('<svg') :],
        *map(_html, parts(tree)),
        '<h2>What was heard</h2>',
        _html(Sheet(('input', 'topics', 'accepted', 'rejected', 'last rejected because'), heard)),
        '<h2>Configuration</h2>',
        _html(Sheet(('setting', 'value'), settings)),
    ]
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>\n'
        f'<style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n'
        + '\n'.join(filter(None, body))
        + '\n</body></html>\n'
    )


def verdict(tree: Tree) -> str:
    """Return two sentences on the whole bag."""
    widths_m = tree['median_enclosure_width_m'].values()
    if tree['ticks_by_hypotheses'].keys() <= {'0'}:
        width = 'no placement was found'
    elif None in widths_m:
        width = 'not all robots are bounded'
    else:
        width = f'in the median the widest robot is known to {max(widths_m):.2f} m'
    single = tree['ticks_by_hypotheses'].get('1', 0)
    first = f'Of {tree["ticks"]} answers {single} have one hypothesis, and {width}.'
    bad = sum(run['ticks'] for run in tree['contradictions'])
    second = 'No measurements contradict each other'
    if bad:
        second = f'Measurements contradict each other in {bad} answers'
    truth = tree['truth']
    if truth and truth['compared']:
        held = f'{truth["held"]} of {truth["compared"]}'
        second += f', and the truth is inside in {held} answers compared'
    damaged = 'The bag is damaged. ' if tree['damage'] else ''
    return f'{first} {damaged}{second}.'


def _html(part: str | Sheet) -> str:
    """Return a paragraph or a table."""
    if isinstance(part, str):
        return f'<p>{escape(part)}</p>' if part else ''
    if not part.rows:
        return ''
    rows = [_row('th', part.columns), *(_row('td', row) for row in part.rows)]
    return f'<table>{"".join(rows)}</table>'


def _row(tag: str, cells: Sequence[Any]) -> str:
    return f'<tr>{"".join(f"<{tag}>{escape(str(cell))}</{tag}>" for cell in cells)}</tr>'
