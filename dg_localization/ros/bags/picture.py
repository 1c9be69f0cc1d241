# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The picture of a bag: its answers over time, robot by robot, and a map of them."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dg_localization.calibration.answers import FleetTruth, TruePlacement
from dg_localization.fleet import Estimate, FleetConfig, Placement
from dg_localization.fleet.rotations import yaw_of
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.optional import install_hint
from dg_localization.ros.colors import color_of
from dg_localization.ros.executables import ExecutableError

FloatArray = NDArray[np.float64]

PICTURES = ('.png', '.svg', '.pdf')
"""What the file of a picture may end in."""

MOST_MOMENTS = 600
"""More answers than this have less than a pixel each: every second one is left out then."""

MOST_ROWS = 20
"""So many robots have panels of their own; all are on the map."""

ROW_IN, MAP_IN, PANEL_IN = 1.5, 5.5, 3.2
"""The height of a robot's panels and the widths of the map and of a panel, in inches."""

DOTS_PER_IN = 100

MARGIN, LEAST_MARGIN_M = 0.05, 0.1
"""Of an axis around what it shows, as a share of that, and at least."""

MOST_LETTERS = 24
"""Of a longer name the middle is left out."""

LARGEST_M = 1e9
"""What is farther away is not drawn, and not a bound."""

COORDINATES = ('x', 'y', 'z')
HEADING = 'heading [rad]'
ERROR = 'off the truth [m]'


def check_can_draw() -> None:
    """Check that pictures can be drawn, before the work begins."""
    if find_spec('matplotlib') is None:
        raise ExecutableError(
            f'--plot and --report FILE.html need matplotlib: {install_hint("matplotlib")}'
        )


@dataclass(frozen=True)
class _Moment:
    """
    The answer of one time.

    Attributes
    ----------
    time_s : float
        From the start of the bag.
    frame : str
        That of the answer; empty where there are no placements.
    best, low, high : ndarray, shape (k, n, c)
        The best point and the bounds of each hypothesis and robot, in all columns.
    true : ndarray, shape (n, c)
        NaN where it is not known.
    landmarks_m : ndarray, shape (m, q)
        The anchors that are not robots.
    mirrored : ndarray of bool, shape (k,)
        Which hypotheses are mirror images of those before them.

    """

    time_s: float
    frame: str
    best: FloatArray
    low: FloatArray
    high: FloatArray
    true: FloatArray
    landmarks_m: FloatArray
    mirrored: NDArray[np.bool_]


