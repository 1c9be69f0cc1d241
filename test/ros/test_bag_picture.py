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


def drawn(places, *runs):
    """Draw answers of robots at known places, of each run a number, with ranges of its pairs."""
    robots = tuple(places)
    config = FleetConfig(robots=robots, dimension=len(places[robots[0]]))
    tracks = {name: TrueTrack.at_rest(place) for name, place in places.items()}
    picture, time_s = AnswerPicture(config, 'bag', FleetTruth(config, tracks)), 1.0
    for count, pairs in runs:
        localizer = Localizer(config)
        for _ in range(count):
            for a, b in pairs:
                range_m = math.dist(places[a], places[b])
                assert localizer.add_range(a, b, range_m, stamp_s=time_s, now_s=time_s) is None
            snapshot = localizer.snapshot(time_s)
            picture.add(localizer.estimate(snapshot), snapshot, time_s - 1.0)
            time_s += 0.2
    figure = picture.figure()
    figure.canvas.draw()
    the_map, *panels = figure.axes
    panels = np.reshape(np.array(panels, dtype=object), (len(robots), -1))
    return picture.columns, the_map, panels


def rectangles_of(panel):
    """Return the corners of what is drawn of the bounds."""
    return [path.vertices for drawn in panel.collections for path in drawn.get_paths()]


def test_bounds_points_and_truth_of_every_robot_are_drawn():
    columns, the_map, panels = drawn(PLACES, (5, TRIANGLE))
    assert panels.shape == (3, 4) and columns == ('x [m]', 'y [m]', HEADING, ERROR)
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
    _, _, panels = drawn({**PLACES, 'd': (9.0, 9.0)}, (2, [*TRIANGLE, ('a', 'd')]))
    limits = panels[3, 0].get_ylim()
    for corners in rectangles_of(panels[3, 0]):
        assert limits[0] <= corners[:, 1].min() < corners[:, 1].max() <= limits[1]


def test_a_change_of_the_frame_is_marked():
    _, the_map, panels = drawn(PLACES, (3, TRIANGLE), (2, [('b', 'c')]))
    assert [line.get_xdata()[0] for line in panels[0, 0].lines[2:]] == pytest.approx([0.6])
    assert 'origin at a' in the_map.get_title()
    assert '2 answers have other frames' in the_map.get_title().replace('\n', ' ')


def test_in_space_there_are_three_coordinates():
    places = {'a': (0.0, 0.0, 0.0), 'b': (3.0, 0.0, 0.0), 'c': (0.0, 4.0, 0.0), 'd': (1.0, 1.0, 2)}
    columns, _, panels = drawn(places, (2, [*combinations(places, 2)]))
    assert panels.shape == (4, 4) and columns == ('x [m]', 'y [m]', 'z [m]', ERROR)


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
    command = browser, *(f'--{option}' for option in options), page.as_uri()
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    shown = done.stdout
    assert shown.count('<svg') == 1 and '<h2>Configuration</h2>' in shown
    hues, saturations, _ = np.moveaxis(rgb_to_hsv(image.imread(shot)[:, :, :3]), -1, 0)
    for color in COLORS[:3]:
        off = np.abs(hues - rgb_to_hsv(to_rgb(color))[0])
        n_pixels = np.count_nonzero((off < 0.02) & (saturations > 0.3))
        assert n_pixels > PIXELS, f'{color} of a robot is not on the page: {n_pixels} pixels'
