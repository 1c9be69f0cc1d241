# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A linkage with two isolated placements and a flex, a curve of placements.

Points P1..P5 (0..4 here), seven known distances. The triangle P3 P4 P5 is rigid, and P2 is as far
from P3 and P5 as P4 is: it is the mirror image of P4 in the line P3 P5, or at P4 itself. P1 is 5 m
from both P2 and P4. Where these are apart, that leaves two places for it, on the line P3 P5. Where
they are one, P1 is free to circle around them.

It takes numpy, and matplotlib for the picture::

    python docs/flex.py [docs/flex.png]
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dg_localization import Hypothesis, Problem, SolverOptions, solve

FloatArray = NDArray[np.float64]

SQUARED_M2 = {
    (2, 4): 36.0,
    (2, 3): 20.0,
    (3, 4): 32.0,
    (1, 2): 20.0,
    (1, 4): 32.0,
    (0, 1): 25.0,
    (0, 3): 25.0,
}
UNKNOWN = ((0, 2), (0, 4), (1, 3))
"""What the linkage leaves open: d13, d15 and d24."""

P3_M, P4_M, P5_M = np.array([[0.0, 0.0], [2.0, 4.0], [6.0, 0.0]])
MIRRORED_P4_M = np.array([2.0, -4.0])
ROD_M = 5.0
"""From P1 to P2 and P4."""

ROUNDING = 1e-12
"""The squared distances are known to this relative error."""

RESOLUTIONS_M = (1.6, 0.8, 0.4, 0.1, 0.025)
DRAWN_M = RESOLUTIONS_M[:3]
MAX_BOXES = 20_000

COVER_COLOR, CURVE_COLOR, ISOLATED_COLOR = '#56B4E9', 'black', '#D55E00'


def linkage() -> Problem:
    """Return the problem: seven distances of five points in the plane."""
    lower = np.zeros((5, 5))
    upper = np.full((5, 5), np.inf)
    np.fill_diagonal(upper, 0.0)
    for (i, j), squared_m2 in SQUARED_M2.items():
        lower[[i, j], [j, i]] = squared_m2 * (1.0 - ROUNDING)
        upper[[i, j], [j, i]] = squared_m2 * (1.0 + ROUNDING)
    return Problem(lower, upper, dimension=2)


def flex_placements(angles_rad: FloatArray) -> FloatArray:
    """Return placements (k, 5, 2) of the flex, in m: P2 at P4, and P1 around them."""
    turns = np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=-1)
    rest = np.broadcast_to([P4_M, P3_M, P4_M, P5_M], (len(turns), 4, 2))
    return np.concatenate([(P4_M + ROD_M * turns)[:, None], rest], axis=1)


def isolated_placements() -> FloatArray:
    """Return both isolated placements (2, 5, 2), in m: P2 mirrored, P1 on the line P3 P5."""
    along_m = np.sqrt(ROD_M**2 - P4_M[1] ** 2)
    places = [P4_M * [1.0, 0.0] + [sign * along_m, 0.0] for sign in (-1.0, 1.0)]
    return np.array([[place, MIRRORED_P4_M, P3_M, P4_M, P5_M] for place in places])


def unknown_distances_m(placements_m: FloatArray) -> FloatArray:
    """Return d13, d15 and d24 of placements (k, 5, 2), shape (k, 3)."""
    first, second = np.array(UNKNOWN).T
    return np.linalg.norm(placements_m[:, first] - placements_m[:, second], axis=-1)


def unknown_bounds_m(hypothesis: Hypothesis) -> FloatArray:
    """Return the bounds of d13, d15 and d24 in each box of a cover, shape (k, 2, 3)."""
    first, second = np.array(UNKNOWN).T
    return np.sqrt(hypothesis.boxes[:, :, first, second])


def flex_curve_m(n_places: int = 20_000) -> FloatArray:
    """Return the true curve of d13, d15 and d24 in small steps, shape (k, 3)."""
    return unknown_distances_m(flex_placements(np.linspace(0.0, 2.0 * np.pi, n_places)))


def cover_distance_m(bounds_m: FloatArray, curve_m: FloatArray) -> float:
    """Return how far the cover's farthest corner is from the curve, in m."""
    corners = [
        [box[end, axis] for axis, end in enumerate(ends)]
        for box in bounds_m
        for ends in product((0, 1), repeat=len(UNKNOWN))
    ]
    return max(
        float(np.linalg.norm(curve_m - corner, axis=1).min())
        for corner in np.unique(corners, axis=0)
    )


def cover(resolution_m: float) -> tuple[list[Hypothesis], Hypothesis]:
    """Solve the linkage; return its isolated hypotheses and the flex."""
    result = solve(linkage(), SolverOptions(resolution=resolution_m, max_boxes=MAX_BOXES))
    isolated = [hypothesis for hypothesis in result.hypotheses if not hypothesis.flexible]
    (flex,) = (hypothesis for hypothesis in result.hypotheses if hypothesis.flexible)
    return isolated, flex