class AnswerPicture:
    """
    Gathers answers and draws them.

    There is a row of panels for each robot and a column for each coordinate, in the plane one more
    for the heading.

    Parameters
    ----------
    fleet : FleetConfig
    title : str
        That of the picture.
    period_s : float
        The time between two answers.
    truth : FleetTruth or None
        Where the robots truly were, if that is known.

    """

    def __init__(
        self, fleet: FleetConfig, title: str, period_s: float, truth: FleetTruth | None = None
    ) -> None:
        self._labels = tuple(_label(name) for name in fleet.robots)
        self._dimension = fleet.dimension
        self._title = title
        self._period_s = period_s
        self._truth = truth
        self._moments: list[_Moment] = []
        self._n_added, self._every = 0, 1

    @property
    def columns(self) -> tuple[str, ...]:
        """What the panels of a robot show."""
        names = [f'{name} [m]' for name in COORDINATES[: self._dimension]]
        names += [HEADING] if self._dimension == 2 else []
        return (*names, ERROR) if self._truth is not None else tuple(names)

    def add(self, estimate: Estimate, snapshot: Snapshot | None, time_s: float) -> None:
        """Add the answer to a snapshot, for a time from the start of the bag."""
        self._n_added += 1
        if (self._n_added - 1) % self._every:
            return
        placements = estimate.placements
        shape = len(placements), len(self._labels), len(self.columns)
        best, low, high = (np.full(shape, np.nan) for _ in range(3))
        n_of_pose = 3
        for row, placement in enumerate(placements):
            columns = best[row], low[row], high[row]
            for column, values in zip(columns, self._columns_of(placement), strict=True):
                column[:, :n_of_pose] = values
        true = np.full(shape[1:], np.nan)
        if self._truth is not None and snapshot is not None and estimate.frame is not None:
            true[:, :n_of_pose] = self._true_columns(self._truth.beside(estimate.frame, snapshot))
            off_m = (best - true)[:, :, : self._dimension]
            best[:, :, n_of_pose] = np.linalg.norm(off_m, axis=-1)
        landmarks_m = placements[0].landmarks_m if placements else np.empty((0, self._dimension))
        frame = str(estimate.frame or '')
        for values, beyond in ((best, np.nan), (true, np.nan), (low, -np.inf), (high, np.inf)):
            values[np.abs(values) > LARGEST_M] = beyond
        mirrored = np.array([placement.mirrored for placement in placements], dtype=bool)
        self._moments.append(_Moment(time_s, frame, best, low, high, true, landmarks_m, mirrored))
        if len(self._moments) > MOST_MOMENTS:
            del self._moments[1::2]
            self._every *= 2

    def _columns_of(self, placement: Placement) -> Iterator[FloatArray]:
        """Yield the best point of a placement and its bounds from below and above."""
        low, high = placement.enclosure_m[:, 0], placement.enclosure_m[:, 1]
        if self._dimension == 3:
            yield from (placement.positions_m, low, high)
            return
        orientations, half_widths_rad = placement.best_headings
        yaws_rad = np.array([yaw_of(one) for one in orientations])
        # Where nothing is known of a heading, all of its panel is within the bounds.
        middle_rad = np.where(np.isfinite(yaws_rad), yaws_rad, 0.0)
        yield np.column_stack([placement.positions_m, yaws_rad])
        yield np.column_stack([low, middle_rad - half_widths_rad])
        yield np.column_stack([high, middle_rad + half_widths_rad])

    def _true_columns(self, truth: TruePlacement) -> FloatArray:
        """Return what is true in all columns."""
        if self._dimension == 3:
            return np.array(truth.positions_m)
        yaws_rad = np.arctan2(truth.rotations[:, 1, 0], truth.rotations[:, 0, 0])
        return np.column_stack([truth.positions_m, yaws_rad])

    def draw(self, path: Path) -> None:
        """Draw the answers so far and write the picture."""
        import matplotlib

        matplotlib.use('Agg')
        from matplotlib import pyplot

        figure = self._figure(pyplot)
        figure.savefig(path, dpi=DOTS_PER_IN)
        pyplot.close(figure)

    def _figure(self, pyplot: Any) -> Any:
        """Return the figure with all panels."""
        n_rows, n_columns = min(len(self._labels), MOST_ROWS), len(self.columns)
        figure = pyplot.figure(
            figsize=(MAP_IN + PANEL_IN * n_columns, max(MAP_IN + 0.5, ROW_IN * n_rows + 1.0)),
            layout='constrained',
        )
        widths = [MAP_IN, *[PANEL_IN] * n_columns]
        grid = figure.add_gridspec(n_rows, n_columns + 1, width_ratios=widths)
        self._draw_map(figure.add_subplot(grid[:, 0]))
        panels = grid[:, 1:].subgridspec(n_rows, n_columns).subplots(squeeze=False, sharex=True)
        for row in range(n_rows):
            for column in range(n_columns):
                self._draw_panel(panels[row, column], row, column)
            panels[row, 0].set_ylabel(self._labels[row])
        for column, name in enumerate(self.columns):
            panels[0, column].set_title(name, fontsize=10)
            panels[-1, column].set_xlabel('time from the start of the bag [s]')
        is_cut = len(self._labels) > n_rows
        cut = f' (robots after the first {n_rows} are on the map only)' if is_cut else ''
        # A name with $ is no formula.
        figure.suptitle(self._title + cut, parse_math=False)
        figure.legend(handles=self._legend(), loc='outside lower center', ncols=6, frameon=False)
        return figure

    def _draw_map(self, panel: Any) -> None:
        """Draw where the robots were, in the frame that most answers have."""
        frames = Counter(moment.frame for moment in self._moments if moment.frame)
        frame, count = frames.most_common(1)[0] if frames else ('no answer has placements', 0)
        shown = [moment for moment in self._moments if moment.frame == frame]
        for row in range(len(self._labels)):
            color = color_of(row)
            for is_mirror, mark in ((False, '.'), (True, 'x')):
                points = [m.best[m.mirrored == is_mirror, row, :2] for m in shown]
                label = None if is_mirror else self._labels[row]
                panel.plot(
                    *np.concatenate([np.empty((0, 2)), *points]).T,
                    mark,
                    color=color,
                    markersize=3,
                    zorder=3,
                    label=label,
                )
            true = np.array([moment.true[row, :2] for moment in shown])
            panel.plot(*true.reshape(-1, 2).T, color='black', linewidth=0.8, zorder=4)
        if shown:
            panel.plot(*shown[-1].landmarks_m[:, :2].T, '^', color='0.4', zorder=2)
        panel.set_aspect('equal', adjustable='datalim')
        panel.set_xlabel('x [m]')
        panel.set_ylabel('y [m]')
        panel.grid(color='0.93')
        others = frames.total() - count
        left_out = f'; {others} answers have other frames' if others else ''
        mirrored_s = [m.time_s for m in shown if m.mirrored.any()]
        if mirrored_s:
            left_out += f'; mirror images from {mirrored_s[0]:.1f} to {mirrored_s[-1]:.1f} s'
        # Names beside the map: on it they would cover the paths.
        panel.legend(loc='upper center', bbox_to_anchor=(0.5, -0.1), ncols=4, frameon=False)
        panel.set_title(f'frame: {frame}{left_out}', fontsize=10, wrap=True, parse_math=False)

    def _draw_panel(self, panel: Any, row: int, column: int) -> None:
        """Draw one column of a robot over time."""
        is_angle = self.columns[column] == HEADING
        limits = (-math.pi, math.pi) if is_angle else self._limits(row, column)
        self._draw_bounds(panel, row, column, limits)
        times_s = np.array([moment.time_s for moment in self._moments])
        counts = [len(moment.best) for moment in self._moments]
        best = np.concatenate([[], *[moment.best[:, row, column] for moment in self._moments]])
        panel.plot(np.repeat(times_s, counts), best, '.', color=color_of(row), markersize=2.5)
        true = np.array([moment.true[row, column] for moment in self._moments])
        if is_angle:
            # A line from pi to -pi would be no truth.
            true[1:][np.abs(np.diff(true)) > math.pi] = np.nan
        panel.plot(times_s, true, color='black', linewidth=0.9)
        for time_s in self._frame_changes_s():
            panel.axvline(time_s, color='0.5', linewidth=0.7, linestyle='--')
        panel.set_ylim(*limits)
        panel.grid(color='0.93')
        panel.set_axisbelow(True)

    def _draw_bounds(self, panel: Any, row: int, column: int, limits: tuple[float, float]) -> None:
        """Draw the bounds of each hypothesis at each time, between the ends of the axis."""
        from matplotlib.collections import PolyCollection

        turns = (-math.tau, 0.0, math.tau) if self.columns[column] == HEADING else (0.0,)
        width_s = self._every * self._period_s
        bands = [
            _bands(moment.time_s, width_s, low + turn, high + turn, limits)
            for moment in self._moments
            for low, high in [(moment.low[:, row, column], moment.high[:, row, column])]
            for turn in turns
        ]
        rectangles = [corners for band in bands for corners in band]
        panel.add_collection(
            PolyCollection(
                rectangles, facecolor=color_of(row), alpha=0.25, linewidth=0, antialiased=False
            )
        )

    def _limits(self, row: int, column: int) -> tuple[float, float]:
        """Return the ends of an axis: it has all that is known, and most of the bounds."""
        known = [m.best[:, row, column] for m in self._moments]
        known += [m.true[row, column].reshape(1) for m in self._moments]
        bounds = [b[:, row, column] for m in self._moments for b in (m.low, m.high)]
        values = np.concatenate([*known, np.empty(0)])
        ends = np.concatenate([*bounds, np.empty(0)])
        values, ends = values[np.isfinite(values)], ends[np.isfinite(ends)]
        shown = [values, np.percentile(ends, [2.0, 98.0])] if len(ends) else [values]
        together = np.concatenate(shown)
        if not len(together):
            return -1.0, 1.0
        low, high = float(together.min()), float(together.max())
        margin = max(MARGIN * (high - low), LEAST_MARGIN_M)
        return low - margin, high + margin

    def _frame_changes_s(self) -> Iterator[float]:
        """Yield the times from which on answers have another frame than those before."""
        frame = ''
        for moment in self._moments:
            if moment.frame:
                if frame not in ('', moment.frame):
                    yield moment.time_s
                frame = moment.frame

    def _legend(self) -> list[Any]:
        """Return what the signs mean, in neutral colors; only of what there may be."""
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        gray = '0.45'
        handles: list[Any] = [
            Line2D([], [], color=gray, marker='.', linestyle='', label='best point'),
            Patch(facecolor=gray, alpha=0.25, label='enclosure, darker where hypotheses overlap'),
        ]
        if any(moment.mirrored.any() for moment in self._moments):
            handles.append(
                Line2D([], [], color=gray, marker='x', linestyle='', label='mirror image')
            )
        if any(np.isfinite(moment.true).any() for moment in self._moments):
            handles.append(Line2D([], [], color='black', linewidth=0.9, label='truth'))
        if any(len(moment.landmarks_m) for moment in self._moments):
            handles.append(Line2D([], [], color=gray, marker='^', linestyle='', label='anchor'))
        if any(True for _ in self._frame_changes_s()):
            dashes = Line2D([], [], color='0.5', linestyle='--', label='the frame changes')
            handles.append(dashes)
        return handles


def _label(name: str) -> str:
    if len(name) <= MOST_LETTERS:
        return name
    half = MOST_LETTERS // 2
    return f'{name[: half - 1]}…{name[-half:]}'


def _bands(
    time_s: float, width_s: float, low: FloatArray, high: FloatArray, limits: tuple[float, float]
) -> FloatArray:
    """Return the corners of a rectangle for each hypothesis, cut at the ends of the axis."""
    low, high = np.clip(low, *limits), np.clip(high, *limits)
    shown = high > low
    corners = np.empty((np.count_nonzero(shown), 4, 2))
    corners[:, :2, 0], corners[:, 2:, 0] = time_s - 0.5 * width_s, time_s + 0.5 * width_s
    corners[:, [0, 3], 1], corners[:, 1:3, 1] = low[shown, None], high[shown, None]
    return corners
