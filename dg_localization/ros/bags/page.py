# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The report on a bag as one page for a colleague: it needs no network and no other file.

The picture is an SVG by matplotlib, which `--plot` needs already, and which a printer and a mail
program show as well as a browser.
"""

from collections.abc import Iterator
from html import escape
from itertools import groupby
import math
from pathlib import Path
from tempfile import TemporaryDirectory

from dg_localization.fleet import FleetConfig
from dg_localization.ros.bags.picture import AnswerPicture
from dg_localization.ros.bags.report import BagReport, as_markdown

STYLE = """
body { font: 15px/1.5 sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { border: 1px solid #ccc; padding: .25rem .6rem; text-align: left; vertical-align: top; }
th { background: #f3f3f3; }
svg { max-width: 100%; height: auto; }
.verdict { font-size: 1.2rem; background: #eef4fa; padding: .8rem 1rem; }
""".strip()


def as_page(report: BagReport, fleet: FleetConfig, picture: AnswerPicture) -> str:
    """Return a report as HTML, with its picture in it."""
    title = escape(report.bag)
    parts = [
        '<!DOCTYPE html>',
        f'<html lang="en"><head><meta charset="utf-8"><title>{title}</title>',
        f'<style>{STYLE}</style></head><body>',
        f'<h1>{title}</h1>',
        f'<p class="verdict">{escape(verdict(report))}</p>',
        _svg(picture),
        *_html(as_markdown(report).split('\n', 1)[1]),
        '<h2>What was heard</h2>',
        _table(
            [('input', 'topics', 'accepted', 'rejected', 'last rejected because'), *_heard(report)]
        ),
        '<h2>Configuration</h2>',
        _table([('setting', 'value'), *_settings(fleet)]),
        '</body></html>',
    ]
    return '\n'.join(parts) + '\n'


def verdict(report: BagReport) -> str:
    """Return two sentences on the whole bag."""
    tally = report.tally
    widths_m = [width_m for width_m in tally.median_widths_m().values() if not math.isnan(width_m)]
    width = 'no placement was found'
    if widths_m:
        widest_m = max(widths_m)
        is_bounded = math.isfinite(widest_m)
        width = 'not all robots are bounded'
        if is_bounded:
            width = f'the widest robot is known to {widest_m:.2f} m'
    first = (
        f'Of {tally.ticks} answers {tally.hypotheses[1]} have one hypothesis, and in the median '
        f'{width}.'
    )
    bad = sum(run.ticks for run in tally.contradictions)
    second = (
        f'Measurements contradict each other in {bad} answers.'
        if bad
        else 'No measurements contradict each other.'
    )
    if report.damage:
        second = f'The bag is damaged. {second}'
    if report.truth is not None and report.truth.compared:
        held = f'{report.truth.held} of {report.truth.compared}'
        second = f'{second[:-1]}, and the truth is inside in {held} answers compared.'
    return f'{first} {second}'


def _svg(picture: AnswerPicture) -> str:
    with TemporaryDirectory() as folder:
        path = Path(folder) / 'picture.svg'
        picture.draw(path)
        text = path.read_text(encoding='utf-8')
    return text[text.index('<svg') :]


def _html(markdown: str) -> Iterator[str]:
    """Yield the paragraphs, lists and tables of a report."""
    for part in markdown.strip().split('\n\n'):
        for mark, lines in groupby(part.splitlines(), key=lambda line: line[:1]):
            if mark == '|':
                rows = [line.strip('| ').split(' | ') for line in lines]
                yield _table([row for number, row in enumerate(rows) if number != 1])
            elif mark == '-':
                items = ''.join(f'<li>{escape(line[2:])}</li>' for line in lines)
                yield f'<ul>{items}</ul>'
            else:
                yield f'<p>{escape(" ".join(lines))}</p>'


def _table(rows: list[tuple[str, ...] | list[str]]) -> str:
    lines = []
    for number, row in enumerate(rows):
        tag = 'td' if number else 'th'
        cells = ''.join(f'<{tag}>{escape(str(cell).strip())}</{tag}>' for cell in row)
        lines.append(f'<tr>{cells}</tr>')
    return f'<table>{"".join(lines)}</table>'


def _heard(report: BagReport) -> Iterator[tuple[str, ...]]:
    topics: dict[str, list[str]] = {}
    for link in report.links:
        topics.setdefault(str(link.key), []).append(link.topic)
    states = {str(key): state for key, state in report.states.items()}
    for key in sorted({*states, *topics}):
        state = states.get(key)
        accepted, rejected, reason = 0, 0, 'nothing was received'
        if state is not None:
            accepted, rejected = state.accepted, sum(state.rejected.values())
            reason = state.last_reason_text
        yield key, ', '.join(topics.get(key, [])), str(accepted), str(rejected), reason


def _settings(fleet: FleetConfig) -> Iterator[tuple[str, str]]:
    default = FleetConfig(fleet.robots)
    for name, value in vars(fleet).items():
        if name == 'robots' or value != getattr(default, name, None):
            yield name, str(value)
