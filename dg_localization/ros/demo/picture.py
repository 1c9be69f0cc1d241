# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The picture of the demonstration: every feasible placement next to the truth."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dg_localization.ros.colors import ROBOT_COLORS
from dg_localization.ros.demo.compare import ROUNDING_M, Scenario, count_text
from dg_localization.simulation.moving_fleet import EDGES, ROBOTS, rotation

FEASIBLE_COLOR = '0.8'
NAME_OFFSET_POINTS = np.array([36.0, 20.0])
TRUTH_STYLE: dict[str, Any] = {
    'linestyle': '',
    'marker': 'o',
    'markersize': 13,
    'markerfacecolor': 'none',
    'markeredgecolor': 'black',
    'markeredgewidth': 1.5,
}


def draw(scenarios: Sequence[Scenario], path: Path) -> None:
    """
    Draw every feasible placement of the last answers, next to the truth.

    Parameters
    ----------
    scenarios : sequence of Scenario
        One panel each.
    path : Path
        The picture to write.

    """
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(
        1, len(scenarios), figsize=(5.4 * len(scenarios), 5.6), layout='constrained'
    )
    for panel, scenario in zip(np.atleast_1d(panels), scenarios, strict=True):
        _draw_panel(panel, scenario)
    figure.legend(handles=_legend(), loc='outside lower center', ncols=6, frameon=False)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _draw_panel(panel: Any, scenario: Scenario) -> None:
    """Draw one answer over the truth of its time."""
    answer, truth = scenario.last.answer, scenario.last.truth
    for a, b in EDGES:
        panel.plot(*answer.positions_m[:, [a, b]].T, color=FEASIBLE_COLOR, linewidth=0.7, zorder=1)
        panel.plot(*truth.positions_m[[a, b]].T, color='black', linewidth=1.2, zorder=4)
    for robot, color in enumerate(ROBOT_COLORS):
        _draw_boxes(panel, answer.enclosures_m[:, robot], color)
        panel.plot(*answer.positions_m[:, robot].T, 'o', color=color, markersize=6, zorder=5)
        for k, yaw_rad in enumerate(answer.yaws_rad[:, robot]):
            if np.isfinite(yaw_rad):
                _draw_heading(panel, answer.positions_m[k, robot], yaw_rad, color)
        panel.annotate(
            ROBOTS[robot],
            truth.positions_m[robot],
            xytext=_outward(truth.positions_m[robot]),
            textcoords='offset points',
            ha='center',
            va='center',
            fontsize=9,
            bbox={'boxstyle': 'round,pad=0.15', 'facecolor': 'white', 'edgecolor': color},
            zorder=4.5,
        )
    panel.plot(*truth.positions_m.T, **TRUTH_STYLE, zorder=6)
    panel.set_title(f'{scenario.title}: {count_text(answer)}')
    panel.set_aspect('equal')
    panel.set_xlim(-9.9, 9.9)
    panel.set_ylim(-9.0, 9.0)
    panel.set_xlabel('x [m]')
    panel.set_ylabel('y [m]')
    panel.grid(color='0.93')
    panel.set_axisbelow(True)


def _outward(position_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where a name stands, in points from its robot: away from the origin."""
    distance_m = np.linalg.norm(position_m)
    direction = position_m / distance_m if distance_m > ROUNDING_M else np.array([0.0, -1.0])
    return NAME_OFFSET_POINTS * direction


def _draw_boxes(panel: Any, boxes_m: NDArray[np.float64], color: str) -> None:
    """Draw boxes (k, 2, 2); many hypotheses share the place of a robot, so the fill is faint."""
    from matplotlib.patches import Rectangle

    for lower, upper in boxes_m:
        place = Rectangle(lower, *(upper - lower), facecolor=color, alpha=0.12, zorder=2)
        panel.add_patch(place)
        panel.add_patch(
            Rectangle(
                lower, *(upper - lower), fill=False, edgecolor=color, linewidth=0.8, zorder=3
            )
        )


def _draw_heading(panel: Any, start_m: NDArray[np.float64], yaw_rad: float, color: str) -> None:
    """Draw an arrow from a robot forward."""
    panel.annotate(
        '',
        start_m + 1.8 * rotation(yaw_rad)[:, 0],
        start_m,
        arrowprops={'arrowstyle': '-|>', 'color': color, 'linewidth': 2.0},
        zorder=5,
    )


def _legend() -> list[Any]:
    """Return what the signs mean, in neutral colors."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    gray = '0.45'
    return [
        Line2D([], [], label='true position', **TRUTH_STYLE),
        Line2D([], [], color='black', linewidth=1.2, label='measured pair, true'),
        Line2D([], [], color=gray, marker='o', linestyle='', label='feasible position'),
        Patch(facecolor='0.9', edgecolor=gray, label='its enclosure'),
        Line2D(
            [],
            [],
            color=gray,
            marker='$\\rightarrow$',
            markersize=14,
            linestyle='',
            label='its heading',
        ),
        Line2D([], [], color=FEASIBLE_COLOR, linewidth=1.2, label='measured pair, feasible'),
    ]
