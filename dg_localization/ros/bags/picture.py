# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The picture of a bag: its answers over time for each robot, and a map.

Together with the report it makes one page, which needs no network and no other file: an SVG in
HTML, which printers and mail programs show as well as browsers.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields
from html import escape
from importlib.util import find_spec
from io import StringIO
from itertools import pairwise
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.calibration.truth import FleetTruth
from dg_localization.fleet import Estimate, FleetConfig, Placement, Snapshot
from dg_localization.fleet.rotations import yaw_of
from dg_localization.optional import install_hint
from dg_localization.ros.bags.report import Sheet, Tree, parts
from dg_localization.ros.executables import ExecutableError

FloatArray = NDArray[np.float64]

PICTURES = ('.png', '.svg', '.pdf')
"""Allowed suffixes of a picture file."""

COLORS = ('#0072B2', '#E69F00', '#009E73', '#D55E00', '#CC79A7', '#56B4E9')
"""Colors for every color vision (Okabe and Ito); they repeat for further robots."""

MOMENTS, ROWS = 600, 20
"""Most answers that are drawn, one per pixel, and most robots with their own panels."""

ROW_IN, MAP_IN, PANEL_IN = 1.5, 5.5, 3.2
"""The height of a robot's panels and the widths of the map and of a panel, in inches."""

LARGEST_M = 1e9
"""Values farther away are not drawn and count as unbounded."""

HEADING = 'heading [rad]'
ERROR = 'off the truth [m]'


def check_can_draw() -> None:
    """Check that pictures can be drawn, before the work begins."""
    if find_spec('matplotlib') is None:
        raise ExecutableError(
            f'--plot and --report FILE.html need matplotlib: {install_hint("matplotlib")}'
        )


class _Moment(NamedTuple):
    """
    The answer at one time; the name of its frame is empty if there are no placements.

    `found` holds best points, lower bounds and upper bounds, shape (3, k, n, c), by hypothesis,
    robot and column; the truth has shape (n, c), the places of the anchors (m, q). `mirrored`
    marks mirror images.
    """

    time_s: float
    frame: str
    found: FloatArray
    true: FloatArray
    landmarks_m: FloatArray
    mirrored: NDArray[np.bool_]