def draw(covers: dict[float, tuple[list[Hypothesis], Hypothesis]], path: Path) -> None:
    """Draw the placements and, below, the covers of the flex at several resolutions."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, (linkages, panels) = pyplot.subplots(
        2, 3, figsize=(12.6, 8.4), layout='constrained', height_ratios=(1.0, 1.25)
    )
    left, right = isolated_placements()
    (moving,) = flex_placements(np.array([2.2]))
    _draw_linkage(linkages[0], left, 'isolated')
    _draw_linkage(linkages[1], right, 'isolated')
    _draw_linkage(linkages[2], moving, 'flex: P1 can circle', moves=True)
    for panel, (resolution_m, (isolated, flex)) in zip(panels, covers.items(), strict=True):
        _draw_cover(panel, isolated, flex)
        panel.set_title(f'resolution {resolution_m:g} m: {len(flex.boxes)} boxes on the flex')
    figure.legend(handles=_legend(), loc='outside lower center', ncols=3, frameon=False)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _draw_linkage(panel: Any, placement_m: FloatArray, title: str, moves: bool = False) -> None:
    """Draw one placement with its seven known distances."""
    for pair in SQUARED_M2:
        panel.plot(*placement_m[list(pair)].T, color='0.55', linewidth=2.0, zorder=1)
    if moves:
        path = flex_placements(np.linspace(0.0, 2.0 * np.pi, 400))[:, 0]
        panel.plot(*path.T, color=CURVE_COLOR, linewidth=1.0, linestyle='--', zorder=0)
    color = CURVE_COLOR if moves else ISOLATED_COLOR
    panel.plot(*placement_m.T, 'o', color='0.3', markersize=6, zorder=2)
    panel.plot(*placement_m[0], 'o', color=color, markersize=9, zorder=3)
    for point, position in enumerate(placement_m):
        if moves and point == 1:
            continue
        panel.annotate(
            'P2 = P4' if moves and point == 3 else f'P{point + 1}',
            position,
            xytext=(7, -17) if point in (0, 1) else (7, 7),
            textcoords='offset points',
            fontsize=11,
        )
    panel.set_title(title)
    panel.set_aspect('equal')
    panel.set_xlim(-4.5, 9.0)
    panel.set_xticks(range(-4, 9, 2))
    panel.set_ylim(-5.8, 9.7)
    panel.set_yticks(range(-4, 9, 2))
    panel.set_xlabel('x [m]')
    panel.set_ylabel('y [m]')
    panel.grid(color='0.93')
    panel.set_axisbelow(True)


def _draw_cover(panel: Any, isolated: list[Hypothesis], flex: Hypothesis) -> None:
    """Draw the boxes of all hypotheses in d13 and d15, and the true curve over them."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    boxes = [Rectangle(low[:2], *(high - low)[:2]) for low, high in unknown_bounds_m(flex)]
    panel.add_collection(
        PatchCollection(boxes, facecolor=COVER_COLOR, edgecolor='#0072B2', linewidth=0.5)
    )
    panel.plot(*flex_curve_m()[:, :2].T, color=CURVE_COLOR, linewidth=0.9)
    for hypothesis in isolated:
        middle = unknown_bounds_m(hypothesis).mean(axis=(0, 1))
        panel.plot(
            *middle[:2],
            'o',
            markersize=13,
            markerfacecolor='none',
            markeredgecolor=ISOLATED_COLOR,
            markeredgewidth=2.0,
        )
    panel.set_aspect('equal')
    panel.set_xlim(-0.2, 11.4)
    panel.set_ylim(-0.2, 11.4)
    panel.set_xlabel('d13 [m]')
    panel.set_ylabel('d15 [m]')


def _legend() -> list[Any]:
    """Return what the signs of the lower row mean."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        Patch(facecolor=COVER_COLOR, edgecolor='#0072B2', label='cover of the flex (d24 = 0)'),
        Line2D([], [], color=CURVE_COLOR, label='the flex itself'),
        Line2D(
            [],
            [],
            linestyle='',
            marker='o',
            markersize=11,
            markerfacecolor='none',
            markeredgecolor=ISOLATED_COLOR,
            markeredgewidth=2.0,
            label='isolated placement (d24 = 8 m)',
        ),
    ]


def main() -> None:
    """Print the covers as a table and draw them when a file is named."""
    curve_m = flex_curve_m()
    covers = {resolution_m: cover(resolution_m) for resolution_m in RESOLUTIONS_M}
    print('resolution (m)  hypotheses  boxes of the flex  farthest from the curve (m)')
    for resolution_m, (isolated, flex) in covers.items():
        distance_m = cover_distance_m(unknown_bounds_m(flex), curve_m)
        print(
            f'{resolution_m:14g}  {len(isolated) + 1:10}  {len(flex.boxes):17}  {distance_m:27.4f}'
        )
    if len(sys.argv) > 1:
        draw({resolution_m: covers[resolution_m] for resolution_m in DRAWN_M}, Path(sys.argv[1]))


if __name__ == '__main__':
    main()
