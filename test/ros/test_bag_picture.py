# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The picture of the answers to a bag."""

from itertools import combinations
import math

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason="matplotlib, the extra 'plots', is not installed")

from dg_localization.calibration.truth import (
    FleetTruth,  # noqa: E402
    TrueTrack,  # noqa: E402
)
from dg_localization.fleet import FleetConfig, Localizer  # noqa: E402
from dg_localization.ros.bags.picture import ERROR, HEADING, AnswerPicture  # noqa: E402


class Answers:
    """Answers of robots that stand at known places, and their picture."""

    def __init__(self, places, *pairs, title='bag', **settings):
        robots = tuple(places)
        self.config = FleetConfig(robots=robots, dimension=len(places[robots[0]]), **settings)
        tracks = {name: TrueTrack.at_rest(place) for name, place in places.items()}
        self.picture = AnswerPicture(self.config, title, FleetTruth(self.config, tracks))
        self.places, self.pairs = places, pairs

    def add(self, count, first=0):
        """Add `count` answers, one after the other."""
        localizer = Localizer(self.config)
        for step in range(first, first + count):
            time_s = 1.0 + 0.2 * step
            for a, b in self.pairs:
                range_m = math.dist(self.places[a], self.places[b])
                assert localizer.add_range(a, b, range_m, stamp_s=time_s, now_s=time_s) is None
            snapshot = localizer.snapshot(time_s)
            self.picture.add(localizer.estimate(snapshot), snapshot, 0.2 * step)

    def panels(self):
        """Return the map and the panels of each robot."""
        figure = self.picture.figure()
        figure.canvas.draw()
        the_map, *panels = figure.axes
        n_columns = len(self.picture.columns)
        return the_map, np.reshape(np.array(panels, dtype=object), (-1, n_columns))


TRIANGLE = {'a': (0.0, 0.0), 'b': (3.0, 0.0), 'c': (0.0, 4.0)}
SIDES = ('a', 'b'), ('a', 'c'), ('b', 'c')


def rectangles_of(panel):
    """Return the corners of what is drawn of the bounds."""
    return [path.vertices for drawn in panel.collections for path in drawn.get_paths()]


def test_bounds_points_and_truth_of_every_robot_are_drawn():
    answers = Answers(TRIANGLE, *SIDES)
    answers.add(5)
    the_map, panels = answers.panels()
    assert panels.shape == (3, 4)
    assert answers.picture.columns == ('x [m]', 'y [m]', HEADING, ERROR)
    points, true = panels[2, 1].lines
    # Two hypotheses, mirror images of each other.
    assert sorted(np.round(points.get_ydata(), 6)) == pytest.approx([-4.0] * 5 + [4.0] * 5)
    assert np.allclose(true.get_ydata(), 4.0)
    rectangles = rectangles_of(panels[2, 1])
    assert len(rectangles) == 10
    low, high = panels[2, 1].get_ylim()
    assert low < -4.0 and high > 4.0
    # No heading is known: everything is within the bounds.
    for corners in rectangles_of(panels[1, 2]):
        assert corners[:, 1].min() == -math.pi and corners[:, 1].max() == math.pi
    assert 'origin at a, x towards b' in the_map.get_title()


def test_bounds_without_an_end_fill_the_panel():
    answers = Answers({**TRIANGLE, 'd': (9.0, 9.0)}, *SIDES, ('a', 'd'))
    answers.add(2)
    _, panels = answers.panels()
    limits = panels[3, 0].get_ylim()
    for corners in rectangles_of(panels[3, 0]):
        assert limits[0] <= corners[:, 1].min() < corners[:, 1].max() <= limits[1]


def test_a_change_of_the_frame_is_marked():
    answers = Answers(TRIANGLE, *SIDES)
    answers.add(3)
    answers.pairs = [('b', 'c')]
    answers.add(2, first=3)
    the_map, panels = answers.panels()
    assert [line.get_xdata()[0] for line in panels[0, 0].lines[2:]] == pytest.approx([0.6])
    assert 'origin at a' in the_map.get_title()
    assert '2 answers have other frames' in the_map.get_title().replace('\n', ' ')


def test_in_space_there_are_three_coordinates():
    places = {'a': (0.0, 0.0, 0.0), 'b': (3.0, 0.0, 0.0), 'c': (0.0, 4.0, 0.0), 'd': (1.0, 1.0, 2)}
    answers = Answers(places, *combinations(places, 2))
    answers.add(2)
    assert answers.panels()[1].shape == (4, 4)
    assert answers.picture.columns == ('x [m]', 'y [m]', 'z [m]', ERROR)
