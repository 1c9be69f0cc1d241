# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
LIAS to a rosbag2: three ultra-wideband tags on a trolley, eight anchors, true poses.

The recordings (LIAS, CUHK Shenzhen, 2023) are tables, a line every half second: the time, then the
ranges of anchor 0 to tags 0, 1 and 2, of anchor 1, and so on. The tags are three robots here, and
what is known of their mounting is given as ranges between them that were measured with a rule::

    python docs/convert_lias.py geometry.json UWB_static_exp_8_14_pos1_deg_0.csv lias
    localize_bag lias -o answers --params lias.yaml

It writes the bag `lias` and the parameters `lias.yaml`, and takes numpy and rosbags.
"""

from __future__ import annotations

import argparse
import csv
from datetime import UTC, datetime
from itertools import combinations
import json
import math
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from recorder import RANGE, Recorder, anchors_yaml

FloatArray = NDArray[np.float64]

DAY = '14'
STEP_DEG = 60
TAGS = ('t0', 't1', 't2')
ANCHORS = tuple(f'a{number}' for number in range(8))
RULE_ERROR_M = 0.005
TRUTH_PERIOD_S = 0.2

PARAMETERS = """\
/**:
  ros__parameters:
    robots: ['t0', 't1', 't2']
    rate: 2.0
    max_age: 2.0
    # The trolley stands still.
    max_speed: 0.0
    # These hold for more than 99.9 % of the ranges; the others are found by contradiction.
    range: {min_error: -0.05, max_error: 0.6, min_error_relative: 0.0, max_error_relative: 0.0}
    max_outliers: 1
"""


def read_geometry(
    path: Path, site: str, degrees: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the tags on the trolley (3, 2), the anchors (8, 2), and yaw (rad), x, y."""
    day: dict[str, Any] = json.loads(path.read_text(encoding='utf-8'))[DAY]
    yaw_deg, x, y = day['poses_yawdeg_x_y'][site][degrees // STEP_DEG]
    # Tags and anchors are 7 cm apart in height, which is 1 mm of a range of 2 m.
    tags, anchors = np.array(day['tags'])[:, :2], np.array(day['anchors'])[:, :2]
    return tags, anchors, np.array([math.radians(yaw_deg), x, y])


def read_ranges(path: Path) -> list[tuple[float, list[str]]]:
    """Return the stamps in s and the texts of 24 ranges; the clock is taken for UTC."""
    found = []
    with path.open(newline='', encoding='utf-8') as file:
        for time, *ranges in csv.reader(file):
            stamp = datetime.fromisoformat(time).replace(tzinfo=UTC)
            found.append((stamp.timestamp(), ranges[: len(TAGS) * len(ANCHORS)]))
    return found


def convert(geometry: Path, table: Path, output: Path) -> int:
    """
    Convert one table.

    Parameters
    ----------
    geometry : Path
        The places of tags and anchors and the true poses.
    table : Path
        Its name ends in posSITE_deg_DEGREES.csv.
    output : Path
        The bag, a folder that does not exist; the parameters go beside it, with .yaml added.

    Returns
    -------
    int
        How many ranges are missing in the table.

    """
    match = re.search(r'pos(\d+)_deg_(\d+)', table.stem)
    if match is None:
        raise ValueError(f"{table} must be named like 'pos1_deg_120.csv'")
    tags, anchors, (yaw, x, y) = read_geometry(geometry, match[1], int(match[2]))
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    true_m = tags @ turn.T + (x, y)
    recorder, missing = Recorder(), 0
    pairs = [(anchor, tag) for anchor in ANCHORS for tag in TAGS]
    rows = read_ranges(table)
    # The table has pauses; the trolley stood still in them, too.
    for stamp_s in np.arange(rows[0][0], rows[-1][0] + TRUTH_PERIOD_S, TRUTH_PERIOD_S):
        for tag, place_m in zip(TAGS, true_m, strict=True):
            recorder.add_truth(tag, place_m, yaw, float(stamp_s))
    for stamp_s, texts in rows:
        for (anchor, tag), text in zip(pairs, texts, strict=True):
            if text:
                recorder.add_range(tag, anchor, float(text), stamp_s, stamp_s)
            else:
                missing += 1
        for first, second in combinations(range(len(TAGS)), 2):
            apart_m = math.dist(tags[first], tags[second])
            recorder.add_range(TAGS[first], TAGS[second], apart_m, stamp_s, stamp_s)
    recorder.write(output)
    rule = f'min_error={-RULE_ERROR_M} max_error={RULE_ERROR_M}'
    links = [f"      - '/{a}/range/{b} {RANGE} {a} {b} {rule}'" for a, b in combinations(TAGS, 2)]
    text = PARAMETERS + '\n'.join(['    links:', *links, ''])
    text += anchors_yaml(zip(ANCHORS, anchors, strict=True), bound_m=0.01)
    output.with_name(output.name + '.yaml').write_text(text, encoding='utf-8')
    return missing


def main() -> None:
    """Convert what the command line names."""
    parser = argparse.ArgumentParser(description='Convert a table of LIAS to a rosbag2.')
    parser.add_argument('geometry', type=Path, help='geometry.json')
    parser.add_argument('table', type=Path, help='UWB_static_..._posSITE_deg_DEGREES.csv')
    parser.add_argument('output', type=Path, help='the bag to write')
    options = parser.parse_args()
    for path in (options.geometry, options.table):
        if not path.is_file():
            parser.error(f"'{path}' is no file")
    if options.output.exists():
        parser.error(f"'{options.output}' exists; name a folder that does not")
    parameters = options.output.with_name(options.output.name + '.yaml')
    if parameters.exists():
        parser.error(f"'{parameters}' exists; move it, or name another folder")
    missing = convert(options.geometry, options.table, options.output)
    print(f'{options.output} and {parameters} are written; {missing} ranges missing')


if __name__ == '__main__':
    main()