class AnswerPicture:
    """
    Gathers answers and draws them.

    There is a row of panels for each robot, with a column for each coordinate, for the heading in
    the plane, and for the position error with a truth.
    """

    def __init__(self, fleet: FleetConfig, title: str, truth: FleetTruth | None = None) -> None:
        self._robots = fleet.robots
        self._dimension = fleet.dimension
        self._title = title
        self._truth = truth
        self._moments: list[_Moment] = []
        self._n_added, self._every = 0, 1
        names = ('x [m]', 'y [m]', HEADING if fleet.dimension == 2 else 'z [m]')
        self.columns = (*names, ERROR) if truth is not None else names

    def add(self, estimate: Estimate, snapshot: Snapshot, time_s: float) -> None:
        """Add the answer to a snapshot, for a time from the start of the bag."""
        self._n_added += 1
        if (self._n_added - 1) % self._every:
            return
        placements = estimate.placements
        true = np.full((len(self._robots), len(self.columns)), np.nan)
        found = np.full((3, len(placements), *true.shape), np.nan)
        for row, placement in enumerate(placements):
            found[:, row, :, :3] = self._columns_of(placement)
        if self._truth is not None and estimate.frame is not None:
            beside = self._truth.beside(estimate.frame, snapshot)
            true[:, : self._dimension] = beside.positions_m
            if self._dimension == 2:
                true[:, 2] = np.arctan2(beside.rotations[:, 1, 0], beside.rotations[:, 0, 0])
            off_m = (found[0] - true)[:, :, : self._dimension]
            found[0, :, :, 3] = np.linalg.norm(off_m, axis=-1)
        for values, beyond in zip((true, *found), (np.nan, np.nan, -np.inf, np.inf), strict=True):
            values[np.abs(values) > LARGEST_M] = beyond
        landmarks_m = placements[0].landmarks_m if placements else np.empty((0, self._dimension))
        mirrored = np.array([placement.mirrored for placement in placements], dtype=bool)
        frame = str(estimate.frame or '')
        self._moments.append(_Moment(time_s, frame, found, true, landmarks_m, mirrored))
        if len(self._moments) > MOMENTS:
            del self._moments[1::2]
            self._every *= 2

    def _columns_of(self, placement: Placement) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the best point of a placement and its lower and upper bounds."""
        low, high = placement.enclosure_m[:, 0], placement.enclosure_m[:, 1]
        if self._dimension == 3:
            return placement.positions_m, low, high
        orientations, half_widths_rad = placement.best_headings
        yaws_rad = np.array([yaw_of(one) for one in orientations])
        # The bounds of an unknown heading fill its panel.
        middle_rad = np.where(np.isfinite(yaws_rad), yaws_rad, 0.0)
        return (
            np.column_stack([placement.positions_m, yaws_rad]),
            np.column_stack([low, middle_rad - half_widths_rad]),
            np.column_stack([high, middle_rad + half_widths_rad]),
        )

    def draw(self, path: Path) -> None:
        """Draw the answers so far and write the picture."""
        self.figure().savefig(path, dpi=100)

    def as_svg(self) -> str:
        """Return the picture as an SVG, without metadata on its creator and date."""
        text = StringIO()
        nothing = dict.fromkeys(('Creator', 'Date', 'Format', 'Type'))
        self.figure().savefig(text, format='svg', metadata=nothing)
        return text.getvalue()

    def figure(self) -> Any:
        """Return the figure with all panels."""
        from matplotlib.figure import Figure

        n_rows, n_columns = min(len(self._robots), ROWS), len(self.columns)
        figure = Figure(
            figsize=(MAP_IN + PANEL_IN * n_columns, max(MAP_IN + 0.5, ROW_IN * n_rows + 1.0)),
            layout='constrained',
        )
        widths = [MAP_IN, *[PANEL_IN] * n_columns]
        grid = figure.add_gridspec(n_rows, n_columns + 1, width_ratios=widths)
        self._draw_map(figure.add_subplot(grid[:, 0]))
        panels = grid[:, 1:].subgridspec(n_rows, n_columns).subplots(squeeze=False, sharex=True)
        for row, column in np.ndindex(n_rows, n_columns):
            self._draw_panel(panels[row, column], row, column)
            panels[row, 0].set_ylabel(self._robots[row], parse_math=False)
            panels[0, column].set_title(self.columns[column], fontsize=10)
            panels[-1, column].set_xlabel('time from the start of the bag [s]')
        is_cut = len(self._robots) > n_rows
        cut = f' (robots after the first {n_rows} are on the map only)' if is_cut else ''
        # A name with $ must not be parsed as a formula.
        figure.suptitle(self._title + cut, parse_math=False)
        figure.legend(handles=self._legend(), loc='outside lower center', ncols=6, frameon=False)
        return figure

    def _draw_map(self, panel: Any) -> None:
        """Draw the paths of the robots in the most frequent frame."""
        frames = Counter(moment.frame for moment in self._moments if moment.frame)
        frame, count = frames.most_common(1)[0] if frames else ('no answer has placements', 0)
        shown = [moment for moment in self._moments if moment.frame == frame]
        for row, robot in enumerate(self._robots):
            for is_mirror, mark in ((False, '.'), (True, 'x')):
                points = [m.found[0, m.mirrored == is_mirror, row, :2] for m in shown]
                panel.plot(
                    *np.concatenate([np.empty((0, 2)), *points]).T,
                    mark,
                    color=_color(row),
                    markersize=4,
                    zorder=3,
                    label=None if is_mirror else robot,
                )
            true = np.array([moment.true[row, :2] for moment in shown])
            panel.plot(*true.reshape(-1, 2).T, color='black', linewidth=0.8, zorder=4)
        if shown:
            panel.plot(*shown[-1].landmarks_m[:, :2].T, '^', color='0.4', zorder=2)
        panel.set_aspect('equal', adjustable='datalim')
        panel.set(xlabel='x [m]', ylabel='y [m]')
        panel.grid(color='0.93')
        others = frames.total() - count
        title = f'frame: {frame}' + (f'; {others} answers have other frames' if others else '')
        mirrored_s = [m.time_s for m in shown if m.mirrored.any()]
        if mirrored_s:
            title += f'; mirror images from {mirrored_s[0]:.1f} to {mirrored_s[-1]:.1f} s'
        # The legend is beside the map: on it the names would cover the paths.
        panel.legend(
            loc='upper center', bbox_to_anchor=(0.5, -0.1), ncols=4, frameon=False, markerscale=2.0
        )
        panel.set_title(title, fontsize=10, wrap=True, parse_math=False)

    def _draw_panel(self, panel: Any, row: int, column: int) -> None:
        """Draw one column of a robot over time, with the bounds of each hypothesis."""
        from matplotlib.collections import PolyCollection

        is_angle = self.columns[column] == HEADING
        times_s = np.array([moment.time_s for moment in self._moments])
        times_of_all_s = np.repeat(times_s, [moment.found.shape[1] for moment in self._moments])
        parts = [moment.found[:, :, row, column] for moment in self._moments]
        best, low, high = np.concatenate([np.empty((3, 0)), *parts], axis=1)
        true = np.array([moment.true[row, column] for moment in self._moments])
        limits = (-math.pi, math.pi)
        if not is_angle:
            limits = _limits(np.concatenate([best, true]), np.concatenate([low, high]))
        half_s = 0.5 * float(np.min(np.diff(times_s), initial=1.0))
        for turn in (-math.tau, 0.0, math.tau) if is_angle else (0.0,):
            bottom, top = np.clip(low + turn, *limits), np.clip(high + turn, *limits)
            left, right = times_of_all_s - half_s, times_of_all_s + half_s
            corners = np.array([[left, left, right, right], [bottom, top, top, bottom]]).T
            bands = PolyCollection(list(corners[top > bottom]), antialiased=False, linewidth=0)
            bands.set(facecolor=_color(row), alpha=0.25)
            panel.add_collection(bands)
        panel.plot(times_of_all_s, best, '.', color=_color(row), markersize=2.5)
        if is_angle:
            # No line is drawn where the heading wraps from pi to -pi.
            true[1:][np.abs(np.diff(true)) > math.pi] = np.nan
        panel.plot(times_s, true, color='black', linewidth=0.9)
        for before, after in pairwise(moment for moment in self._moments if moment.frame):
            if before.frame != after.frame:
                panel.axvline(after.time_s, color='0.5', linewidth=0.7, linestyle='--')
        panel.set_ylim(*limits)
        panel.grid(color='0.93')
        panel.set_axisbelow(True)

    def _legend(self) -> list[Any]:
        """Return the legend of the symbols, in neutral colors."""
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        gray = '0.45'
        marks = {'.': 'best point', 'x': 'mirror image', '^': 'anchor'}
        return [
            Patch(facecolor=gray, alpha=0.25, label='enclosure, darker where hypotheses overlap'),
            *(Line2D([], [], color=gray, marker=m, ls='', label=n) for m, n in marks.items()),
            Line2D([], [], color='black', linewidth=0.9, label='truth'),
            Line2D([], [], color='0.5', linestyle='--', label='the frame changes'),
        ]


def _limits(values: FloatArray, ends: FloatArray) -> tuple[float, float]:
    """Return the ends of an axis, which shows all known values and most bounds."""
    ends = ends[np.isfinite(ends)]
    values = np.append(values, np.percentile(ends, [2.0, 98.0]) if len(ends) else [])
    values = values[np.isfinite(values)] if np.isfinite(values).any() else np.zeros(1)
    margin = max(0.05 * float(np.ptp(values)), 0.1)
    return float(values.min()) - margin, float(values.max()) + margin


def _color(robot: int) -> str:
    return COLORS[robot % len(COLORS)]


STYLE = """
body { font: 15px/1.5 sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { border: 1px solid #ccc; padding: .25rem .6rem; text-align: left; vertical-align: top; }
th { background: #f3f3f3; }
svg { max-width: 100%; height: auto; }
.verdict { font-size: 1.2rem; background: #eef4fa; padding: .8rem 1rem; }
""".strip()


def as_page(tree: Tree, fleet: FleetConfig, picture: str) -> str:
    """Return a report as HTML with its picture as embedded SVG."""
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
    default, names = FleetConfig(fleet.robots), [one.name for one in fields(fleet)]
    settings = [
        (name, getattr(fleet, name))
        for name in names
        if name == 'robots' or getattr(fleet, name) != getattr(default, name)
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
