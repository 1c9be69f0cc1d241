# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The report as a page: its content, and what a browser shows."""

from dataclasses import fields
import re
import shutil
import subprocess

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')
pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")
image = pytest.importorskip('matplotlib.image', reason="the extra 'plots' is not installed")

from matplotlib.colors import rgb_to_hsv, to_rgb  # noqa: E402
from small_bags import write_parameters, write_table  # noqa: E402

from dg_localization.fleet import FleetConfig  # noqa: E402
from dg_localization.ros.bags.picture import COLORS  # noqa: E402
from dg_localization.ros.executables import localize_bag  # noqa: E402

BROWSERS = 'chromium', 'chromium-browser', 'google-chrome'
# No picture of a robot has fewer pixels of its color, and no page of text has as many.
PIXELS = 2000


@pytest.fixture
def page(triangle_bag, tmp_path):
    """Return the file of a report with a truth."""
    table = write_table(tmp_path / 'truth.csv')
    params, path = write_parameters(tmp_path), tmp_path / 'answers.html'
    arguments = [triangle_bag, '-o', tmp_path / 'out', '--params', params, '--report', path]
    assert localize_bag([str(one) for one in (*arguments, '--truth', table)]) == 0
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
