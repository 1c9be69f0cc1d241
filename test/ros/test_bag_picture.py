# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The picture of the answers to a bag, and the report as a page: what a browser shows."""

from dataclasses import fields
from itertools import combinations
import math
import re
import shutil
import subprocess

import numpy as np
import pytest
from small_bags import PLACES, TRIANGLE, write_table

from dg_localization.calibration.truth import FleetTruth, TrueTrack
from dg_localization.fleet import FleetConfig, Localizer

image = pytest.importorskip('matplotlib.image', reason="the extra 'plots' is not installed")

from matplotlib.colors import rgb_to_hsv, to_rgb  # noqa: E402

from dg_localization.ros.bags.picture import COLORS, ERROR, HEADING, AnswerPicture  # noqa: E402


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


def rectangles_of(panel):
    """Return the corners of what is drawn of the bounds."""
    return [path.vertices for drawn in panel.collections for path in drawn.get_paths()]


def test_bounds_points_and_truth_of_every_robot_are_drawn():
    answers = Answers(PLACES, *TRIANGLE)
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
    answers = Answers({**PLACES, 'd': (9.0, 9.0)}, *TRIANGLE, ('a', 'd'))
    answers.add(2)
    _, panels = answers.panels()
    limits = panels[3, 0].get_ylim()
    for corners in rectangles_of(panels[3, 0]):
        assert limits[0] <= corners[:, 1].min() < corners[:, 1].max() <= limits[1]


def test_a_change_of_the_frame_is_marked():
    answers = Answers(PLACES, *TRIANGLE)
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


BROWSERS = 'chromium', 'chromium-browser', 'google-chrome'
# No picture of a robot has fewer pixels of its color, and no page of text has as many.
PIXELS = 2000


@pytest.fixture
def page(triangle_bag, localize, tmp_path):
    """Return the file of a report with a truth."""
    table, path = write_table(tmp_path / 'truth.csv'), tmp_path / 'answers.html'
    code, _ = localize(triangle_bag, '--truth', table, '--report', path)
    assert code == 0
    return path


def test_a_report_is_one_page(page):
    text = page.read_text()
    assert 'Of 10 answers 0 have one hypothesis' in text
    assert 'the truth is inside in 10 of 10 answers compared.' in text
    assert text.count('<svg') == 1 and '<td>range a-&gt;b</td>' in text
    settings = re.findall(r'<tr><td>(\w+)</td>', text.partition('<h2>Configuration</h2>')[2])
    assert set(settings) <= {one.name for one in fields(FleetConfig)}
    # Nothing is loaded from elsewhere: addresses are names of formats.
    assert 'http' not in re.sub(r'xmlns(:\w+)?="[^"]*"', '', text)
    assert [tag for tag in ('<script', '<link', '@import') if tag in text] == []


def test_a_browser_without_a_network_shows_the_page(page, tmp_path):
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f'none of {", ".join(BROWSERS)} is installed: no browser looks at the page')
    shot = tmp_path / 'page.png'
    options = (
        ('headless', 'no-sandbox', 'disable-gpu', 'no-first-run', 'hide-scrollbars')
        + ('disable-background-networking', 'disable-component-update', 'disable-sync')
        + ('window-size=1280,1600', 'virtual-time-budget=2000', 'dump-dom')
        + (f'user-data-dir={tmp_path / "profile"}', f'screenshot={shot}')
        + ('host-resolver-rules=MAP * ~NOTFOUND',)
    )
    shown = subprocess.run(
        [browser, *(f'--{option}' for option in options), page.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    ).stdout
    assert shown.count('<svg') == 1 and '<h2>Configuration</h2>' in shown
    hues, saturations, _ = np.moveaxis(rgb_to_hsv(image.imread(shot)[:, :, :3]), -1, 0)
    for color in COLORS[:3]:
        off = np.abs(hues - rgb_to_hsv(to_rgb(color))[0])
        n_pixels = np.count_nonzero((off < 0.02) & (saturations > 0.3))
        assert n_pixels > PIXELS, f'{color} of a robot is not on the page: {n_pixels} pixels'
